"""Arguments of the environment and options of its reset, checked at the border."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

import numpy as np

from estimators.filters.online import KINDS, OnBoard
from estimators.filters.registry import filter_id
from offroad_env.environment.episode_records import CONTROL_PERIOD, PAPER_FORCE, SAMPLES
from offroad_env.environment.randomisation import Randomisation, checked_context
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics.records import Ground, Soil, Vehicle
from offroad_env.simulation.drive import Command
from offroad_env.simulation.simulator import make_plant, settled_state
from offroad_env.world.argument_checks import is_one_of, numbers
from offroad_env.world.catalogue import Quantity
from offroad_env.world.descriptions import read_soil, read_vehicle
from offroad_env.world.soil_fields import SOIL_RANGES
from offroad_env.world.soils import make_soil, with_exponent
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import make_vehicle
from offroad_env.world.yaml_text import shown

__all__ = [
    "COMPILED",
    "SOIL_BELIEF",
    "Mismatch",
    "ResetOptions",
    "believed_range",
    "checked_actions",
    "checked_estimator",
    "checked_range",
    "command_of",
    "read_on_board",
    "require_bearing",
    "require_choice",
    "require_count",
    "require_mapping",
    "require_rate",
    "require_seed",
]


#: The online filter that is part of the compiled control period.
COMPILED = "online_parameter_ukf"
#: The one whose belief ``terrain_info="belief"`` shows, and its updates a second [Hz]: one a control period.
SOIL_BELIEF, _BELIEF_RATE = "online_soil_belief", 1.0 / CONTROL_PERIOD


def require_choice(name: str, value: object, allowed: tuple[str | None, ...]) -> None:
    """Refuse a ``value`` that is none of the ``allowed`` ones."""
    if not is_one_of(value, allowed):
        raise InvalidParameter(f"{name} must be one of {', '.join(map(str, allowed))}, got {shown(value)}")


def read_on_board(given: Mapping[str, Any]) -> OnBoard:
    """An `OnBoard` from a mapping of its fields, in which a specification in JSON has it.

    Raises
    ------
    InvalidParameter
        For other keys, or what `OnBoard` refuses.
    """
    known = [entry.name for entry in fields(OnBoard)]
    if not set(given) <= set(known):
        raise InvalidParameter(f"estimator must hold {', '.join(known)}, got {shown(given)}")
    values = dict(given)
    for name, read in (("vehicle", read_vehicle), ("soil", read_soil)):
        if values.get(name) is not None:
            values[name] = read(values[name]).record
    ground = values.get("ground")
    if isinstance(ground, Mapping):
        try:
            height, slope_x, slope_y = (float(ground[name]) for name in ("H_0", "S_x", "S_y"))
            waves = numbers("waves", ground["waves"]).reshape(-1, 4)
        except (KeyError, TypeError, ValueError) as error:
            raise InvalidParameter(f"estimator: ground must hold H_0, S_x, S_y and waves: {error}") from error
        values["ground"] = Ground(H_0=height, S_x=slope_x, S_y=slope_y, waves=waves)
    return OnBoard(**values)


def checked_estimator(
    estimator: str | OnBoard | Mapping[str, Any] | None, terrain_info: str, model: object
) -> str | OnBoard:
    """Which estimator runs; by default the compiled one, where it is observed."""
    if isinstance(estimator, Mapping):
        estimator = read_on_board(estimator)
    if estimator is None:
        estimator = {"estimate": COMPILED, "belief": SOIL_BELIEF}.get(terrain_info, "none")
    elif not isinstance(estimator, OnBoard):
        estimator = filter_id(estimator, KINDS, label="estimator", besides=("none",))
    if terrain_info == "estimate" and estimator == "none":
        raise InvalidParameter('terrain_info="estimate" needs an estimator, got estimator="none"')
    kind = estimator.kind if isinstance(estimator, OnBoard) else estimator
    if terrain_info == "belief" and kind != SOIL_BELIEF:
        raise InvalidParameter(f'terrain_info="belief" needs estimator={SOIL_BELIEF!r}, got {kind!r}')
    if kind == SOIL_BELIEF and model == "paper":
        # Its wheels have no spin of their own.
        what = f'estimator {SOIL_BELIEF!r} (terrain_info="belief")'
        raise InvalidParameter(f'{what} needs model="full", got model="paper"')
    if isinstance(estimator, OnBoard) or estimator in ("none", COMPILED):
        return estimator
    if kind == SOIL_BELIEF:
        # Courses are level but for their roughness, or the hill is in the map.
        return OnBoard(kind=estimator, rate=_BELIEF_RATE, grade=0.0)
    return OnBoard(kind=estimator)


def require_count(name: str, value: object, *, least: int = 1) -> int:
    """A whole number as an int.

    Raises
    ------
    InvalidParameter
        For anything else, and for less than ``least``.
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise InvalidParameter(f"{name} must be a whole number >= {least}, got {shown(value)}")
    return int(value)


