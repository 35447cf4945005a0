"""What a drive can tell about the soil: Fisher information on n and a second parameter.

The vehicle's state is not known either, so what counts is the information about the soil that is
left when start, motion and noise are free. For a model that is linearised along the drive it
follows from a Kalman filter of the state alone, whose innovations e_k have covariance S_k: with

    E_k = H_k G_k + dh/dtheta,    G_{k+1} = F_k (G_k - K_k E_k) + df/dtheta

the sensitivity of a predicted reading to the parameters (through the state, too), it is

    I = sum_k E_k^T S_k^-1 E_k.

Independent drives add up. (I + P0^-1)^-1 bounds the covariance of any estimate with the prior P0
from below (Cramer-Rao); `scatter` makes estimates from simulated noise to compare.

The two soil parameters of a pair often act in the same way: more cohesion and a firmer soil both
carry the vehicle. A drive then reveals one combination and hides the other, and the eigenvectors
of the information say which. They depend on what counts as one unit of each parameter: here the
standard deviation that the prior gives it (`Parameter.sd`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from estimators.log_filters import log_samples
from estimators.logs import Log, plant_of, start_of
from estimators.models import step_full_copies, step_paper_copies
from estimators.paper import CHOICES, ROWS, row_truth
from estimators.protocol_runs import row_plant
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics.contact import SUNK
from offroad_env.physics.packing import pack
from offroad_env.sensors import ImuConfig
from offroad_env.simulator import Plant, plant_model, settled_state

__all__ = [
    "MANOEUVRES",
    "PARAMETERS",
    "Information",
    "Linearised",
    "Manoeuvre",
    "Noise",
    "Parameter",
    "linearise",
    "log_manoeuvre",
    "manoeuvre",
    "row_manoeuvre",
    "scatter",
]

#: Half the step of the differences, by state: cubic terms stay below 1e-6 of the slope.
_STEPS = np.array([1e-4, 1e-4, 1e-5, 1e-6, 1e-6, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-3, 1e-3])
_FIX_PERIOD = 0.1  # time between satellite fixes [s]
#: Gauss-Newton steps of an estimate; the last one changes it by less than a thousandth of the bound.
_ITERATIONS = 8


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A parameter of the soil that is uncertain."""

    field: str  #: in `physics.records.Soil`
    unit: str  #: as it is shown
    scale: float  #: of one shown unit in the soil's unit; 0: units are hundredths of the logarithm
    sd: float  #: standard deviation that its prior gives it, in shown units
    reason: str  #: of that number

    def changed(self, plant: Plant, shown: float) -> Plant:
        """``plant`` with the parameter changed by ``shown`` units."""
        value = float(getattr(plant.soil, self.field))
        value = value + shown * self.scale if self.scale else value * math.exp(0.01 * shown)
        return plant._replace(soil=plant.soil._replace(**{self.field: value}))


PARAMETERS: dict[str, Parameter] = {
    "n": Parameter(field="n", unit="-", scale=1.0, sd=0.2, reason="from firm to loose soil of one kind"),
    "phi": Parameter(
        field="phi", unit="deg", scale=math.radians(1.0), sd=3.0, reason="scatter of shear tests of one soil"
    ),
    "k_phi": Parameter(
        field="k_phi", unit="%", scale=0.0, sd=30.0, reason="scatter of plate tests of one soil"
    ),
    "c": Parameter(field="c", unit="kPa", scale=1e3, sd=1.0, reason="moist against dry"),
}


