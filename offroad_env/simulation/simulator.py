"""Plants and runs: the thin typed layer over the kernels.

A `Plant` is everything a model needs besides its state. The truth of an environment and the
belief of a filter or controller are two plants, and may differ.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics.axle import Plant, contact_shape
from offroad_env.physics.batch import PLAIN_COMMAND, WHEEL_COMMAND, full_rows
from offroad_env.physics.contact import SUNK
from offroad_env.physics.four_wheel_settle import settle_four_wheels
from offroad_env.physics.packing import pack
from offroad_env.physics.paper_vehicle import simulate_paper
from offroad_env.physics.records import (
    FourWheel,
    Ground,
    Soil,
    SoilField,
    SoilMap,
    Structure,
    Tyre,
    Vehicle,
    Wheel,
)
from offroad_env.physics.settle import settle
from offroad_env.world.argument_checks import is_one_of, numbers, one_number, require_record
from offroad_env.world.four_wheel import make_four_wheel
from offroad_env.world.soil_fields import require_positive_modulus
from offroad_env.world.structures import read_structure
from offroad_env.world.tyres import read_tyre, require_fitting_tyre, with_tyre
from offroad_env.world.yaml_text import shown

__all__ = [
    "FULL_STEP",
    "PAPER_SLIP",
    "Plant",
    "Trajectory",
    "make_plant",
    "plant_model",
    "settled_state",
    "simulate",
    "simulate_commands",
]

#: Step of the full model [s]; what halving it changes is tested and stated in the tests.
FULL_STEP = 0.005

#: Constant slip of the paper's model by soil [-], the paper gives none;
#: `estimators.experiments.buzhardt_tallapragada` has the method.
PAPER_SLIP = {"clay": 0.0275, "dry_sand": -0.0785}

MODELS = ("full", "paper")
#: Vehicle models of environment and filters; `make_plant` also takes "four_wheel".
VEHICLE_MODELS = ("half_car", "bicycle")


@dataclass(frozen=True, kw_only=True)
class Trajectory:
    """A run. Row i belongs to ``t[i]``; columns are indexed by ``offroad_env.physics.state``."""

    t: np.ndarray  #: (T,) time [s]
    states: np.ndarray  #: (T, 15) vehicle states; with four wheels (T, 19)
    readings: np.ndarray  #: (T, 32) wheel forces, loads, sinkages, accelerations; with four wheels (T, 85)
    status: float  #: worst contact status: 0 contact, 1 some wheel was airborne


def _choice(name: str, value: str, allowed: tuple[str, ...]) -> str:
    if not is_one_of(value, allowed):
        raise InvalidParameter(f"{name} must be one of {', '.join(allowed)}, got {shown(value)}")
    return value


def make_plant(  # noqa: PLR0913 - a plant's options are its interface
    vehicle: Vehicle,
    soil: Soil,
    ground: Ground,
    *,
    model: str = "full",
    vehicle_model: str = "half_car",
    slip: float = 0.0,
    soil_map: SoilMap | None = None,
    four_wheel: FourWheel | None = None,
    structure: str | Structure | None = None,
    tyre: str | Tyre | None = None,
    soil_field: SoilField | None = None,
) -> Plant:
    """Bundle validated parts into what the kernels take.

    Parameters
    ----------
    model : {"full", "paper"}
        Decides the shear law (resultant or independent) and the low-speed regularisation.
    vehicle_model : {"half_car", "bicycle", "four_wheel"}
        "bicycle" holds the static axle loads; heave and pitch do not move. "four_wheel" adds roll and a
        contact for every wheel; needs the full model and two wheels an axle.
    slip : float
        Constant slip of the paper's model [-], in (-1, 1).
    soil_map : SoilMap, optional
        Where n differs from ``soil.n``.
    four_wheel : FourWheel, optional
        Roll, steering and driveline of a vehicle with four wheels, see `world.four_wheel`; by default the
        rules of `make_four_wheel`.
    structure : str or Structure, optional
        Laws of the wheels, by a name that `world.structures.read_structure` knows. None or "full": a rigid
        rim with Wong-Reece contact angles. "paper" is a ``model``.
    tyre : str or Tyre, optional
        Flexible tyres, by a name in `world.tyres.TYRES` or from `make_tyre`; None: rigid rims. They need a
        structure whose pressure acts along the ground's normal, such as "grid" or "field".
    soil_field : SoilField, optional
        How the whole soil varies, from `world.natural_soil.natural_soil`, for a deformable soil.
    """
    require_record("vehicle", vehicle, Vehicle, "make_vehicle or VEHICLES")
    require_record("soil", soil, Soil, "make_soil or SOILS")
    require_record("ground", ground, Ground, "offroad_env.world.terrain")
    _choice("model", model, MODELS)
    _choice("vehicle_model", vehicle_model, (*VEHICLE_MODELS, "four_wheel"))
    slip = one_number("slip", slip)
    four_wheel = _four_wheel(vehicle, model, vehicle_model, four_wheel)
    if not -1.0 < slip < 1.0:
        raise InvalidParameter(f"slip must be in (-1, 1), got {slip} - in percent?")
    require_positive_modulus(soil, vehicle.b)
    if soil_field is not None and soil.rigid > 0.5:
        raise InvalidParameter("soil_field must be None on hard ground, which has no parameters of soil")
    if soil_map is None:
        soil_map = SoilMap(0.3, np.empty((0, 4)))
    full = model == "full"
    return Plant(
        vehicle=vehicle,
        soil=soil,
        ground=ground,
        soil_map=soil_map,
        slip=float(slip),
        resultant=1.0 if full else 0.0,
        half_car=0.0 if vehicle_model == "bicycle" else 1.0,
        # Below this speed resistance is viscous. Hard ground is stiffer than soil: it needs a wider seam.
        v_eps=(0.3 if soil.rigid else 0.2) if full else 1e-3,
        fine=False,
        four_wheel=four_wheel,
        structure=_wheel_laws(structure, model, read_tyre(tyre), Wheel(vehicle.r, vehicle.b)),
        soil_field=soil_field,
    )


def _of_plant(plant: Plant, state: np.ndarray, warm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """State and warm start as arrays of the plant's own shapes, copied."""
    require_record("plant", plant, Plant, "make_plant")
    found = numbers("state", state), numbers("warm", warm)
    for name, array, shape in zip(("state", "warm"), found, _shapes(plant), strict=True):
        if array.shape != shape:
            raise InvalidParameter(
                f"{name} must be an array {shape}, as settled_state makes it for the plant, got {array.shape}"
            )
    return found


