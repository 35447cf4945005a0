"""Every filter for the sinkage exponent by one id, with what it needs and the short names it goes by.

An id says where the filter runs and what it is:

- ``parameter_ukf``: the paper's, for n alone, on a state that is propagated or known;
- ``map_...`` and ``augmented_ekf_bank``: the paper's half-car with its whole state, over a known ground;
- ``online_...``: what a vehicle runs while it drives, on any vehicle model, without a map.

`estimators.filters.whole_run` runs any of them over a whole run. Nothing heavy is imported here: the
environment reads this table.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NamedTuple

from estimators.filters.protocol import Estimator
from offroad_env.errors import InvalidParameter
from offroad_env.physics.axle import Plant
from offroad_env.simulation.sensors import GnssConfig, ImuConfig
from offroad_env.world.yaml_text import shown

__all__ = [
    "FILTERS",
    "MAP_FILTERS",
    "ONLINE_FILTERS",
    "SENSORS",
    "SOIL_FILTERS",
    "FilterEntry",
    "OnlineSetup",
    "filter_id",
]

#: Sensors -> columns of `estimators.filters.joint_ukf.CHANNELS` that they measure.
SENSORS: dict[str, tuple[int, ...]] = {
    "imu": (0, 1, 2, 3, 4),
    "imu+wheels": (0, 1, 2, 3, 4, 5, 6),
    "imu+wheels+gnss": tuple(range(11)),
}
#: Hypotheses of an online bank at the start: each covers a fifth of the prior.
_COMPONENTS = 5


class OnlineSetup(NamedTuple):
    """What an online filter is made with."""

    belief: Plant  #: the filter's own model of vehicle, soil and ground
    n_range: tuple[float, float]  #: bounds of n [-]
    dt: float  #: time between samples [s]
    imu: ImuConfig
    gnss: GnssConfig
    changing: bool = False  #: n is known to change every few tens of metres
    grade: float | None = None  #: standard deviation of the ground's slope beyond its map; None: the filter's


# Each filter is imported where it is made: its kernels take as long to read as those of a vehicle.
def _parameter_filter(setup: OnlineSetup) -> Estimator:
    from estimators.filters.online_parameter_ukf import CHANGING_SOIL, OnlineParameterUKF

    settings = CHANGING_SOIL if setup.changing else None
    return OnlineParameterUKF(
        setup.belief, setup.n_range, dt=setup.dt, imu=setup.imu, gnss=setup.gnss, settings=settings
    )


def _joint_filter(setup: OnlineSetup) -> Estimator:
    from estimators.filters.online_joint_ukf import OnlineJointUKF

    return OnlineJointUKF(setup.belief, setup.n_range, dt=setup.dt, imu=setup.imu, gnss=setup.gnss)


def _joint_bank(setup: OnlineSetup) -> Estimator:
    from estimators.filters.online_joint_ukf import OnlineJointSettings, OnlineJointUKF

    settings = OnlineJointSettings(components=_COMPONENTS)
    return OnlineJointUKF(
        setup.belief, setup.n_range, dt=setup.dt, imu=setup.imu, gnss=setup.gnss, settings=settings
    )


def _soil_belief(setup: OnlineSetup) -> Estimator:
    from estimators.filters.online_soil_belief import OnlineSoilBelief, SoilBeliefSettings

    settings = None if setup.grade is None else SoilBeliefSettings(grade=setup.grade)
    return OnlineSoilBelief(
        setup.belief, setup.n_range, dt=setup.dt, imu=setup.imu, gnss=setup.gnss, settings=settings
    )


@dataclass(frozen=True, kw_only=True)
class FilterEntry:
    """One filter."""

    id: str
    title: str
    model: str  #: its model of the vehicle and of the ground
    sensors: str  #: the least that it needs, of `SENSORS`
    more_sensors: bool  #: it uses the others where they are measured
    module: str  #: that it lives in
    aliases: tuple[str, ...]  #: short names
    whole_soil: bool = False  #: every number of the soil is unknown to it, not n alone
    exact_model: bool = True  #: it takes its model for exact: its interval holds given that model
    make: Callable[[OnlineSetup], Estimator] | None = None  #: of an online filter, sample by sample


_ON_MAP = "the paper's half-car, on a map of the ground"
_ONLINE = "any vehicle model, on level ground"


def _on_map(known: str, title: str, module: str, *aliases: str) -> FilterEntry:
    return FilterEntry(
        id=known,
        title=title,
        model=_ON_MAP,
        sensors="imu",
        more_sensors=True,
        module=f"estimators.filters.{module}",
        aliases=aliases,
    )


def _parameter(known: str, state: str, *aliases: str) -> FilterEntry:
    return FilterEntry(
        id=known,
        title=f"parameter UKF, state {state}",
        model=f"the paper's half-car or bicycle, state {state}, on a map of the ground",
        sensors="imu",
        more_sensors=False,
        module="estimators.filters.parameter_ukf",
        aliases=aliases,
    )


def _while_driving(
    known: str, title: str, module: str, make: Callable[[OnlineSetup], Estimator], *aliases: str
) -> FilterEntry:
    return FilterEntry(
        id=known,
        title=title,
        model=_ONLINE,
        sensors="imu+wheels+gnss",
        more_sensors=False,
        module=f"estimators.filters.{module}",
        aliases=aliases,
        make=make,
    )


_ENTRIES = (
    _parameter("parameter_ukf", "propagated", "propagated", "paper"),
    _parameter("parameter_ukf_known_state", "known", "known"),
    _on_map("map_joint_ukf", "joint UKF on a map", "joint_ukf", "map_joint", "joint"),
    _on_map("map_ekf", "joint EKF on a map", "ekf", "ekf"),
    _on_map("map_particle_filter", "particle filter on a map", "particle", "particle"),
    _on_map("map_ukf_bank", "bank of joint UKFs on a map", "joint_bank", "map_bank", "bank"),
    _on_map("map_smoother", "batch smoother (reference)", "smoother", "smoother"),
    FilterEntry(
        id="augmented_ekf_bank",
        title="bank of augmented EKFs on a map",
        model="the paper's half-car with unknown mass, moduli, sensors and steering, on a map of the ground",
        sensors="imu+wheels",
        more_sensors=False,
        module="estimators.filters.augmented_ekf_bank",
        aliases=("robust",),
        exact_model=False,
    ),
    _while_driving(
        "online_parameter_ukf",
        "online parameter UKF",
        "online_parameter_ukf",
        _parameter_filter,
        "parameter",
        "embedded",
    ),
    _while_driving("online_joint_ukf", "online joint UKF", "online_joint_ukf", _joint_filter, "joint"),
    _while_driving("online_ukf_bank", "online bank of joint UKFs", "online_joint_ukf", _joint_bank, "bank"),
    FilterEntry(
        id="online_soil_belief",
        title="online belief over whole soils",
        model="half-car or bicycle of the full model, on level ground; soil, mass and sensors unknown",
        sensors="imu+wheels+gnss",
        more_sensors=False,
        module="estimators.filters.online_soil_belief",
        aliases=("belief",),
        whole_soil=True,
        exact_model=False,
        make=_soil_belief,
    ),
)
FILTERS: dict[str, FilterEntry] = {entry.id: entry for entry in _ENTRIES}
#: Ids of the filters that run sample by sample while the vehicle drives: for n, and for the whole soil.
ONLINE_FILTERS = tuple(
    entry.id for entry in FILTERS.values() if entry.make is not None and not entry.whole_soil
)
SOIL_FILTERS = tuple(entry.id for entry in FILTERS.values() if entry.whole_soil)
#: Ids of the filters that estimate the whole state of the paper's half-car over a known ground.
MAP_FILTERS = tuple(entry.id for entry in FILTERS.values() if entry.model == _ON_MAP)


def filter_id(
    name: str, among: Iterable[str] = FILTERS, *, label: str = "filter", besides: tuple[str, ...] = ()
) -> str:
    """The id that a name stands for.

    Parameters
    ----------
    name : str
        An id or a short name.
    among : iterable of str
        Ids to choose from. Of two filters that share a short name, the first is meant.
    label : str
        How a refusal names the argument.
    besides : tuple of str
        Words that are no filters and are returned as they are, such as "none".

    Raises
    ------
    InvalidParameter
        For a name that stands for none of them.
    """
    if not isinstance(name, str):
        raise InvalidParameter(f"{label} must be the name of a filter, got {shown(name)}")
    ids = tuple(among)
    if name in ids or name in besides:
        return name
    for known in ids:
        if name in FILTERS[known].aliases:
            return known
    short = ", ".join(dict.fromkeys(alias for known in ids for alias in FILTERS[known].aliases))
    raise InvalidParameter(
        f"{label} must be one of {', '.join((*ids, *besides))} (short names: {short}), got {shown(name)}"
    )