@dataclass(frozen=True, kw_only=True)
class Noise:
    """What is not known besides the soil, as `estimators.joint.JointSettings` and the environment have it."""

    accelerometer: float = 0.2  #: per sample [m/s^2]
    gyro: float = 0.0175  #: per sample [rad/s]
    fix: bool = False  #: whether a satellite receiver is there (10 Hz)
    fix_position: float = 0.03  #: per fix and axis [m]
    fix_speed: float = 0.05  #: per fix [m/s]
    #: Random walks of v_x, v_y, v_z [m/s/sqrt(s)], pitch rate, yaw rate, both wheels [rad/s/sqrt(s)].
    process: tuple[float, ...] = (0.01, 0.002, 0.03, 0.03, 1e-4, 0.05, 0.05)
    #: Start: X, Y [m], yaw [rad], z [m], pitch [rad], v_x, v_y, v_z [m/s], rates [rad/s], wheels [rad/s].
    start: tuple[float, ...] = (0.02, 0.02, 1e-4, 1e-3, 1e-3, 0.05, 2e-3, 0.01, 5e-3, 5e-4, 0.1, 0.1)


@dataclass(frozen=True, kw_only=True)
class Manoeuvre:
    """A drive: what is known of the vehicle, where it starts, and its commands."""

    name: str
    plant: Plant
    start: np.ndarray  #: (15,)
    warm: np.ndarray  #: (2, 3)
    commands: np.ndarray  #: (T, 3) held over a sample, as the kernels take them
    title: str  #: in words
    dt: float = 0.01  #: time between samples [s]

    @property
    def duration(self) -> float:
        """[s]"""
        return self.dt * len(self.commands)


@dataclass(frozen=True, kw_only=True)
class Information:
    """What one or more drives tell about some parameters, the state being free."""

    parameters: tuple[str, ...]
    matrix: np.ndarray  #: (q, q) Fisher information in shown units

    def __add__(self, other: Information) -> Information:
        """Of two independent drives together."""
        if self.parameters != other.parameters:
            raise InvalidParameter(
                "only information about the same parameters adds up, "
                f"got {', '.join(self.parameters)} and {', '.join(other.parameters)}"
            )
        return Information(parameters=self.parameters, matrix=self.matrix + other.matrix)

    @property
    def prior_sd(self) -> np.ndarray:
        """(q,) in shown units."""
        return np.array([PARAMETERS[name].sd for name in self.parameters])

    @property
    def bound(self) -> np.ndarray:
        """(q, q) least covariance of an estimate with the prior, in shown units."""
        prior = np.diag(1.0 / np.square(self.prior_sd))
        return np.linalg.inv(self.matrix + prior)

    @property
    def directions(self) -> tuple[np.ndarray, np.ndarray]:
        """Combinations of the parameters, best known first.

        Returns
        -------
        (shares, vectors) : what is left of the prior's standard deviation along each (q,), and the
        combinations as columns (q, q), in prior standard deviations of each parameter.
        """
        sd = self.prior_sd
        values, vectors = np.linalg.eigh(self.matrix * np.outer(sd, sd))
        order = np.argsort(values)[::-1]
        vectors = vectors[:, order] * np.where(vectors[0, order] < 0.0, -1.0, 1.0)
        return 1.0 / np.sqrt(1.0 + np.maximum(values[order], 0.0)), vectors

    @property
    def alone(self) -> np.ndarray:
        """(q,) standard deviation of each parameter if the others were known, in shown units."""
        return 1.0 / np.sqrt(np.diag(self.matrix) + 1.0 / np.square(self.prior_sd))

    def in_words(self) -> str:
        """What the drive reveals of the first parameter and what it hides, as a sentence."""
        shares, vectors = self.directions
        first, others = self.parameters[0], " and ".join(self.parameters[1:])
        sd = math.sqrt(self.bound[0, 0])
        hidden = self._change(vectors[:, -1])
        if len(self.parameters) == 1:
            return f"{first} to ±{sd:.2g}"
        known = f"{first} to ±{self.alone[0]:.2g} if {others} were known, to ±{sd:.2g} as it is"
        if shares[0] > 0.5:
            return f"{known}: this drive tells little"
        if shares[-1] < 0.25:
            return f"{known}: this drive tells both"
        return f"{known}; hidden: {hidden}, with {shares[-1]:.0%} of the prior left"

    def _change(self, vector: np.ndarray) -> str:
        parts = []
        for name, part, sd in zip(self.parameters, vector, self.prior_sd, strict=True):
            unit = "" if PARAMETERS[name].unit == "-" else f" {PARAMETERS[name].unit}"
            parts.append(f"{name} {part * sd:+.2g}{unit}")
        return " with ".join(parts)


