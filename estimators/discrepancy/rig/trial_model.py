"""Forward model of steady trials on a wheel rig: conditions, splits, predicted samples.

The counterpart of `run_model` for logs without time: a trial is one balance of the wheel's contact, through
the same kernel and the same hooks of effects as an axle of the vehicle.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.discrepancy.model.nuisances import NUISANCES
from estimators.discrepancy.model.protocol import Channel, ForwardModel, Nuisance, Records
from estimators.discrepancy.model.windows import FIT, REPORT, SELECT, Windows
from estimators.logs.log import Log
from offroad_env.effects import RigSetup, Setup
from offroad_env.errors import DataError, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.axle import AxleStance, Plant, axle_contact
from offroad_env.physics.contact import NO_ROOT, Support
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.records import FloatArray, WheelMotion
from offroad_env.simulation.sensors import ImuConfig
from offroad_env.simulation.simulator import make_plant
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import VEHICLES

__all__ = ["RIG_CHANNELS", "RigModel", "Trials", "trials_of"]

#: Channel of a rig -> its index in the readings of the model.
RIG_CHANNELS = {"sinkage": at.SINKAGE, "drawbar": at.F_L, "side_force": at.F_C, "torque": at.TORQUE}
#: Settings that lie nearer than this are repeats of one: slip angle [rad], slip [-], share of the load.
_SAME_ANGLE, _SAME_SLIP, _SAME_LOAD = 0.02, 0.02, 0.15
#: Fewer conditions than this leave none for a hold-out test of the search.
_FEWEST = 15
#: A wheel that spins on the spot, short of 0 / 0.
_SPINNING = 1.0 - 1e-9
#: Finite difference of the ground's parameter: trials determine it to some hundredths, and have no bumps.
_GROUND_STEP = 0.005
#: Of all nuisances of a drive, trials have the ground alone.
_NUISANCES = tuple(replace(own, step=_GROUND_STEP) for own in NUISANCES if own.name == "ground")


@kernel
def _balance(plant: Plant, motions: FloatArray, loads: FloatArray, readings: FloatArray) -> float:
    """Contact of every trial on its own; returns the worst status. ``motions`` = (r omega, v_l, v_c)."""
    worst = 0.0
    warm = np.zeros(at.STRUCTURED_CONTACT_SIZE)
    stance = AxleStance(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for i in range(loads.shape[0]):
        warm[:] = 0.0
        motion = WheelMotion(motions[i, 0], motions[i, 1], motions[i, 2])
        support = Support(loads[i], 0.0, plant.vehicle.wheels_per_axle)
        worst = max(worst, axle_contact(plant, motion, stance, support, warm, readings[i]).status)
    return worst


@dataclass(frozen=True, kw_only=True)
class Trials:
    """Steady trials for which the model has a prediction, in one table; arrays of shape (M,)."""

    slip: np.ndarray
    slip_angle: np.ndarray  #: [rad]
    load: np.ndarray  #: [N]
    condition: np.ndarray  #: 0 ... C - 1 in the order of slip angle, slip and load
    channels: dict[str, np.ndarray]  #: measured, NaN = no sample
    left_out: int  #: trials without a slip along the wheel, or without load

    def __len__(self) -> int:
        return len(self.slip)

    def only(self, rows: np.ndarray) -> Trials:
        """Some of the trials; conditions keep their numbers."""
        return Trials(
            slip=self.slip[rows],
            slip_angle=self.slip_angle[rows],
            load=self.load[rows],
            condition=self.condition[rows],
            channels={name: values[rows] for name, values in self.channels.items()},
            left_out=self.left_out,
        )

    @classmethod
    def of(cls, logs: Sequence[Log]) -> Trials:
        """The trials of all logs together.

        Raises
        ------
        DataError
            If the logs are not of one wheel on one soil, or no trial can be used.
        """
        for log in logs[1:]:
            if (log.config.wheel, log.config.soil) != (logs[0].config.wheel, logs[0].config.soil):
                raise DataError(f"{log.name}: has another wheel or soil than {logs[0].name}")
        count = sum(len(log) for log in logs)
        table = {
            name: np.concatenate([log.channels.get(name, np.full(len(log), np.nan)) for log in logs])
            for name in ("slip", "slip_angle", "load", "condition", *RIG_CHANNELS)
        }
        angle = np.nan_to_num(table["slip_angle"])
        good = np.isfinite(table["slip"]) & (table["load"] > 0.0) & (np.abs(angle) < np.radians(89.9))
        if not good.any():
            raise DataError(f"{logs[0].name}: no trial has a slip along the wheel and a load")
        slip, angle, load = table["slip"][good], angle[good], table["load"][good]
        return cls(
            slip=slip,
            slip_angle=angle,
            load=load,
            condition=_conditions(angle, slip, load, table["condition"][good]),
            channels={
                name: table[name][good] for name in RIG_CHANNELS if np.isfinite(table[name][good]).any()
            },
            left_out=count - int(good.sum()),
        )

    def levels(self) -> np.ndarray:
        """(M,) number of the slip angle's level, by its size."""
        return _clusters(np.abs(self.slip_angle), _SAME_ANGLE)

    def uses(self, held: int | None = None) -> np.ndarray:
        """What every trial is for: FIT, SELECT or REPORT, all repeats of a condition the same.

        Where there are three slip angles or more, a whole one is kept for the report: number ``held``,
        by default the middle one. Else every fifth condition is. A fifth of all is for the hold-out test.
        """
        count = int(self.condition.max()) + 1
        if count < _FEWEST:
            return np.full(len(self), FIT)
        levels = self.levels()
        use = np.full(count, FIT)
        if levels.max() < 2:
            use[3::5], use[1::5] = REPORT, SELECT
            return np.asarray(use[self.condition])
        held = (int(levels.max()) + 1) // 2 if held is None else held
        level_of = np.zeros(count, int)
        level_of[self.condition] = levels
        use[level_of == held] = REPORT
        others = np.flatnonzero(level_of != held)
        use[others[1::4]] = SELECT
        return np.asarray(use[self.condition])