def checked_actions(name: str, given: object, shape: tuple[int, ...]) -> np.ndarray:
    """Actions as floats: finite numbers of a shape.

    Raises
    ------
    InvalidParameter
        For anything else; text with digits is no number.
    """
    # What a policy gives, in a twentieth of the time of the checks below.
    if type(given) is np.ndarray and given.dtype.kind == "f" and given.shape == shape == (2,):
        plain = given.tolist()
        if math.isfinite(plain[0]) and math.isfinite(plain[1]):
            return given.astype(np.float64)
    try:
        values: np.ndarray | None = numbers(name, given)
    except InvalidParameter:
        values = None
    if values is None or values.shape != shape or not np.isfinite(values).all():
        what = "2 finite numbers (steer, drive)" if shape == (2,) else f"{shape} finite numbers"
        raise InvalidParameter(f"{name} must be {what}, got {shown(given)}")
    return values


def require_mapping(name: str, given: object) -> dict[str, Any]:
    """Options as a dictionary; None is none.

    Raises
    ------
    InvalidParameter
        For anything but a mapping with names as keys.
    """
    if given is None:
        return {}
    if not isinstance(given, Mapping) or not all(isinstance(key, str) for key in given):
        raise InvalidParameter(f"{name} must be a mapping of names to values, got {shown(given)}")
    return dict(given)


def require_seed(seed: object) -> int | None:
    """A seed as Gymnasium takes it: it knows no numpy integers, and refuses with an error of its own.

    Raises
    ------
    InvalidParameter
        For anything but None and whole numbers from 0 on.
    """
    if seed is None:
        return None
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InvalidParameter(f"seed must be None or a whole number >= 0, got {shown(seed)}")
    return int(seed)


def require_rate(rate: float) -> None:
    """Refuse sensors whose clock is not that of the control period."""
    expected = SAMPLES / CONTROL_PERIOD
    if rate != expected:
        raise InvalidParameter(
            f"imu.rate of the environment's sensors must be {expected:g} Hz, got {rate:g} Hz"
        )


def checked_range(limits: Any, soil: Soil) -> tuple[float, float]:
    """``n_range`` as two floats, both of which the soil accepts."""
    try:
        low, high = (float(value) for value in limits)
    except (TypeError, ValueError) as error:
        raise InvalidParameter(f"n_range must be (low, high), got {shown(limits)}") from error
    if not low <= high:
        raise InvalidParameter(f"n_range must be (low, high) with low <= high, got {shown(limits)}")
    for n in (low, high):
        make_soil(soil, n=n)
    return low, high


def believed_range(limits: tuple[float, float]) -> tuple[float, float]:
    """``n_range``, widened to 0.1 where it holds a single soil: a filter needs something to estimate."""
    low, high = limits
    widen = max(0.05 - 0.5 * (high - low), 0.0)
    return max(low - widen, 0.06), high + widen