@dataclass(frozen=True, kw_only=True)
class Linearised:
    """A drive with its slopes, and the filter of the state that belongs to it."""

    manoeuvre: Manoeuvre
    parameters: tuple[str, ...]
    noise: Noise
    states: np.ndarray  #: (T + 1, 15) the drive
    information: Information
    gains: list[np.ndarray]  #: T times (S, m): what an innovation changes of the state a sample later
    whitened: list[np.ndarray]  #: T times (q, m): E^T S^-1
    start_slope: np.ndarray  #: (S, q) of the settled start


# ------------------------------------------------------------------ drives


def _keep_speed(v: float, target: float, plant: Plant) -> float:
    """Force [N], or torque [N m], that holds a speed: feed-forward for rolling and a proportional part."""
    vehicle = plant.vehicle
    push = vehicle.m * (1.0 + 1.5 * (target - v))
    return push * vehicle.r if plant_model(plant) == "full" else push


@dataclass(frozen=True, kw_only=True)
class _Course:
    """A manoeuvre of the menu: steering and speed as functions of time."""

    title: str
    steer: Callable[[float], float]  #: [rad]
    speed: Callable[[float], float]  #: [m/s]


#: The menu: name -> steering [rad] and speed to hold [m/s] over time.
MANOEUVRES: dict[str, _Course] = {
    "straight": _Course(title="straight at 5 m/s", steer=lambda t: 0.0, speed=lambda t: 5.0),
    "pulse": _Course(
        title="straight, speed up and brake every 4 s",
        steer=lambda t: 0.0,
        speed=lambda t: 5.0 + (2.0 if t % 4.0 < 2.0 else -2.0),
    ),
    "sine": _Course(
        title="steering 0.2 sin t at 5 m/s", steer=lambda t: 0.2 * math.sin(t), speed=lambda t: 5.0
    ),
    "circle": _Course(title="steering 0.2 at 5 m/s", steer=lambda t: 0.2, speed=lambda t: 5.0),
    "slalom": _Course(
        title="steering 0.3 sin 1.5 t while the speed swings by 2 m/s",
        steer=lambda t: 0.3 * math.sin(1.5 * t),
        speed=lambda t: 5.0 + 2.0 * math.sin(0.8 * t),
    ),
}


def _stepper(plant: Plant, dt: float) -> Callable[..., np.ndarray]:
    """``step(copies, warms, plant, command)``: readings (C, 5) before the step that is then done in place."""
    full = plant_model(plant) == "full"
    kernel = step_full_copies if full else step_paper_copies
    mount = ImuConfig(body_axes=full).mount()

    def step(copies: np.ndarray, warms: np.ndarray, plant: Plant, command: np.ndarray) -> np.ndarray:
        readings, exponents = np.empty((len(copies), 5)), np.full(len(copies), plant.soil.n)
        held = (float(command[0]), float(command[1]), float(command[2]))
        status = kernel(copies, warms, pack(plant), exponents, held, dt, mount, readings)
        if status >= SUNK or not (np.isfinite(copies).all() and np.isfinite(readings).all()):
            raise SolverFailure(f"no contact solution (status {status:g})")
        return readings

    return step


