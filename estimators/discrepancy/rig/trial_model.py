"""Forward model of steady trials on a wheel rig: predicted samples at settings that are measured, too.

The counterpart of `run_model` for logs without time: a trial is one balance of the wheel's contact, through
the same kernel and the same hooks of effects as an axle of the vehicle. In place of windows with unknown
starts there are conditions with unknown errors of their load and slip, which all repeats share.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.discrepancy.model.nuisances import NUISANCES
from estimators.discrepancy.model.protocol import Channel, ForwardModel, Nuisance, Records
from estimators.discrepancy.model.windows import FIT, Windows
from estimators.discrepancy.rig.physical_ranges import physical_range
from estimators.discrepancy.rig.trial_table import RIG_CHANNELS, Trials
from estimators.logs.log import Log
from offroad_env.effects import RigSetup, Setup
from offroad_env.errors import SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.axle import AxleStance, Plant, axle_contact
from offroad_env.physics.contact import NO_ROOT, Support
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.records import FloatArray, Structure, WheelMotion
from offroad_env.simulation.sensors import ImuConfig
from offroad_env.simulation.simulator import make_plant
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import VEHICLES

__all__ = ["RigModel", "trials_of"]

#: A wheel that spins on the spot, short of 0 / 0.
_SPINNING = 1.0 - 1e-9
#: Least load, as a share of the measured one, that an error of the load may leave.
_LIGHTEST = 0.05
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
    """Trials with what a prediction of them needs; a `ForwardModel` whose windows are conditions.

    The states of a window are the errors of its load and of its slip, in standard deviations: latent
    settings, with what repeats tell of them as the prior (total least squares).

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
        self.step, self.period, self.fine = 0.0, 0.0, False
        errors = (trials.load_error, trials.slip_error)
        self.free: tuple[int, ...] = tuple(i for i, error in enumerate(errors) if (error > 0.0).any())
        self.window = np.unique(trials.condition, return_inverse=True)[1]  #: (M,) condition of every trial
        nothing = np.zeros(int(self.window.max()) + 1, int)
        self.windows = Windows(first=nothing, count=nothing, use=np.full(len(nothing), FIT))
        self.spread = np.ones((len(nothing), len(self.free)))
        settings = np.stack([self.window, trials.slip, trials.load, trials.slip_angle], axis=1)
        #: A trial of each setting, and the setting of each trial: repeats often share theirs.
        self._one_of, self._setting = np.unique(settings, axis=0, return_index=True, return_inverse=True)[1:]
        channels, data, start = [], [], 0
        for name in RIG_CHANNELS:
            if name not in trials.channels:
                continue
            rows = np.flatnonzero(np.isfinite(trials.channels[name]))
            channels.append(_channel(name, start, rows, self.window))
            data.append(trials.channels[name][rows])
            start += len(rows)
        self.channels = tuple(channels)
        self.y = np.concatenate(data) if data else np.empty(0)

    @property
    def structure(self) -> Structure | None:
        """Laws of the wheel; None for those of the log's model."""
        return self.setup.plant.structure

    def with_structure(self, structure: Structure | None) -> RigModel:
        """The same trials of a wheel that follows other laws."""
        other = copy.copy(self)
        other.setup = replace(self.setup, plant=self.setup.plant._replace(structure=structure))
        return other

    def size_limits(self, effect: str) -> tuple[float, float]:
        """Physical range of an effect's size on this rig."""
        return physical_range(effect, self.setup, self.trials)

    def refined(self) -> RigModel:
        """The same with the reference quadrature."""
        other = copy.copy(self)
        other.fine = True
        return other

    def coarse(self) -> RigModel:
        """The same: a trial takes microseconds."""
        return self

    def rough(self) -> RigModel:
        """The same."""
        return self

    def displaced(self, _setup: Setup, _records: Records, _state: int, _by: float) -> None:
        """Errors of load and slip change the contact: always to be simulated."""
        return None

    def first_starts(self, setup: Setup) -> tuple[np.ndarray, np.ndarray]:
        """Settings as they were measured."""
        return np.zeros((len(self.windows), at.STATE_SIZE)), np.zeros((len(self.windows), 2, 3))

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

        ``starts``: errors of the settings of every condition; default none. Trials have no warm starts.

        Raises
        ------
        SolverFailure
            When a contact has no solution.
        """
        trials, one = self.trials, self._one_of
        load, slip = trials.load[one], trials.slip[one]
        if starts is not None and self.free:
            error = starts[self.window[one]]
            load = np.maximum(load + trials.load_error[one] * error[:, 0], _LIGHTEST * load)
            slip = np.clip(slip + trials.slip_error[one] * error[:, 1], -1.0, _SPINNING)
        motions = _motions(slip, trials.slip_angle[one])
        plant = setup.plant._replace(fine=True) if self.fine else setup.plant
        readings = np.zeros((len(one), at.READINGS_SIZE))
        status = _balance(plant, motions, _rig(setup).rig.load_scale * load, readings)
        if status >= NO_ROOT or not np.isfinite(readings).all():
            raise SolverFailure(f"{self.log.name}: the contact of a trial has no solution")
        return Records(states=np.empty((0, at.STATE_SIZE)), readings=readings[self._setting])

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


def _channel(name: str, start: int, rows: np.ndarray, window: np.ndarray) -> Channel:
    return Channel(
        name=name,
        rows=slice(start, start + len(rows)),
        t=np.arange(len(rows), dtype=float),
        window=window[rows],
        record=rows,
        weight=np.zeros(len(rows)),
    )