def command_of(vehicle: Vehicle, model: str, action: Sequence[float]) -> Command:
    """An action as a command: steering [rad], drive and brake torque [N m] (paper: force, NaN)."""
    steer, drive = action
    angle = steer * vehicle.steer_max
    if model == "paper":
        return angle, drive * PAPER_FORCE * vehicle.m, math.nan
    return angle, max(drive, 0.0) * vehicle.drive_torque_max, max(-drive, 0.0) * vehicle.brake_torque_max


def require_bearing(
    vehicle: Vehicle, soil_name: str, soil: Soil, n_range: tuple[float, float], model: str
) -> None:
    """Refuse a range of soils in which the standing vehicle drowns: a reset would fail much later."""
    for n in n_range:
        try:
            settled_state(make_plant(vehicle, make_soil(soil, n=n), flat(), model=model))
        except SolverFailure as error:
            if n_range[0] == n_range[1]:
                raise InvalidParameter(f"{soil_name!r} drowns the vehicle: {error}") from error
            raise InvalidParameter(
                f"n_range {n_range} of {soil_name!r} reaches soil that drowns it: {error} "
                "- give n_range=(low, high) of soils that carry it"
            ) from error


class Mismatch(NamedTuple):
    """Factors by which the truth differs from the nominal vehicle and soil."""

    mass: float
    k_phi: float
    lag: float  #: of the drive torque


_FACTOR = Quantity("in [0.1, 10]", 0.1, 10.0)


def _mismatch(given: Any) -> Mismatch:
    """Three factors, checked."""
    try:
        mass, k_phi, lag = given
    except (TypeError, ValueError):
        raise InvalidParameter(
            f"mismatch must be three factors (mass, k_phi, lag), got {shown(given)}"
        ) from None
    named = (("mass", mass), ("k_phi", k_phi), ("lag", lag))
    return Mismatch(*(_FACTOR.check(f"mismatch: {name}", value) for name, value in named))


@dataclass(frozen=True, kw_only=True)
class ResetOptions:
    """Options of `OffroadBekkerEnv.reset`."""

    n: float | None = None  #: sinkage exponent of the true soil [-]; None: drawn
    mismatch: Mismatch | None = None
    context: Mapping[str, Any] = field(default_factory=dict)  #: what is set instead of drawn, by its key

    @classmethod
    def read(cls, options: Mapping[str, Any] | None) -> ResetOptions:
        """The options of a call; refuses other keys than "n", "mismatch" and "context"."""
        options = require_mapping("options", options)
        unknown = set(options) - {"n", "mismatch", "context"}
        if unknown:
            raise InvalidParameter(
                f'options may hold "n", "mismatch" and "context", got {", ".join(sorted(unknown))}'
            )
        mismatch = options.get("mismatch")
        if mismatch is not None:
            mismatch = _mismatch(mismatch)
        n = options.get("n")
        return cls(
            n=None if n is None else SOIL_RANGES["n"].check("n", n),
            mismatch=mismatch,
            context=checked_context(require_mapping("context", options.get("context"))),
        )

    def drawn(self, randomisation: Randomisation | None, rng: np.random.Generator) -> dict[str, Any]:
        """The context of an episode: what is drawn, but for what is set."""
        found = {} if randomisation is None else randomisation.draw(rng)
        for key in self.context:  # two spellings of one key
            if key in ("n", "soil.n"):
                found.pop({"n": "soil.n", "soil.n": "n"}[key], None)
        found |= self.context
        if self.n is not None:
            found |= {key: float(self.n) for key in ("n", "soil.n") if key in found}
        return found

    def truth(self, vehicle: Vehicle, soil: Soil, drawn: float | None) -> tuple[Vehicle, Soil]:
        """The true vehicle and soil: nominal, but for n (None: that of the soil) and the mismatch."""
        n = soil.n if drawn is None else drawn
        if self.n is not None:
            n = make_soil(soil, n=self.n).n
        if self.mismatch is None:
            return vehicle, with_exponent(soil, n)
        mass, k_phi, lag = self.mismatch
        return (
            make_vehicle(vehicle, m=mass * vehicle.m, torque_lag=lag * vehicle.torque_lag),
            make_soil(soil, n=n, k_phi=k_phi * soil.k_phi),
        )