def _clusters(values: np.ndarray, gap: float) -> np.ndarray:
    """Number of the group of every value, by size; groups lie further apart than ``gap``."""
    order = np.argsort(values, kind="stable")
    number = np.concatenate([[0], np.cumsum(np.diff(values[order]) > gap)])
    found = np.empty(len(values), int)
    found[order] = number
    return found


def _conditions(angle: np.ndarray, slip: np.ndarray, load: np.ndarray, label: np.ndarray) -> np.ndarray:
    """Number of the condition of every trial: by label where all have one, else by nearness."""
    if np.isfinite(label).all():
        groups = np.unique(label, return_inverse=True)[1]
    else:
        groups = _clusters(angle, _SAME_ANGLE)
        for values, gap in ((slip, _SAME_SLIP), (np.log(load), _SAME_LOAD)):
            parts = np.empty(len(groups), int)
            for group in np.unique(groups):
                rows = groups == group
                parts[rows] = _clusters(values[rows], gap)
            groups = groups * (parts.max() + 1) + parts
        groups = np.unique(groups, return_inverse=True)[1]
    count = np.bincount(groups)
    means = [np.bincount(groups, values) / count for values in (load, slip, angle)]
    rank = np.empty(len(count), int)
    rank[np.lexsort(means)] = np.arange(len(count))
    return rank[groups]


def trials_of(runs: Sequence[ForwardModel]) -> RigModel:
    """The trials of a fit, which has one `RigModel`.

    Raises
    ------
    TypeError
        For drives of a vehicle.
    """
    run = runs[0]
    if not isinstance(run, RigModel):
        raise TypeError("needs trials of a wheel rig; got drives of a vehicle")
    return run