def manoeuvre(name: str, plant: Plant, *, duration: float = 10.0) -> Manoeuvre:
    """A drive of the menu on some plant.

    Parameters
    ----------
    name : str
        One of `MANOEUVRES`.
    plant : Plant
        Full or paper model.
    duration : float
        [s]

    Raises
    ------
    InvalidParameter, SolverFailure
        For an unknown name, or a plant that does not get through.
    """
    if name not in MANOEUVRES:
        raise InvalidParameter(f"manoeuvre must be one of {', '.join(MANOEUVRES)}, got {name!r}")
    course, dt = MANOEUVRES[name], Manoeuvre.dt
    step = _stepper(plant, dt)
    start, warm = settled_state(plant, v_x=course.speed(0.0))
    x, own, commands = start[None].copy(), warm[None].copy(), []
    vehicle = plant.vehicle
    for k in range(round(duration / dt)):
        t = (k + 0.5) * dt
        push = _keep_speed(float(x[0, at.V_X]), course.speed(t), plant)
        if plant_model(plant) == "full":
            drive = min(max(push, 0.0), vehicle.drive_torque_max)
            command = np.array([course.steer(t), drive, min(max(-push, 0.0), vehicle.brake_torque_max)])
        else:
            command = np.array([course.steer(t), push, math.nan])
        step(x, own, plant, command)
        commands.append(command)
    return Manoeuvre(
        name=name, plant=plant, start=start, warm=warm, commands=np.array(commands), title=course.title
    )


def row_manoeuvre(number: int, *, duration: float = 20.0) -> Manoeuvre:
    """A row of the paper's table: its half-car, ground, steering and force.

    Parameters
    ----------
    number : int
        1 ... 8.
    duration : float
        [s]
    """
    if not 1 <= number <= len(ROWS):
        raise InvalidParameter(f"row must be in 1 ... {len(ROWS)}, got {number}")
    row = ROWS[number - 1]
    plant = row_plant(row)
    start, warm = settled_state(plant, v_x=CHOICES["start_speed"].value)
    commands = row_truth(row, duration=duration).inputs[1::2]  # at the middle of every sample
    title = f"row {number} of the paper: {row.soil}, H0 {row.H0:g} m, {row.steer_amplitude:g} rad"
    return Manoeuvre(name=f"row{number}", plant=plant, start=start, warm=warm, commands=commands, title=title)


def log_manoeuvre(log: Log) -> Manoeuvre:
    """The drive of a log: its vehicle, soil and ground as described, its commands, its settled start.

    Raises
    ------
    DataError
        For a log that no filter could use.
    """
    samples, plant = log_samples(log), plant_of(log)
    start, warm = start_of(log, plant)
    return Manoeuvre(
        name=log.name,
        plant=plant,
        start=start,
        warm=warm,
        commands=samples.commands[1:],
        title=f"log {log.name}",
        dt=samples.dt,
    )


# ------------------------------------------------------------------ information


def linearise(
    drive: Manoeuvre,
    parameters: Sequence[str],
    noise: Noise | None = None,
    *,
    progress: Callable[[float], None] | None = None,
) -> Linearised:
    """Slopes and information along a drive.

    Parameters
    ----------
    drive : Manoeuvre
    parameters : sequence of str
        Of `PARAMETERS`.
    noise : Noise, optional
    progress : callable, optional
        Told the share that is done, now and then.

    Raises
    ------
    SolverFailure
        Where the drive, or one beside it, has no contact solution.
    """
    noise, names = noise or Noise(), tuple(parameters)
    unknown = set(names) - set(PARAMETERS)
    if unknown or len(set(names)) < len(names) or not names:
        raise InvalidParameter(f"parameters must be some of {', '.join(PARAMETERS)}, got {', '.join(names)}")
    plant, step = drive.plant, _stepper(drive.plant, drive.dt)
    S = 12 if plant_model(plant) == "full" else 10
    beside = [_beside(plant, name) for name in names]
    slope = _start_slope(drive, beside, S)
    P, G = np.diag(np.square(noise.start[:S])), slope.copy()
    Q = np.zeros(S)
    Q[at.V_X :] = np.square(noise.process[: S - at.V_X]) * drive.dt
    states, gains, whitened = [drive.start.copy()], [], []
    matrix, warm = np.zeros((len(names), len(names))), drive.warm.copy()
    for k, command in enumerate(drive.commands):
        x, F, H, f_theta, h_theta = _slopes(step, plant, beside, (states[-1], warm, command), S)
        H, h_theta, R = _with_fix(H, h_theta, noise, _fixes(noise, drive.dt, k))
        innovation = H @ P @ H.T + np.diag(R)
        K = np.linalg.solve(innovation, H @ P).T
        E = H @ G + h_theta
        white = np.linalg.solve(innovation, E).T
        matrix += white @ E
        G = F @ (G - K @ E) + f_theta
        P = F @ (P - K @ innovation @ K.T) @ F.T + np.diag(Q)
        P = 0.5 * (P + P.T)
        states.append(x)
        gains.append(F @ K)
        whitened.append(white)
        if progress is not None and k % 100 == 0:
            progress(k / len(drive.commands))
    return Linearised(
        manoeuvre=drive,
        parameters=names,
        noise=noise,
        states=np.array(states),
        information=Information(parameters=names, matrix=0.5 * (matrix + matrix.T)),
        gains=gains,
        whitened=whitened,
        start_slope=slope,
    )


