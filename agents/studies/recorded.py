"""A vehicle of the full model driven by a rule, its sensors, and the estimators that it carries."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from estimators.carried import OnBoard, make_estimator
from estimators.protocol import Pose
from offroad_env.errors import SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics.contact import SUNK
from offroad_env.physics.full_model import full_advance
from offroad_env.physics.ground import sinkage_exponent
from offroad_env.sensors import GnssConfig, ImuConfig, SensorSuite, WheelSpeedConfig
from offroad_env.simulator import FULL_STEP, Plant, make_plant, settled_state
from offroad_env.terrain import flat

__all__ = ["PERIOD", "BoardRun", "Driver", "Recording", "record", "run_on_board"]

PERIOD = 0.01  # of a sensor sample [s]

#: (time [s], speed [m/s]) -> steering [rad], drive torque [N m], brake torque [N m].
Driver = Callable[[float, float], tuple[float, float, float]]


@dataclass(frozen=True, kw_only=True)
class Recording:
    """A drive; row k was measured at k PERIOD, and ``commands[k]`` came before it."""

    plant: Plant  #: truth
    states: np.ndarray  #: (T, 15)
    n: np.ndarray  #: (T,) true exponent under the centre of gravity [-]
    commands: np.ndarray  #: (T, 3)
    imu: np.ndarray  #: (T, 5)
    wheel: np.ndarray  #: (T, 2)
    gnss: np.ndarray  #: (T, 4)

    @property
    def t(self) -> np.ndarray:
        """(T,) [s]"""
        return PERIOD * np.arange(len(self.imu))


@dataclass(frozen=True, kw_only=True)
class BoardRun:
    """What an estimator on board believed."""

    n: np.ndarray  #: (T,) mean of n [-]
    sd: np.ndarray  #: (T,) its standard deviation [-]
    nis: np.ndarray  #: (T,)
    valid: np.ndarray  #: (T,) bool
    repairs: int
    seconds: float  #: processor time [s]


def record(plant: Plant, driver: Driver, duration: float, *, seed: int, speed: float = 3.0) -> Recording:
    """Drive and record what inertial unit, wheels and satellite receiver say.

    Parameters
    ----------
    plant
        Truth, of the full model.
    driver
        Asked at 50 Hz, as in the environment.
    duration
        [s]
    seed
        Of the sensors.
    speed
        At the start [m/s].

    Raises
    ------
    SolverFailure
        When the vehicle leaves the range of the model.
    """
    sensors = SensorSuite(imu=ImuConfig(), wheel=WheelSpeedConfig(), gnss=GnssConfig())
    sensors.reset(np.random.default_rng(seed))
    state, warm = settled_state(plant, v_x=speed)
    readings, command, rows = np.zeros(at.READINGS_SIZE), (0.0, 0.0, 0.0), []
    for k in range(round(duration / PERIOD) + 1):
        if k % 2 == 1:
            command = driver((k - 1) * PERIOD, float(state[at.V_X]))
        steps = 0 if k == 0 else round(PERIOD / FULL_STEP)
        status = full_advance(state, warm, command, plant, FULL_STEP, steps, readings)
        if status >= SUNK or not np.isfinite(state).all():
            raise SolverFailure(f"the drive failed at t = {k * PERIOD:.2f} s")
        sample = sensors.sample(state, readings)
        n = sinkage_exponent(plant.soil_map, plant.soil.n, state[at.X], state[at.Y])
        rows.append((state.copy(), n, command, sample.imu, sample.wheel, sample.gnss))
    states, n, commands, imu, wheel, gnss = (np.array(column) for column in zip(*rows, strict=True))
    return Recording(plant=plant, states=states, n=n, commands=commands, imu=imu, wheel=wheel, gnss=gnss)


def run_on_board(
    kind: str, drive: Recording, *, n_range: tuple[float, float], n_prior: float, sd: float
) -> BoardRun:
    """Carry an estimator on a recorded drive; it believes in the nominal vehicle and in level ground.

    Parameters
    ----------
    kind
        One of `estimators.carried.KINDS`.
    drive
    n_range
        Bounds of n [-].
    n_prior, sd
        Prior of n [-].
    """
    belief = make_plant(drive.plant.vehicle, drive.plant.soil, flat())
    estimator = make_estimator(OnBoard(kind=kind), belief, n_range, ImuConfig(), GnssConfig())
    x = drive.states[0]
    pose = Pose(float(x[at.X]), float(x[at.Y]), float(x[at.YAW]), float(x[at.V_X]))
    begin = time.process_time()
    beliefs = [estimator.reset(n_prior, sd, pose)]
    for k in range(1, len(drive.imu)):
        command = tuple(float(value) for value in drive.commands[k])
        beliefs.append(estimator.update(command, drive.imu[k], drive.wheel[k], drive.gnss[k]))
    seconds = time.process_time() - begin
    return BoardRun(
        n=np.array([belief.mean for belief in beliefs]),
        sd=np.array([belief.sd for belief in beliefs]),
        nis=np.array([belief.nis for belief in beliefs]),
        valid=np.array([belief.valid for belief in beliefs]),
        repairs=beliefs[-1].repairs,
        seconds=seconds,
    )
