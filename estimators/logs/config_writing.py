"""From a `LogConfig` to the text of its YAML."""

from __future__ import annotations

from typing import Any

import yaml

from estimators.logs.config import RIGID_KEYS, SOIL_KEYS, LogConfig, StartSpec, TerrainSpec
from offroad_env.errors import DataError
from offroad_env.world.four_wheel import make_four_wheel, stated_fields

__all__ = ["config_yaml"]


def config_yaml(config: LogConfig) -> str:
    """The text of the YAML file; ``units`` is left out, since a written log is in SI."""
    return yaml.safe_dump(_as_mapping(config), sort_keys=False, default_flow_style=None, width=110)


def _as_mapping(config: LogConfig) -> dict[str, Any]:
    soil = config.soil
    keys: tuple[str, ...] = RIGID_KEYS if soil.rigid > 0.5 else SOIL_KEYS
    ground: dict[str, Any] = {name: getattr(soil, name) for name in keys}
    if soil.rigid > 0.5:
        ground = {"kind": "rigid", **ground}
    if config.wheel is not None:
        return {"model": config.model, "wheel": config.wheel._asdict(), "soil": ground}
    if config.vehicle is None or config.imu is None:
        raise DataError("a log is described by a wheel, or by a vehicle with its imu: neither is there")
    mapping = {
        "model": config.model,
        "drivetrain": config.drivetrain,
        "slip": config.slip,
        "vehicle": {**config.vehicle._asdict(), **_four_wheel_mapping(config)},
        "soil": ground,
        "terrain": _terrain_mapping(config.terrain),
        "imu": {
            "kinematic": config.imu.kinematic,
            "position": list(config.imu.position),
            "sd": {"a": config.imu.sd_a, "rate": config.imu.sd_rate},
        },
        "inputs": {"hold": config.hold},
        "start": _start_mapping(config.start),
    }
    if config.gnss is not None:
        sd = {"position": config.gnss.sd_position, "speed": config.gnss.sd_speed}
        mapping["gnss"] = {"sd": {name: value for name, value in sd.items() if value is not None}}
    if config.structure != "full":
        mapping["structure"] = config.structure
    if config.unknown:
        mapping["unknown"] = list(config.unknown)
    if config.exact:
        mapping["tolerances"] = "none"
    return mapping


def _four_wheel_mapping(config: LogConfig) -> dict[str, Any]:
    """What the vehicle states of four wheels beyond the rules."""
    if config.vehicle is None or config.four_wheel is None:
        return {}
    default = make_four_wheel(config.vehicle)
    return dict(stated_fields(config.four_wheel, config.vehicle, default))


def _terrain_mapping(terrain: TerrainSpec) -> dict[str, Any]:
    more: dict[str, dict[str, Any]] = {
        "paper": {"H0": terrain.H_0},
        "unknown": {"rms": terrain.rms},
        "waves": {"plane": list(terrain.plane), "waves": [list(row) for row in terrain.waves]},
    }
    return {"kind": terrain.kind, **more.get(terrain.kind, {})}


def _start_mapping(start: StartSpec) -> dict[str, Any]:
    pose = {"x": start.x, "y": start.y, "yaw": start.yaw}
    if start.state:
        return {**pose, "state": dict(start.state)}
    return {"settled": True, **pose, "v_x": start.v_x}