def _shapes(plant: Plant) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Shapes of the state and of the warm start of a plant."""
    size, _ = at.sizes(plant.four_wheel)
    return (size,), contact_shape(plant.structure, plant.four_wheel)


def _four_wheel(
    vehicle: Vehicle, model: str, vehicle_model: str, given: FourWheel | None
) -> FourWheel | None:
    """What a plant of this vehicle model holds of four wheels."""
    if vehicle_model != "four_wheel":
        if given is not None:
            raise InvalidParameter(
                f"four_wheel belongs to vehicle_model 'four_wheel', got {shown(vehicle_model)}"
            )
        return None
    if model != "full":
        raise InvalidParameter(f"vehicle_model 'four_wheel' needs model 'full', got {shown(model)}")
    return make_four_wheel(vehicle) if given is None else given


def _wheel_laws(
    structure: str | Structure | None, model: str, tyre: Tyre | None, wheel: Wheel
) -> Structure | None:
    """The structure of a plant, its tyre included; None for the model's own wheels."""
    if model == "paper" and (tyre is not None or not is_one_of(structure, (None, "paper"))):
        raise InvalidParameter(
            f"the paper's model has wheels of its own; for structure={structure!r} take model='full'"
        )
    if isinstance(structure, str) and (tyre is not None or structure != model):
        structure = read_structure(structure)
    if tyre is not None:
        structure = with_tyre(structure, tyre)  # type: ignore[arg-type]  # a text was read
    if structure is None or isinstance(structure, str):
        return None
    laws = require_record("structure", structure, Structure, "make_structure, or a name")
    if laws.tyre is not None:
        require_fitting_tyre(laws.tyre, wheel)
    return laws


