"""Forward model of one drive: windows, inputs, predicted samples."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import lfilter

from estimators.discrepancy.model.displacement import displaced
from estimators.discrepancy.model.input_means import input_means
from estimators.discrepancy.model.nuisances import NUISANCES
from estimators.discrepancy.model.protocol import Channel, ForwardModel, Nuisance, Records
from estimators.discrepancy.model.starts import COURSE_SPEED, FREE, StartSensors
from estimators.discrepancy.model.window_simulation import (
    Histories,
    Timing,
    WindowStarts,
    actuator_states,
    imu_rows,
    run_full,
    run_paper,
)
from estimators.discrepancy.model.windows import Windows, cut
from estimators.discrepancy.physical_ranges import drive_range
from estimators.logs.clocks import pose_age
from estimators.logs.immobile import stuck_spans
from estimators.logs.log import Log
from estimators.logs.runs import plant_of
from estimators.logs.signals import uninterrupted
from offroad_env.effects.protocol import Inputs, SensorErrors, Setup
from offroad_env.errors import DataError, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics.contact import SUNK
from offroad_env.physics.full_vehicle import straight_track
from offroad_env.simulation.sensors import ImuConfig
from offroad_env.simulation.simulator import FULL_STEP, settled_state

__all__ = ["RunModel", "drives"]

#: Step of the paper's model [s].
PAPER_STEP = 0.01
#: Limits of the grid's step [s].
_FINEST, _COARSEST = 0.005, 0.02
#: A vehicle with this wheelbase or a longer one is driven in windows and steps of full length [m].
_FULL_SIZE = 2.0

_IMU = ("a_x", "a_y", "a_z", "pitch_rate", "yaw_rate")
_ANGLES = ("course", "yaw")
_STATES = {"x": at.X, "y": at.Y, "yaw": at.YAW, "pitch": at.PITCH, "v_x": at.V_X, "v_y": at.V_Y}
_RIMS = {"omega_f": at.R_OMEGA, "omega_r": at.AXLE + at.R_OMEGA}
_OTHER = ("speed", "course")
_POSE = ("x", "y", "yaw", *_OTHER)


def drives(runs: Sequence[ForwardModel]) -> tuple[RunModel, ...]:
    """The runs, which must be drives of a vehicle.

    Raises
    ------
    TypeError
        For trials of a wheel rig.
    """
    found = tuple(run for run in runs if isinstance(run, RunModel))
    if len(found) < len(runs):
        raise TypeError("needs drives of a vehicle; got trials of a wheel rig")
    return found


class _Driven(NamedTuple):
    """Inputs of a run."""

    commands: np.ndarray  #: (K, 3)
    actuators: np.ndarray  #: (K + 1, 3)


class RunModel:
    """What a simulation needs of one log, made once; a `ForwardModel`.

    Parameters
    ----------
    log
        The run.
    use
        FIT, SELECT or REPORT: only those windows; None takes all.
    whole
        See `cut`.

    Raises
    ------
    DataError
        If the log is too short, or has no input of the drive.
    """

    #: Effects are nearly linear about a fit, and derivatives are most of its work.
    renews_derivatives = False

    def __init__(
        self,
        log: Log,
        *,
        use: int | None = None,
        whole: int | None = None,
        nuisances: tuple[Nuisance, ...] = NUISANCES,
    ) -> None:
        self.log, self.nuisances = log, nuisances
        self._held: Mapping[str, float] = {}
        #: Of the last simulation: derivatives by starts and most parameters leave the inputs as they are.
        self._last: tuple[Any, _Driven] | None = None
        self._stride = 1  #: see `Timing`
        plant = plant_of(log)
        full = log.config.model == "full"
        imu = ImuConfig(
            lever_arm=log.imu.position,
            kind="kinematic" if log.imu.kinematic else "specific_force",
            body_axes=full,
        )
        times = log.imu_times
        self.t_0 = float(times[0])
        sample = float(np.median(np.diff(times)))
        self.step = round(float(np.clip(sample, _FINEST, _COARSEST)), 6)
        #: Of the samples [s]: the log resolves the instant of an input no better.
        self.period = max(round(sample, 6), self.step)
        # Frequencies of similar vehicles scale with the root of one over their size (Froude).
        vehicle = plant.vehicle
        pace = min(math.sqrt((vehicle.l_f + vehicle.l_r) / _FULL_SIZE), 1.0)
        self._longest = pace * _COARSEST
        self.steps = max(math.ceil(self.step / (pace * (FULL_STEP if full else PAPER_STEP)) - 1e-6), 1)
        self.dt = self.step / self.steps
        count = math.floor((times[-1] - self.t_0) / self.step + 1e-6)
        if count * self.step < 3.0:
            raise DataError(f"{log.name}: lasts {count * self.step:.1f} s; a diagnosis needs 3 s at least")
        self.count = count
        self.driven = "drive_force" in log.channels if not full else self._has_torque()
        if not full and not self.driven:
            raise DataError(f"{log.name}: the paper's model needs drive_force")
        if not self.driven:
            # The wheels turn as measured: a spin inertia that nothing moves.
            plant = plant._replace(vehicle=plant.vehicle._replace(I_w=1e9))
        # The age of the pose is known from the sensors alone: it is no error of the model.
        self.setup = Setup(plant=plant, mount=imu.mount(), errors=SensorErrors(pose_delay=pose_age(log)))
        windows = cut(count, self.step, whole, self._usable(), pace)
        self._take(windows if use is None else windows.only(use))
        self.free = tuple(FREE) if full and self.driven else tuple(i for i in FREE if i < at.OMEGA_F)
        self._sensors = StartSensors(log, radius=plant.vehicle.r, driven=self.driven)

    @property
    def spread(self) -> np.ndarray:
        """(W, S) standard deviations of the priors of the free states."""
        return self._sensors.spread(self.free, self.t_0 + self.step * self.windows.first)

    def size_limits(self, effect: str) -> tuple[float, float]:
        """Physical range of an effect's size, within which the model can be computed."""
        if effect in self._held:
            return self._held[effect], self._held[effect]
        return drive_range(effect, self.setup)

    def with_sizes(self, sizes: Mapping[str, float]) -> RunModel:
        """The same with the sizes of these effects held where they are."""
        other = copy.copy(self)
        other._held = dict(sizes)
        return other

    def refined(self) -> RunModel:
        """The same with half the step of the solver."""
        return self._with_steps(2 * self.steps)

    def coarse(self) -> RunModel:
        """The same with twice the step of the solver, where the grid allows it: enough for derivatives."""
        return self._with_steps(max(self.steps // 2, 1))

    def rough(self) -> RunModel:
        """The same by steps over two of the grid, where they are not too long."""
        other, plant = self.coarse(), self.setup.plant
        simple = plant.structure is None and plant.soil.rigid < 0.5 and self.setup.model == "full"
        other._stride = 2 if simple and self.driven and 2.0 * self.step <= self._longest else 1
        return other

    def _with_steps(self, steps: int) -> RunModel:
        other = copy.copy(self)
        other.steps, other.dt = steps, self.step / steps
        return other

    def with_windows(self, windows: Windows) -> RunModel:
        """The same run in other windows, in the order of time and apart."""
        other = copy.copy(self)
        other._take(windows)
        return other

    def _has_torque(self) -> bool:
        return any(name in self.log.channels for name in ("torque_f", "torque_r"))

    def _usable(self) -> np.ndarray | None:
        """(K,) steps of the grid that can be simulated; None where all can.

        In a gap of the log the inputs are unknown; no start fits on both sides of a position that jumps; a
        vehicle that stands though its wheels are driven shows no more than that. Near standstill on hard
        ground the slip of a tyre is undefined, and the model is regularised.
        """
        middle = self.t_0 + self.step * (np.arange(self.count) + 0.5)
        usable = uninterrupted(self.log, middle)
        for begin, end in stuck_spans(self.log):
            usable &= (middle < begin) | (middle > end)
        plant = self.setup.plant
        if plant.soil.rigid > 0.5:
            name = next((name for name in ("v_x", "speed", *_RIMS) if self._has(name)), None)
            if name is not None:
                scale = plant.vehicle.r if name in _RIMS else 1.0
                usable &= scale * np.abs(self._over(name, middle)) > plant.v_eps
        return None if usable.all() else usable

    def _over(self, name: str, t: np.ndarray) -> np.ndarray:
        """A channel at the times ``t`` [s], straight between its samples."""
        times, values = self.log.samples(name)
        return np.asarray(np.interp(t, times, values))

    def _rim_speeds(self, setup: Setup) -> np.ndarray:
        """Wheel speeds that hold instead of a balance of torques, (K + 1, 2) [rad/s], or (0, 2).

        From the sensors: as late as the inputs are, and wrong by as much as the sensors are.
        """
        if self.driven:
            return np.empty((0, 2))
        errors = setup.errors
        late = setup.inputs.delay - errors.wheel_delay
        grid = self.t_0 - late + self.step * np.arange(self.count + 1)
        columns = []
        for name, split in zip(_RIMS, (errors.wheel_split, -errors.wheel_split), strict=True):
            if self._has(name):
                columns.append(self._over(name, grid) / (errors.wheel_scale + split))
        return np.ascontiguousarray(np.stack(columns * (3 - len(columns)), axis=1)[:, :2])

    # ------------------------------------------------------------------ data

    def _take(self, windows: Windows) -> None:
        """Set the windows, and find the data in them."""
        self.windows = windows
        found, data, start = [], [], 0
        known = [*_IMU, *(_RIMS if self.driven else ()), *_STATES, *_OTHER] if len(windows) else []
        for name in known:
            if name not in self.log.channels:
                continue
            inside = self._inside_windows(name)
            if not inside.any():
                continue
            channel = self._channel(name, start, inside)
            found.append(channel)
            data.append(self.log.samples(name)[1][inside])
            start = channel.rows.stop
        self.channels = tuple(found)
        self.y = np.concatenate(data) if data else np.empty(0)

    def _places(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Place on the grid and number of the window of every sample of a channel, before selection."""
        t, _ = self.log.samples(name)
        place = (t - self.t_0) / self.step
        whole = np.round(place)
        place = np.where(np.abs(place - whole) < 1e-4, whole, place)
        return place, np.searchsorted(self.windows.first, place, side="right") - 1

    def _inside_windows(self, name: str) -> np.ndarray:
        """Which samples of a channel lie in windows and mean something."""
        place, window = self._places(name)
        end = self.windows.first + self.windows.count
        inside: np.ndarray = (window >= 0) & (place < end[np.maximum(window, 0)])
        if name == "course" and self._has("speed"):
            inside &= self._over("speed", self.log.samples(name)[0]) > COURSE_SPEED
        return inside

    def _channel(self, name: str, start: int, inside: np.ndarray) -> Channel:
        """A channel with the samples ``inside`` windows, whose first row of the data is ``start``."""
        t = self.log.samples(name)[0][inside]
        place, window = (values[inside] for values in self._places(name))
        before = np.floor(place).astype(int)
        known = name == "course" and self._has("speed")
        return Channel(
            name=name,
            rows=slice(start, start + len(place)),
            t=t,
            window=window,
            record=self.windows.begin[window] + before - self.windows.first[window],
            weight=place - before,
            # The slower, the less accurate is a receiver's course; the velocity across is as accurate always.
            lever=self._over("speed", t) if known else None,
        )

    def _has(self, name: str) -> bool:
        return name in self.log.channels

    # ------------------------------------------------------------------ inputs

    def commands(self, inputs: Inputs) -> np.ndarray:
        """Inputs over each step of the grid, (K, 3) as the model's kernels take them."""
        steer = self._steering(inputs)
        if self.log.config.model == "paper":
            force = inputs.acting(self._mean("drive_force", inputs.delay))
            return np.column_stack([steer, force, np.full(self.count, math.nan)])
        if not self.driven:
            return np.column_stack([steer, np.zeros((self.count, 2))])
        names = [name for name in ("torque_f", "torque_r") if self._has(name)]
        total = inputs.acting(np.sum([self._mean(name, inputs.delay) for name in names], axis=0))
        return np.column_stack([steer, np.maximum(total, 0.0), np.maximum(-total, 0.0)])

    def _driven_by(self, setup: Setup) -> _Driven:
        """Commands and the states of the actuators that follow them."""
        vehicle = setup.plant.vehicle
        lags = (vehicle.steer_rate, vehicle.steer_lag, vehicle.torque_lag)
        key = (setup.inputs, setup.model, self.dt, self.steps, lags)
        if self._last is None or self._last[0] != key:
            commands = self.commands(setup.inputs)
            # The paper's vehicle has no actuators.
            states = np.empty((0, 3))
            if setup.model == "full":
                states = actuator_states(vehicle, commands, self.dt, self.steps)
            self._last = key, _Driven(commands, states)
        return self._last[1]

    def _steering(self, inputs: Inputs) -> np.ndarray:
        """Commanded steering after delay, gain, offset and lag, (K,) [rad]."""
        steer = self._mean("steer", inputs.delay + inputs.steer_delay)
        steer = inputs.steer_gain * steer + inputs.steer_offset
        if inputs.steer_lag <= 0.0:
            return steer
        # A first-order lag under an input that holds over each step: its mean over the step.
        share = self.step / inputs.steer_lag
        decay = math.exp(-share)
        state, _ = lfilter([1.0 - decay], [1.0, -decay], steer, zi=[steer[0] * decay])
        before = np.concatenate([[steer[0]], state[:-1]])
        return steer + (before - steer) * (1.0 - decay) / share

    def _mean(self, name: str, delay: float) -> np.ndarray:
        """Mean of an input over every step of the grid [its unit], ``delay`` [s] late."""
        edges = self.t_0 - delay + self.step * np.arange(self.count + 1)
        return input_means(*self.log.samples(name), edges, linear=self.log.config.hold == "linear")

    def moved_by(self, setup: Setup, other: Setup) -> bool:
        """Whether the vehicle moves otherwise by two setups that differ in their sensors alone."""
        pair = (setup.errors, other.errors)
        wheels = {(errors.wheel_scale, errors.wheel_split, errors.wheel_delay) for errors in pair}
        return not self.driven and len(wheels) > 1

    def displaced(self, setup: Setup, records: Records, state: int, by: float) -> Records | None:
        """The records of windows that begin elsewhere, see `ForwardModel`."""
        return displaced(setup, records, self.windows, state, by)

    # ------------------------------------------------------------------ simulation

    def simulate(self, setup: Setup, starts: np.ndarray, warm: np.ndarray, windows: Windows) -> Records:
        """All ``windows`` from their ``starts`` (W, 15) and warm starts (W, 2, 3).

        Raises
        ------
        SolverFailure
            When a contact has no solution.
        """
        records = int(windows.begin[-1])
        out = Histories(np.empty((records, at.STATE_SIZE)), np.zeros((records, at.READINGS_SIZE)))
        spans = np.stack([windows.first, windows.count], axis=1)
        (commands, actuators), timing = self._driven_by(setup), Timing(self.dt, self.steps, self._stride)
        begin = WindowStarts(starts, warm, actuators)
        if setup.model == "full":
            rims = self._rim_speeds(setup)
            worst = run_full(begin, spans, commands, rims, setup.plant, timing, out)
        else:
            worst = run_paper(begin, spans, commands, setup.plant, timing, out)
        if worst.max() >= SUNK:
            t = self.t_0 + self.step * windows.first[int(worst.argmax())]
            raise SolverFailure(f"{self.log.name}: the simulation fails in the window from {t:.1f} s")
        return Records(states=out.states, readings=out.readings)

    def predict(self, setup: Setup, records: Records) -> np.ndarray:
        """Samples (M,) that the sensors should read, like ``y``."""
        imu = imu_rows(records.states, records.readings, setup.mount)
        out = np.empty(len(self.y))
        for channel in self.channels:
            signal = self._signal(channel.name, setup, records, imu)
            record, weight = channel.record, channel.weight
            if channel.name in _POSE and setup.errors.pose_delay != 0.0:
                record, weight = self._earlier(channel, setup.errors.pose_delay)
            before = signal[record]
            out[channel.rows] = before + weight * (signal[record + 1] - before)
        return out

    def _earlier(self, channel: Channel, delay: float) -> tuple[np.ndarray, np.ndarray]:
        """(record before, weight) of samples ``delay`` [s] old; beyond its window a signal goes on."""
        begin = self.windows.begin
        place = channel.record + channel.weight - delay / self.step
        record = np.clip(np.floor(place).astype(int), begin[channel.window], begin[channel.window + 1] - 2)
        return record, place - record

    def _signal(self, name: str, setup: Setup, records: Records, imu: np.ndarray) -> np.ndarray:
        """Reading of a sensor at every record, (R,)."""
        states = records.states
        if name in _IMU:
            i = _IMU.index(name)
            scale = setup.errors.accel_scale if i < 3 else 1.0
            scale *= 1.0 + setup.errors.lean if name == "a_y" else 1.0
            return np.asarray(scale * imu[:, i] + setup.errors.offset[i])
        if name in _RIMS:
            split = setup.errors.wheel_split if name == "omega_f" else -setup.errors.wheel_split
            scale = (setup.errors.wheel_scale + split) / setup.plant.vehicle.r
            return np.asarray(scale * records.readings[:, _RIMS[name]])
        ahead = setup.errors.antenna
        if name in _OTHER:
            v_y = states[:, at.V_Y] + ahead * states[:, at.YAW_RATE]
            if name == "speed":
                return np.asarray(np.hypot(states[:, at.V_X], v_y))
            return np.unwrap(states[:, at.YAW] + np.arctan2(v_y, states[:, at.V_X]))
        if name == "x":
            return np.asarray(states[:, at.X] + ahead * np.cos(states[:, at.YAW]))
        if name == "y":
            return np.asarray(states[:, at.Y] + ahead * np.sin(states[:, at.YAW]))
        return states[:, _STATES[name]]

    def residual(self, prediction: np.ndarray) -> np.ndarray:
        """Measured less predicted, angles within half a turn; a course as the velocity across it [m/s]."""
        r: np.ndarray = self.y - prediction
        for channel in self.channels:
            if channel.name in _ANGLES:
                r[channel.rows] = np.remainder(r[channel.rows] + math.pi, 2.0 * math.pi) - math.pi
            if channel.lever is not None:
                r[channel.rows] *= channel.lever
        return r

    # ------------------------------------------------------------------ start of the windows

    def first_starts(self, setup: Setup) -> tuple[np.ndarray, np.ndarray]:
        """Where every window may begin: where the one before ended, corrected by the sensors.

        Raises
        ------
        SolverFailure
            When the soil does not carry the vehicle, or a contact has no solution.
        """
        spec, windows = self.log.config.start, self.windows
        x, warm = settled_state(setup.plant, x=spec.x, y=spec.y, yaw=spec.yaw, v_x=max(spec.v_x, 0.0))
        for name, value in spec.state:
            x[at.STATE_NAMES.index(name.upper() if name in ("x", "y") else name)] = value
        starts, warms = np.empty((len(windows), at.STATE_SIZE)), np.empty((len(windows), *warm.shape))
        instant = 0
        for w in range(len(windows)):
            first = int(windows.first[w])
            if first > instant:
                piece = Windows(
                    first=np.array([instant]), count=np.array([first - instant]), use=np.zeros(1, int)
                )
                x = self.simulate(setup, x[None], warm[None], piece).states[-1].copy()
            if w > 0 or not self.log.config.start.state:
                self._sensors.correct(x, self.t_0 + self.step * first)
            if setup.plant.structure is not None:
                straight_track(setup.plant, x, warm)
            starts[w], warms[w], instant = x, warm, first
        return starts, warms