class RigModel:
    """Trials with what a prediction of them needs; a `ForwardModel` with one window and no states.

    Parameters
    ----------
    log
        One log of the rig: its wheel and prior soil.
    trials
        What is predicted.
    """

    #: Nuisances of trials.
    nuisances: tuple[Nuisance, ...] = _NUISANCES
    #: Effects of a rig are far from linear, and a trial takes microseconds.
    renews_derivatives = True
    #: The rig sets the slip; no torque is an input.
    driven = True

    def __init__(self, log: Log, trials: Trials) -> None:
        self.log, self.trials = log, trials
        wheel = log.wheel
        # The mean wheel load, as of a vehicle with four wheels, sets the scale of plausible sizes.
        vehicle = VEHICLES["mrzr"]._replace(
            r=wheel.r, b=wheel.b, wheels_per_axle=1.0, m=4.0 * float(np.mean(trials.load)) / GRAVITY
        )
        config = log.config
        structure = None if config.model == "paper" else config.structure
        plant = make_plant(vehicle, config.soil, flat(), model=config.model, structure=structure)
        # Trials are steady and have no speed of their own: nothing to regularise.
        self.setup = RigSetup(plant=plant._replace(v_eps=0.0), mount=ImuConfig().mount())
        self.motions = _motions(trials.slip, trials.slip_angle)
        self.step, self.period, self.fine = 0.0, 0.0, False
        self.free: tuple[int, ...] = ()
        self.spread = np.empty(0)
        self.windows = Windows(first=np.zeros(1, int), count=np.zeros(1, int), use=np.zeros(1, int))
        channels, data, start = [], [], 0
        for name in RIG_CHANNELS:
            if name not in trials.channels:
                continue
            rows = np.flatnonzero(np.isfinite(trials.channels[name]))
            channels.append(_channel(name, start, rows))
            data.append(trials.channels[name][rows])
            start += len(rows)
        self.channels = tuple(channels)
        self.y = np.concatenate(data) if data else np.empty(0)

    def refined(self) -> RigModel:
        """The same with the reference quadrature."""
        other = copy.copy(self)
        other.fine = True
        return other

    def coarse(self) -> RigModel:
        """The same: a trial takes microseconds."""
        return self

    def first_starts(self, setup: Setup) -> tuple[np.ndarray, np.ndarray]:
        """Trials have no start."""
        return np.zeros((1, at.STATE_SIZE)), np.zeros((1, 2, 3))

    def moved_by(self, setup: Setup, other: Setup) -> bool:
        """No sensor sets the wheel of a rig in motion."""
        return False

    def simulate(
        self,
        setup: Setup,
        starts: np.ndarray | None = None,
        warm: np.ndarray | None = None,
        windows: Windows | None = None,
    ) -> Records:
        """Contact of all trials; a wheel that the soil cannot support is at the deepest sinkage.

        Trials have neither starts nor windows.

        Raises
        ------
        SolverFailure
            When a contact has no solution.
        """
        readings = np.zeros((len(self.trials), at.READINGS_SIZE))
        loads = _rig(setup).rig.load_scale * self.trials.load
        plant = setup.plant._replace(fine=True) if self.fine else setup.plant
        if _balance(plant, self.motions, loads, readings) >= NO_ROOT or not np.isfinite(readings).all():
            raise SolverFailure(f"{self.log.name}: the contact of a trial has no solution")
        return Records(states=np.empty((0, at.STATE_SIZE)), readings=readings)

    def predict(self, setup: Setup, records: Records) -> np.ndarray:
        """Samples (M,) that the rig should read, like ``y``."""
        errors = _rig(setup).rig
        offsets = {"sinkage": errors.sinkage, "drawbar": errors.drawbar, "side_force": errors.side_force}
        out = np.empty(len(self.y))
        for channel in self.channels:
            values = records.readings[channel.record, RIG_CHANNELS[channel.name]]
            out[channel.rows] = values + offsets.get(channel.name, 0.0)
        return out

    def residual(self, prediction: np.ndarray) -> np.ndarray:
        """Measured less predicted."""
        return np.asarray(self.y - prediction)

    def condition_of(self, channel: Channel) -> np.ndarray:
        """Condition of every sample of a channel."""
        return np.asarray(self.trials.condition[channel.record])


def _rig(setup: Setup) -> RigSetup:
    """The setup, which must be of a rig."""
    if not isinstance(setup, RigSetup):
        raise TypeError(f"trials need the setup of a rig, got {type(setup).__name__}")
    return setup


def _motions(slip: np.ndarray, slip_angle: np.ndarray) -> np.ndarray:
    """(r omega, v_l, v_c) over the larger of rim speed and speed along the wheel, (M, 3)."""
    slip = np.minimum(slip, _SPINNING)
    rim = np.where(slip >= 0.0, 1.0, 1.0 + slip)
    along = np.where(slip >= 0.0, 1.0 - slip, 1.0)
    return np.ascontiguousarray(np.stack([rim, along, along * np.tan(slip_angle)], axis=1))


def _channel(name: str, start: int, rows: np.ndarray) -> Channel:
    nothing = np.zeros(len(rows))
    return Channel(
        name=name,
        rows=slice(start, start + len(rows)),
        t=np.arange(len(rows), dtype=float),
        window=nothing.astype(int),
        record=rows,
        weight=nothing,
    )
