"""The file that brings an extended model from a diagnosis to the environment and the filters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from offroad_env.effects.library import FORMER_IDS, find_effect
from offroad_env.errors import DataError, InvalidParameter
from offroad_env.simulation.simulator import MODELS, VEHICLE_MODELS
from offroad_env.world.files import read_json
from offroad_env.world.structures import read_structure
from offroad_env.world.yaml_text import shown

__all__ = ["Extension", "read_extension"]

_FORMAT = "offroad-extension-2"
#: Written before 0.1.0 was released; `slip_sinkage` names another law there than today.
_OLDER_FORMAT = "offroad-extension-1"
#: What an extended model can be of: a preset of the vehicle, or the wheel of a rig.
_MODELS = (*MODELS, "rig")
_VEHICLE_MODELS = (*VEHICLE_MODELS, "four_wheel")


@dataclass(frozen=True, kw_only=True)
class Extension:
    """A preset of the vehicle model, and the effects or the structure that it lacks."""

    model: str  #: "full", "paper" or "rig"
    effects: tuple[tuple[str, dict[str, float]], ...]  #: (effect, its parameters)
    structure: str | None = None  #: laws of the wheels where they are not the log's, see `read_structure`
    vehicle_model: str | None = None  #: "half_car", "four_wheel", ...; None: as it is

    def choices(self, structure: Any, vehicle_model: str) -> tuple[str, Any, str]:
        """Model, structure (as an environment takes it) and vehicle model, where these were asked for."""
        laws = self.structure if structure is None else structure
        return self.model, laws, self.vehicle_model or vehicle_model

    def to_dict(self) -> dict[str, Any]:
        """The content of the file."""
        content: dict[str, Any] = {
            "format": _FORMAT,
            "model": self.model,
            "effects": [{"id": name, "parameters": dict(values)} for name, values in self.effects],
        }
        laws = {"structure": self.structure, "vehicle_model": self.vehicle_model}
        return content | {name: value for name, value in laws.items() if value is not None}


def read_extension(path: str | Path) -> Extension:
    """Read and check a file that `offroad diagnose` has written, now or with former ids of effects.

    Raises
    ------
    DataError
        If the file is missing, is no such file, or names an effect or parameter that does not exist.
    """
    content = read_json(path)
    if content.get("format") not in (_FORMAT, _OLDER_FORMAT):
        raise DataError(f"{path}: is no extended model; its format must be {_FORMAT!r}")
    ids = FORMER_IDS if content["format"] == _OLDER_FORMAT else {}
    if content.get("model") not in _MODELS:
        raise DataError(
            f"{path}: model must be one of {', '.join(_MODELS)}, got {shown(content.get('model'))}"
        )
    try:
        effects = tuple(_effect(entry, ids) for entry in content["effects"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DataError(f"{path}: effects must be a list of id and parameters: {error}") from None
    return Extension(
        model=content["model"],
        effects=effects,
        structure=_structure(content, path),
        vehicle_model=_vehicle_model(content, path),
    )


def _structure(content: Mapping[str, Any], path: str | Path) -> str | None:
    text = content.get("structure")
    if text is None:
        return None
    try:
        if not isinstance(text, str):
            raise InvalidParameter(f"it must be text, got {text!r:.80}")
        read_structure(text)
    except InvalidParameter as error:
        raise DataError(f"{path}: structure: {error}") from None
    return text


def _vehicle_model(content: Mapping[str, Any], path: str | Path) -> str | None:
    name = content.get("vehicle_model")
    if name is not None and name not in _VEHICLE_MODELS:
        raise DataError(
            f"{path}: vehicle_model must be one of {', '.join(_VEHICLE_MODELS)}, got {name!r:.80}"
        )
    return None if name is None else str(name)


def _effect(entry: dict[str, Any], ids: Mapping[str, str]) -> tuple[str, dict[str, float]]:
    """Effect and parameters of an entry; ``ids`` leads from an id in the file to the one of today."""
    effect = find_effect(ids.get(entry["id"], entry["id"]))
    values = {str(name): float(value) for name, value in entry["parameters"].items()}
    names = {parameter.name for parameter in effect.parameters}
    if set(values) != names or not all(map(math.isfinite, values.values())):
        raise InvalidParameter(f"{effect.id} takes {', '.join(sorted(names))}, each a number")
    for parameter in effect.parameters:
        parameter.check(values[parameter.name], effect.id)
    return effect.id, values