def plant_model(plant: Plant) -> str:
    """Which preset a plant was made for: "full" or "paper"."""
    return "full" if plant.resultant > 0.5 else "paper"


def settled_state(
    plant: Plant, *, x: float = 0.0, y: float = 0.0, yaw: float = 0.0, v_x: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """State and warm start of a vehicle settled on its soil, rolling at ``v_x`` [m/s].

    Returns
    -------
    tuple of two ndarrays
        State (15,) and contact state (2, columns); with four wheels (19,) and (4, columns): `contact_shape`.

    Raises
    ------
    SolverFailure
        When the soil cannot carry the vehicle, or no rest is found.
    """
    require_record("plant", plant, Plant, "make_plant")
    pose = (one_number("x", x), one_number("y", y), one_number("yaw", yaw))
    soil = plant.soil
    if soil.rigid <= 0.5 and not min(soil.k_x, soil.k_y) > 0.0:
        # Records may be changed without `make_soil`, and no rolling is found where shear has no length.
        raise SolverFailure(
            f"the shear moduli of the soil must be positive, got {soil.k_x:g} and {soil.k_y:g} m"
        )
    rest = settle if plant.four_wheel is None else settle_four_wheels
    status, state, warm = rest(plant, pose, one_number("v_x", v_x))
    if status >= SUNK:
        raise SolverFailure(
            f"the soil (n = {plant.soil.n:g}) does not carry the vehicle ({plant.vehicle.m:g} kg): "
            f"a wheel of radius {plant.vehicle.r:g} m sinks beyond 0.95 of it"
        )
    if not np.isfinite(state).all():
        raise SolverFailure(f"the vehicle ({plant.vehicle.m:g} kg) finds no rest on its soil or ground")
    return state, warm


#: Most steps of one simulation.
_MOST_STEPS = 100_000_000


def _steps(name: str, duration: float, dt: float) -> int:
    """Whole steps of ``dt`` [s] in a time [s]."""
    duration, dt = one_number(name, duration), one_number("dt", dt)
    if not (dt > 0.0 and 0.0 < duration <= _MOST_STEPS * dt):
        raise InvalidParameter(
            f"{name} and dt must be positive times with at most {_MOST_STEPS} steps, got {duration:g} s "
            f"and {dt:g} s"
        )
    return round(duration / dt)


def _sampled(name: str, value: float | Callable[[float], float], times: np.ndarray) -> np.ndarray:
    if not callable(value):
        return np.full(times.shape, one_number(name, value))
    try:
        found = numbers(name, [value(float(t)) for t in times])
    except TypeError as error:
        raise InvalidParameter(f"{name} must be a number or a function of time: {error}") from None
    if found.shape != times.shape:
        raise InvalidParameter(f"{name} must give one number at a time, got {shown(found)}")
    return found


def simulate(
    plant: Plant,
    state: np.ndarray,
    warm: np.ndarray,
    *,
    steer: float | Callable[[float], float] = 0.0,
    force: float | Callable[[float], float] = 0.0,
    speed_rate: Callable[[float], float] | None = None,
    duration: float,
    dt: float = 0.01,
) -> Trajectory:
    """Run the paper's model by RK4 with inputs as functions of time.

    Parameters
    ----------
    steer, force : float or callable
        Steering angle [rad] and body force F_u [N] at time t [s].
    speed_rate : callable, optional
        dv_x/dt [m/s^2] at time t: prescribes the longitudinal speed instead of the force balance.
    duration, dt : float
        Length and step [s].

    Raises
    ------
    SolverFailure
        When a contact has no solution or the state is not finite, with the time it happened.
    """
    state, warm = _of_plant(plant, state, warm)
    if plant_model(plant) != "paper":
        raise InvalidParameter(
            "simulate runs the paper's model; for one of the full model take simulate_commands"
        )
    steps = _steps("duration", duration, dt)
    half_steps = 0.5 * dt * np.arange(2 * steps + 1)
    rate = np.full(half_steps.shape, math.nan)
    if speed_rate is not None:
        rate = _sampled("speed_rate", speed_rate, half_steps)
    pair = _sampled("steer", steer, half_steps), _sampled("force", force, half_steps)
    inputs = np.stack([*pair, rate], axis=1)
    states, readings = np.empty((steps + 1, at.STATE_SIZE)), np.empty((steps + 1, at.READINGS_SIZE))
    status, done = simulate_paper(state.copy(), warm.copy(), inputs, plant, float(dt), states, readings)
    if done < steps:
        raise SolverFailure(f"the simulation failed at t = {done * dt:.3f} s (contact status {status:g})")
    return Trajectory(t=half_steps[::2], states=states, readings=readings, status=status)


def _checked_commands(commands: np.ndarray, four_wheel: FourWheel | None) -> np.ndarray:
    rows = np.ascontiguousarray(numbers("commands", commands))
    widths = (3,) if four_wheel is None else (3, 7)
    if rows.ndim != 2 or rows.shape[1] not in widths:
        more = "" if four_wheel is None else ", or (K, 7): and the four wheels"
        raise InvalidParameter(f"commands must be (K, 3): steer, drive, brake{more}, got shape {rows.shape}")
    if four_wheel is not None and four_wheel.servo > 0.0 and rows.shape[1] == 3:
        raise InvalidParameter(
            "commands must be (K, 7) where a servo turns the wheels: their speeds are missing"
        )
    if not np.isfinite(rows).all():
        raise InvalidParameter("commands must be finite, got NaN or infinity")
    return rows


def simulate_commands(
    plant: Plant,
    state: np.ndarray,
    warm: np.ndarray,
    commands: np.ndarray,
    *,
    interval: float = 0.02,
    dt: float = FULL_STEP,
) -> Trajectory:
    """Run the full model under held commands.

    Parameters
    ----------
    commands : array (K, 3)
        Steering angle [rad], total drive torque [N m], total brake torque [N m], each held for
        ``interval`` [s]. With four wheels also (K, 7): then a torque for each wheel [N m] beside that of
        the driveline, front left, front right, rear left, rear right; where the plant has a servo, their
        speeds [rad/s].

    Returns
    -------
    Trajectory
        K + 1 rows, one per command boundary; the readings are those of the state in the same row.

    Raises
    ------
    InvalidParameter
        When ``commands`` are not rows of three finite numbers, or ``interval`` is no multiple of ``dt``.
    SolverFailure
        When a contact has no solution or the state is not finite, with the time it happened.
    """
    state, warm = _of_plant(plant, state, warm)
    if plant_model(plant) != "full":
        raise InvalidParameter("commands drive the full model; for a plant of the paper's take simulate")
    commands = _checked_commands(commands, plant.four_wheel)
    steps = _steps("interval", interval, dt)
    if steps < 1 or abs(steps * dt - interval) > 1e-9 * interval:
        raise InvalidParameter(f"interval must be a multiple of dt = {dt:g} s, got {interval:g} s")
    packed = pack(plant)
    alone = packed._replace(numbers=packed.numbers[None])
    start = np.array(state, dtype=np.float64)[None], np.array(warm, dtype=np.float64)[None]
    rows = len(commands) + 1
    states, readings = (np.empty((rows, 1, size)) for size in at.sizes(plant.four_wheel))
    found = states, readings, np.empty((1, 2))
    sort = PLAIN_COMMAND if commands.shape[1] == 3 else WHEEL_COMMAND
    full_rows(alone, start, commands[None], (float(dt), steps), (0, 1), found, sort)
    worst, done = found[2][0].tolist()
    if done < len(commands):
        raise SolverFailure(
            f"the simulation failed at t = {done * interval:.3f} s (contact status {worst:g})"
        )
    return Trajectory(
        t=interval * np.arange(rows), states=states[:, 0], readings=readings[:, 0], status=worst
    )