def _beside(plant: Plant, name: str) -> tuple[Plant, Plant, float]:
    """The plant with a little less and a little more of a parameter, and the distance in shown units."""
    parameter = PARAMETERS[name]
    step = 1e-3 * parameter.sd
    return parameter.changed(plant, -step), parameter.changed(plant, step), 2.0 * step


def _start_slope(drive: Manoeuvre, beside: list, S: int) -> np.ndarray:
    """How deep the vehicle stands at the start is known but for the soil: (S, q)."""
    pose = {"x": drive.start[at.X], "y": drive.start[at.Y], "yaw": drive.start[at.YAW]}
    columns = []
    for low, high, distance in beside:
        ends = [settled_state(p, **pose, v_x=drive.start[at.V_X])[0][:S] for p in (low, high)]
        columns.append((ends[1] - ends[0]) / distance)
    return np.stack(columns, axis=1)


def _slopes(step: Callable, plant: Plant, beside: list, point: tuple, S: int) -> tuple:
    """(next state, F, H, df/dtheta, dh/dtheta) at a point of the drive; its warm start is carried on."""
    state, warm, command = point
    copies = np.tile(state, (1 + 2 * S, 1))
    for j in range(S):
        copies[1 + 2 * j, j] += _STEPS[j]
        copies[2 + 2 * j, j] -= _STEPS[j]
    warms = np.tile(warm, (len(copies), 1, 1))
    readings = step(copies, warms, plant, command)
    F = ((copies[1::2, :S] - copies[2::2, :S]) / (2.0 * _STEPS[:S, None])).T
    H = ((readings[1::2] - readings[2::2]) / (2.0 * _STEPS[:S, None])).T
    f_theta, h_theta = np.empty((S, len(beside))), np.empty((5, len(beside)))
    for i, (low, high, distance) in enumerate(beside):
        ends = []
        for other in (low, high):
            own = state[None].copy()
            ends.append((step(own, warm[None].copy(), other, command)[0], own[0, :S]))
        h_theta[:, i] = (ends[1][0] - ends[0][0]) / distance
        f_theta[:, i] = (ends[1][1] - ends[0][1]) / distance
    warm[:] = warms[0]
    return copies[0], F, H, f_theta, h_theta


def _fixes(noise: Noise, dt: float, k: int) -> bool:
    """Whether sample ``k`` brings a satellite fix."""
    return noise.fix and k % max(round(_FIX_PERIOD / dt), 1) == 0


def _with_fix(H: np.ndarray, h_theta: np.ndarray, noise: Noise, fixed: bool) -> tuple:
    """Reading slopes and variances, with the satellite's position and forward speed where there is a fix."""
    R = np.square([noise.accelerometer] * 3 + [noise.gyro] * 2)
    if not fixed:
        return H, h_theta, R
    rows = np.zeros((3, H.shape[1]))
    rows[[0, 1, 2], [at.X, at.Y, at.V_X]] = 1.0
    fix = np.square([noise.fix_position, noise.fix_position, noise.fix_speed])
    return (
        np.vstack([H, rows]),
        np.vstack([h_theta, np.zeros((3, h_theta.shape[1]))]),
        np.concatenate([R, fix]),
    )


# ------------------------------------------------------------------ estimates from noise


