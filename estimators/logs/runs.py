"""Between logs and simulations: the plant, start and inputs of a log, and the log of a run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimators.logs.config import STATE_KEYS, GnssSpec, ImuSpec, LogConfig, StartSpec, TerrainSpec, Wave
from estimators.logs.log import Log
from estimators.logs.writing import content_hash
from offroad_env.errors import DataError, InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics.imu import CHANNELS, GNSS, IMU, WHEEL
from offroad_env.physics.records import Ground
from offroad_env.simulation.drive import DriveRecord
from offroad_env.simulation.sensors import SensorSuite
from offroad_env.simulation.simulator import Plant, Trajectory, make_plant, plant_model, settled_state
from offroad_env.world.structures import read_structure, structure_text
from offroad_env.world.terrain import paper_terrain

__all__ = [
    "Recorder",
    "commands_at",
    "config_of",
    "held",
    "log_from_run",
    "log_of_drive",
    "plant_of",
    "start_of",
    "truth_of",
    "wave_rows",
    "with_structure",
]


# ------------------------------------------------------------------ from a log


def with_structure(logs: Sequence[Log], structure: str | None) -> list[Log]:
    """The same logs with wheels that follow other laws than the logs state; None leaves them.

    Raises
    ------
    InvalidParameter
        For a structure that there is not, or a log of the paper's model, whose wheels are its own.
    """
    if structure is None:
        return list(logs)
    if structure != "full":
        read_structure(structure)
    if structure != "full" and any(log.config.model == "paper" for log in logs):
        raise InvalidParameter(
            f"structure={structure!r} needs logs with model: full; the paper's has its own"
        )
    return [replace(log, config=replace(log.config, structure=structure)) for log in logs]


def plant_of(log: Log, *, vehicle_model: str = "half_car") -> Plant:
    """The plant that a log's YAML describes, with its prior soil; an unknown ground is level.

    Raises
    ------
    DataError
        For a wheel-rig log.
    """
    config = log.config
    return make_plant(
        log.vehicle,
        config.soil,
        config.terrain.ground(),
        model=config.model,
        vehicle_model=vehicle_model,
        slip=config.slip,
        structure=None if config.model == "paper" else config.structure,
    )


def start_of(log: Log, plant: Plant | None = None) -> tuple[np.ndarray, np.ndarray]:
    """State (15,) and warm start (2, 3) at the first row.

    Parameters
    ----------
    plant
        What settles; default `plant_of` the log. Another soil needs its own.

    Raises
    ------
    DataError
        For a wheel-rig log.
    SolverFailure
        If the soil does not carry the vehicle.
    """
    start = log.config.start
    plant = plant_of(log) if plant is None else plant
    state, warm = settled_state(plant, x=start.x, y=start.y, yaw=start.yaw, v_x=start.v_x)
    for name, value in start.state:
        state[STATE_KEYS.index(name)] = value
    return state, warm


def held(log: Log, name: str, times: np.ndarray) -> np.ndarray:
    """Input ``name`` at ``times`` [s], by ``inputs.hold``: held from its stamp, or linear between stamps.

    Before its first sample an input has the value of that sample.

    Raises
    ------
    DataError
        If the log has no such channel.
    """
    t, values = log.samples(name)
    times = np.asarray(times, dtype=np.float64)
    if log.config.hold == "linear":
        between: np.ndarray = np.interp(times, t, values)
        return between
    return values[np.maximum(np.searchsorted(t, times, side="right") - 1, 0)]


def commands_at(log: Log, times: np.ndarray) -> np.ndarray:
    """Commands (K, 3) for the kernels at ``times`` (K,) [s].

    Columns: steering [rad]; then drive and brake torque of all wheels [N m], or with
    ``drivetrain: force`` the body force [N] and NaN (see `paper_derivative`).

    Raises
    ------
    DataError
        If the log holds neither torque nor force (only wheel speeds, say).
    """
    steer = held(log, "steer", times)
    if log.config.drivetrain == "force":
        return np.column_stack([steer, held(log, "drive_force", times), np.full(len(steer), math.nan)])
    axles = [name for name in ("torque_f", "torque_r") if name in log.channels]
    if not axles:
        raise DataError(f"{log.name}: has no torque_f or torque_r, so the drive is not known")
    total = np.sum([held(log, name, times) for name in axles], axis=0)
    return np.column_stack([steer, np.maximum(total, 0.0), np.maximum(-total, 0.0)])


# ------------------------------------------------------------------ to a log


def config_of(plant: Plant, sensors: SensorSuite, start: StartSpec, *, hold: str = "zoh") -> LogConfig:
    """The YAML of a run of ``plant`` (what may be known of it: pass the believed soil, not the true one).

    It states what a log can: whether the accelerometers measure gravity, where the IMU sits, white noise, and
    the whole standard deviation of a fix. Bias, drift, scale, misalignment, latency and losses stay unstated,
    as in a real log.

    Raises
    ------
    InvalidParameter
        If the sensors do not fit a log (no noise, or an IMU that does not pitch as the model's does).
    """
    model, imu, gnss = plant_model(plant), sensors.imu, sensors.gnss
    for name, value in (("accel_noise", imu.accel_noise), ("gyro_noise", imu.gyro_noise)):
        if not value > 0.0:
            raise InvalidParameter(f"a log states its noise: imu.{name} must be > 0, got {value:g}")
    if imu.body_axes != (model == "full"):
        raise InvalidParameter(
            f"imu.body_axes must be {model == 'full'} for model={model!r}: the IMU of the paper is held level"
        )
    return LogConfig(
        model=model,
        drivetrain="torque" if model == "full" else "force",
        slip=plant.slip,
        structure="full" if plant.structure is None else structure_text(plant.structure),
        vehicle=plant.vehicle,
        four_wheel=plant.four_wheel,
        soil=plant.soil,
        terrain=_terrain_of(plant.ground),
        imu=ImuSpec(
            kinematic=imu.kind == "kinematic",
            position=imu.lever_arm,
            sd_a=imu.accel_noise,
            sd_rate=imu.gyro_noise,
        ),
        gnss=None
        if gnss is None
        else GnssSpec(sd_position=gnss.total_position_sd, sd_speed=gnss.velocity_sd),
        hold=hold,
        start=start,
    )


def _terrain_of(ground: Ground) -> TerrainSpec:
    """The shortest exact description of a ground."""
    plane = (float(ground.H_0), float(ground.S_x), float(ground.S_y))
    if len(ground.waves) == 0 and plane == (0.0, 0.0, 0.0):
        return TerrainSpec(kind="flat")
    if len(ground.waves) == 3 and plane == (0.0, 0.0, 0.0):
        height = 2.0 * float(np.max(np.abs(ground.waves[:, 0])))
        for H_0 in (height, -height):
            if abs(H_0) <= 2.0 and np.array_equal(paper_terrain(H_0).waves, ground.waves):
                return TerrainSpec(kind="paper", H_0=H_0)
    return TerrainSpec(kind="waves", plane=plane, waves=wave_rows(ground))


def wave_rows(ground: Ground) -> tuple[Wave, ...]:
    """The waves of a ground as rows of plain numbers, for `TerrainSpec`."""
    return tuple((float(a), float(p), float(q), float(phase)) for a, p, q, phase in ground.waves)


def truth_of(state: np.ndarray, readings: np.ndarray) -> dict[str, float]:
    """True quantities of a simulated run, for the ``ref_*`` columns."""
    front, rear = readings[: at.AXLE], readings[at.AXLE : at.MOTION]
    truth = {
        "ref_x": state[at.X],
        "ref_y": state[at.Y],
        "ref_yaw": state[at.YAW],
        "ref_z": state[at.Z],
        "ref_pitch": state[at.PITCH],
        "ref_v_x": state[at.V_X],
        "ref_v_y": state[at.V_Y],
        "ref_steer": state[at.STEER],
    }
    for axle, values in (("f", front), ("r", rear)):
        truth[f"ref_n_{axle}"] = values[at.EXPONENT]
        truth[f"ref_sinkage_{axle}"] = values[at.SINKAGE]
        truth[f"ref_slip_{axle}"] = values[at.SLIP]
        truth[f"ref_F_z_{axle}"] = values[at.N]
    return {name: float(value) for name, value in truth.items()}


class Recorder:
    """Collects a run sample by sample and makes its log.

    A command stands in the row of the stamp from which it holds; the samples that the sensors take
    while it holds are the rows after. So ``start(sample)``, then for every control period
    ``hold(command, samples)``, then ``log(name)``.

    Parameters
    ----------
    config
        What may be known of the run, from `config_of`.
    period
        Time between samples [s].

    Raises
    ------
    InvalidParameter
        For a period that is not positive, a description without a vehicle, or calls in another order.
    """

    def __init__(self, config: LogConfig, *, period: float) -> None:
        if config.vehicle is None:
            raise InvalidParameter("config must describe a vehicle, got a wheel rig: see config_of")
        if not period > 0.0:
            raise InvalidParameter(f"period must be > 0 s, got {period}")
        self._config, self._vehicle, self._period = config, config.vehicle, float(period)
        self._samples: list[np.ndarray] = []
        self._commands: dict[int, tuple[float, ...]] = {}
        self._truth: dict[int, Mapping[str, float]] = {}

    def start(self, sample: np.ndarray, truth: Mapping[str, float] | None = None) -> None:
        """The sample (CHANNELS,) at t = 0, and the `truth_of` that moment."""
        if self._samples:
            raise InvalidParameter("the recording has started: use a new Recorder for every run")
        self._append(sample, truth)

    def hold(
        self, command: tuple[float, ...], samples: np.ndarray, truth: Mapping[str, float] | None = None
    ) -> None:
        """A command as the kernels take it, held while ``samples`` (S, CHANNELS) are taken.

        ``truth`` belongs to the last of them.
        """
        if not self._samples:
            raise InvalidParameter("call start(sample) before hold(command, samples)")
        self._commands[len(self._samples) - 1] = tuple(float(value) for value in command)
        for i, sample in enumerate(np.atleast_2d(samples)):
            self._append(sample, truth if i == len(samples) - 1 else None)

    def _append(self, sample: np.ndarray, truth: Mapping[str, float] | None) -> None:
        row = np.array(sample, dtype=np.float64)
        if row.shape != (CHANNELS,):
            raise InvalidParameter(f"a sample has {CHANNELS} channels, got shape {row.shape}")
        if truth is not None:
            self._truth[len(self._samples)] = truth
        self._samples.append(row)

    def log(self, name: str) -> Log:
        """The log so far; channels without a single sample (a sensor left out) are left out.

        Raises
        ------
        InvalidParameter
            Before two samples and one command are there.
        """
        if len(self._samples) < 2:
            raise InvalidParameter("a log needs at least one command with its samples")
        count = len(self._samples)
        channels = {**self._inputs(count), **self._sensed(np.array(self._samples))}
        channels = {key: values for key, values in channels.items() if not np.isnan(values).all()}
        names = next(iter(self._truth.values()), {})
        references = {
            key: self._column(count, {row: truth[key] for row, truth in self._truth.items()}) for key in names
        }
        arrays = (t := self._period * np.arange(count), *channels.values(), *references.values())
        for array in arrays:
            array.flags.writeable = False
        log = Log(name=name, t=t, channels=channels, references=references, config=self._config, hash="")
        return replace(log, hash=content_hash(log))

    @staticmethod
    def _column(count: int, values: Mapping[int, float]) -> np.ndarray:
        """A column (count,) from its values by row; NaN elsewhere."""
        column = np.full(count, math.nan)
        column[list(values)] = list(values.values())
        return column

    def _commanded(self, count: int, i: int) -> np.ndarray:
        return self._column(count, {row: command[i] for row, command in self._commands.items()})

    def _inputs(self, count: int) -> dict[str, np.ndarray]:
        steer, first = (self._commanded(count, i) for i in range(2))
        if self._config.drivetrain == "force":
            return {"steer": steer, "drive_force": first}
        brake, vehicle = self._commanded(count, 2), self._vehicle
        return {
            "steer": steer,
            "torque_f": vehicle.drive_front * first - vehicle.brake_front * brake,
            "torque_r": (1.0 - vehicle.drive_front) * first - (1.0 - vehicle.brake_front) * brake,
        }

    def _sensed(self, samples: np.ndarray) -> dict[str, np.ndarray]:
        imu, wheel, gnss = samples[:, IMU].T, samples[:, WHEEL].T, samples[:, GNSS].T
        sensed = {"omega_f": wheel[0] / self._vehicle.r, "omega_r": wheel[1] / self._vehicle.r}
        sensed |= dict(zip(("a_x", "a_y", "a_z", "pitch_rate", "yaw_rate"), imu, strict=True))
        sensed |= dict(zip(("x", "y", "speed", "course"), gnss, strict=True))
        return {key: np.ascontiguousarray(values) for key, values in sensed.items()}


def log_of_drive(drive: DriveRecord, config: LogConfig, name: str, *, references: bool = False) -> Log:
    """The log of a simulated drive.

    Parameters
    ----------
    drive
        From `simulate_drive`.
    config
        What may be known of it, from `config_of`.
    references
        Whether the truth goes into the ``ref_*`` columns.

    Raises
    ------
    InvalidParameter
        For a drive of a single sample.
    """
    timing, count = drive.timing, len(drive.samples)
    truth = (
        [truth_of(state, readings) for state, readings in zip(drive.states, drive.readings, strict=True)]
        if references
        else [None] * count
    )
    recorder = Recorder(config, period=timing.period)
    recorder.start(drive.samples[0], truth[0])
    held_for = max(timing.command_ticks // timing.sample_ticks, 1)
    for first in range(1, count, held_for):
        last = min(first + held_for, count)
        recorder.hold(drive.commands[first].tolist(), drive.samples[first:last], truth[last - 1])
    return recorder.log(name)


def log_from_run(
    trajectory: Trajectory,
    plant: Plant,
    commands: np.ndarray,
    sensors: SensorSuite,
    rng: np.random.Generator,
    *,
    belief: Plant | None = None,
    hold: str = "zoh",
    name: str = "run",
) -> Log:
    """Measure a simulated run with sensors and make its log.

    Parameters
    ----------
    trajectory
        From `simulate` or `simulate_commands`; its step must be the sensors' period.
    plant
        What ran.
    commands : array (T - 1, 3) or (T - 1, 2)
        Row i holds from ``trajectory.t[i]``: steering [rad], drive and brake torque [N m]; for the
        paper's model steering and body force [N]. One more row (at the last instant) is left out.
    sensors, rng
        The sensors, and where their errors are drawn from.
    belief
        The plant that the YAML describes, where it is not the true one: another n, say. Default: ``plant``.
    hold
        "zoh", or "linear" for inputs that were functions of time.

    Raises
    ------
    InvalidParameter
        If the steps, the counts or the sensors do not fit.
    """
    steps = len(trajectory.t) - 1
    commands = np.asarray(commands, dtype=np.float64)
    if commands.ndim != 2 or commands.shape[1] not in (2, 3) or commands.shape[0] not in (steps, steps + 1):
        raise InvalidParameter(f"commands must have {steps} rows of 2 or 3, got shape {commands.shape}")
    period = float(trajectory.t[1] - trajectory.t[0]) if steps else 0.0
    if not math.isclose(period, sensors.period, rel_tol=1e-9):
        raise InvalidParameter(
            f"the step of the run must be the sensors' period, {sensors.period:g} s, got {period:g} s"
        )
    # Settled, not the state: how deep the vehicle stands would give the true soil away.
    first = trajectory.states[0]
    x, y, yaw, v_x = (float(first[i]) for i in (at.X, at.Y, at.YAW, at.V_X))
    start = StartSpec(x=x, y=y, yaw=yaw, v_x=v_x)
    recorder = Recorder(
        config_of(plant if belief is None else belief, sensors, start, hold=hold), period=period
    )
    sensors.reset(rng, radius=plant.vehicle.r)
    for i, (state, readings) in enumerate(zip(trajectory.states, trajectory.readings, strict=True)):
        sample = sensors.sample(state, readings).channels
        if i == 0:
            recorder.start(sample, truth_of(state, readings))
        else:
            recorder.hold(tuple(commands[i - 1]), sample[None, :], truth_of(state, readings))
    return recorder.log(name)