def scatter(
    line: Linearised, seeds: Sequence[int], *, progress: Callable[[float], None] | None = None
) -> np.ndarray:
    """Errors of estimates over noise seeds: the most probable parameters given all readings and a prior.

    Every seed draws a true start, process and sensor noise, and a prior mean about the truth. The
    estimate is iterated on the nonlinear model; only its slopes are those of the undisturbed drive
    (Gauss-Newton with a fixed Jacobian).

    Returns
    -------
    (len(seeds), q) in shown units; a row of NaN where the estimate left the range of the model.
    """
    errors = np.full((len(seeds), len(line.parameters)), math.nan)
    for i, seed in enumerate(seeds):
        with suppress(SolverFailure):
            errors[i] = _one_estimate(line, seed)
        if progress is not None:
            progress((i + 1) / len(seeds))
    return errors


def _one_estimate(line: Linearised, seed: int) -> np.ndarray:
    information, rng = line.information, np.random.default_rng(seed)
    sd = information.prior_sd
    z = _measured(line, rng)
    guess = prior = rng.normal(size=len(sd)) * sd
    weight = np.diag(1.0 / np.square(sd))
    for _ in range(_ITERATIONS):
        gradient = _score(line, z, guess) + weight @ (prior - guess)
        change = information.bound @ gradient
        guess = guess + change
        if np.max(np.abs(change) / np.sqrt(np.diag(information.bound))) < 1e-3:
            break
    return guess


def _measured(line: Linearised, rng: np.random.Generator) -> list[np.ndarray]:
    """Readings of a drive that differs from the planned one by start, process and sensor noise."""
    noise, plant, drive = line.noise, line.manoeuvre.plant, line.manoeuvre
    step, S = _stepper(plant, drive.dt), len(line.start_slope)
    x, warm = line.states[:1].copy(), drive.warm[None].copy()
    x[0, :S] += rng.normal(size=S) * noise.start[:S]
    walk = np.array(noise.process[: S - at.V_X]) * math.sqrt(drive.dt)
    sensor = np.array([noise.accelerometer] * 3 + [noise.gyro] * 2)
    fix_sd = np.array([noise.fix_position, noise.fix_position, noise.fix_speed])
    z = []
    for k, command in enumerate(drive.commands):
        fix = x[0, [at.X, at.Y, at.V_X]] + rng.normal(size=3) * fix_sd
        imu = step(x, warm, plant, command)[0] + rng.normal(size=5) * sensor
        x[0, at.V_X : S] += rng.normal(size=len(walk)) * walk
        z.append(np.concatenate([imu, fix]) if _fixes(noise, drive.dt, k) else imu)
    return z


def _score(line: Linearised, z: list[np.ndarray], guess: np.ndarray) -> np.ndarray:
    """Gradient (q,) of the log likelihood at a guess of the parameters, by the filter of the state."""
    plant, drive = line.manoeuvre.plant, line.manoeuvre
    for name, shown in zip(line.parameters, guess, strict=True):
        plant = PARAMETERS[name].changed(plant, float(shown))
    step, S = _stepper(plant, drive.dt), len(line.start_slope)
    pose = {"x": drive.start[at.X], "y": drive.start[at.Y], "yaw": drive.start[at.YAW]}
    settled, warm = settled_state(plant, **pose, v_x=drive.start[at.V_X])
    # The settled start moves with the soil; what else the start holds stays.
    undisturbed = settled_state(drive.plant, **pose, v_x=drive.start[at.V_X])[0]
    x, warm = (drive.start + settled - undisturbed)[None], warm[None]
    total = np.zeros(len(guess))
    for command, sample, gain, white in zip(drive.commands, z, line.gains, line.whitened, strict=True):
        expected = x[0, [at.X, at.Y, at.V_X]]
        reading = step(x, warm, plant, command)[0]
        if len(sample) > 5:
            reading = np.concatenate([reading, expected])
        innovation = sample - reading
        total += white @ innovation
        x[0, :S] += gain @ innovation
    return total
