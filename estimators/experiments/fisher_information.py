"""Fisher information of a drive about n and a second parameter of the soil.

The vehicle's state is not known either, so what counts is the information about the soil that is
left when start, motion and noise are free. For a model that is linearised along the drive it
follows from a Kalman filter of the state alone, whose innovations e_k have covariance S_k: with

    E_k = H_k G_k + dh/dtheta,    G_{k+1} = F_k (G_k - K_k E_k) + df/dtheta

the sensitivity of a predicted reading to the parameters (through the state, too), it is

    I = sum_k E_k^T S_k^-1 E_k.

Independent drives add up. (I + P0^-1)^-1 bounds the covariance of any estimate with the prior P0
from below (Cramer-Rao); `estimators.experiments.simulated_estimates` makes estimates from simulated noise to
compare.

The two soil parameters of a pair often act in the same way: more cohesion and a firmer soil both
carry the vehicle. A drive then reveals one combination and hides the other, and the eigenvectors
of the information are these combinations. They depend on what counts as one unit of each parameter: here the
standard deviation that the prior gives it (`Parameter.sd`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimators.experiments.manoeuvres import Manoeuvre, Stepper, stepper
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.simulation.simulator import Plant, plant_model, settled_state

__all__ = ["PARAMETERS", "Information", "Linearised", "Noise", "Parameter", "fix_at", "linearise"]

#: Half the step of the differences, by state: cubic terms stay below 1e-6 of the slope.
_STEPS = np.array([1e-4, 1e-4, 1e-5, 1e-6, 1e-6, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-3, 1e-3])
_FIX_PERIOD = 0.1  # time between satellite fixes [s]


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
    """What is not known besides the soil, with the values of the filters on a map and of the environment."""

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
class Information:
    """Information of one or more drives about some parameters, the state being free."""

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
        return np.asarray(1.0 / np.sqrt(np.diag(self.matrix) + 1.0 / np.square(self.prior_sd)))

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
        Called with the share that is done, now and then.

    Raises
    ------
    SolverFailure
        Where the drive, or one beside it, has no contact solution.
    """
    noise, names = noise or Noise(), tuple(parameters)
    unknown = set(names) - set(PARAMETERS)
    if unknown or len(set(names)) < len(names) or not names:
        raise InvalidParameter(f"parameters must be some of {', '.join(PARAMETERS)}, got {', '.join(names)}")
    plant, step = drive.plant, stepper(drive.plant, drive.dt)
    S = 12 if plant_model(plant) == "full" else 10
    neighbours = [_neighbours(plant, name) for name in names]
    slope = _start_slope(drive, neighbours, S)
    P, G = np.diag(np.square(noise.start[:S])), slope.copy()
    Q = np.zeros(S)
    Q[at.V_X :] = np.square(noise.process[: S - at.V_X]) * drive.dt
    states, gains, whitened = [drive.start.copy()], [], []
    matrix, warm = np.zeros((len(names), len(names))), drive.warm.copy()
    for k, command in enumerate(drive.commands):
        at_k = _slopes(step, plant, neighbours, states[-1], warm, command, S)
        H, h_theta, R = _with_fix(at_k, noise, fix_at(noise, drive.dt, k))
        innovation = H @ P @ H.T + np.diag(R)
        K = np.linalg.solve(innovation, H @ P).T
        E = H @ G + h_theta
        white = np.linalg.solve(innovation, E).T
        matrix += white @ E
        G = at_k.F @ (G - K @ E) + at_k.f_theta
        P = at_k.F @ (P - K @ innovation @ K.T) @ at_k.F.T + np.diag(Q)
        P = 0.5 * (P + P.T)
        states.append(at_k.state)
        gains.append(at_k.F @ K)
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


class _Neighbours(NamedTuple):
    """A plant with a little less and a little more of a parameter."""

    low: Plant
    high: Plant
    distance: float  #: in shown units


def _neighbours(plant: Plant, name: str) -> _Neighbours:
    parameter = PARAMETERS[name]
    step = 1e-3 * parameter.sd
    return _Neighbours(parameter.changed(plant, -step), parameter.changed(plant, step), 2.0 * step)


def _start_slope(drive: Manoeuvre, neighbours: Sequence[_Neighbours], S: int) -> np.ndarray:
    """How deep the vehicle stands at the start is known but for the soil: (S, q)."""
    pose = {"x": drive.start[at.X], "y": drive.start[at.Y], "yaw": drive.start[at.YAW]}
    columns = []
    for pair in neighbours:
        low, high = (settled_state(p, **pose, v_x=drive.start[at.V_X])[0][:S] for p in (pair.low, pair.high))
        columns.append((high - low) / pair.distance)
    return np.stack(columns, axis=1)


class _Slopes(NamedTuple):
    """Linearisation of one step."""

    state: np.ndarray  #: (15,) at its end
    F: np.ndarray  #: (S, S) of the motion with the state
    H: np.ndarray  #: (5, S) of the reading with the state
    f_theta: np.ndarray  #: (S, q) of the motion with the parameters
    h_theta: np.ndarray  #: (5, q) of the reading with the parameters


def _slopes(
    step: Stepper,
    plant: Plant,
    neighbours: Sequence[_Neighbours],
    state: np.ndarray,
    warm: np.ndarray,
    command: np.ndarray,
    S: int,
) -> _Slopes:
    """Linearisation at a point of the drive; its warm start is renewed in place."""
    copies = np.tile(state, (1 + 2 * S, 1))
    for j in range(S):
        copies[1 + 2 * j, j] += _STEPS[j]
        copies[2 + 2 * j, j] -= _STEPS[j]
    warms = np.tile(warm, (len(copies), 1, 1))
    readings = step(copies, warms, plant, command)
    F = ((copies[1::2, :S] - copies[2::2, :S]) / (2.0 * _STEPS[:S, None])).T
    H = ((readings[1::2] - readings[2::2]) / (2.0 * _STEPS[:S, None])).T
    f_theta, h_theta = np.empty((S, len(neighbours))), np.empty((5, len(neighbours)))
    for i, pair in enumerate(neighbours):
        ends = []
        for other in (pair.low, pair.high):
            own = state[None].copy()
            ends.append((step(own, warm[None].copy(), other, command)[0], own[0, :S]))
        (low_reading, low_state), (high_reading, high_state) = ends
        h_theta[:, i] = (high_reading - low_reading) / pair.distance
        f_theta[:, i] = (high_state - low_state) / pair.distance
    warm[:] = warms[0]
    return _Slopes(copies[0], F, H, f_theta, h_theta)


def fix_at(noise: Noise, dt: float, k: int) -> bool:
    """Whether sample ``k`` brings a satellite fix."""
    return noise.fix and k % max(round(_FIX_PERIOD / dt), 1) == 0


def _with_fix(slopes: _Slopes, noise: Noise, fixed: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Reading slopes and variances, with the satellite's position and forward speed where there is a fix."""
    R = np.square([noise.accelerometer] * 3 + [noise.gyro] * 2)
    if not fixed:
        return slopes.H, slopes.h_theta, R
    rows = np.zeros((3, slopes.H.shape[1]))
    rows[[0, 1, 2], [at.X, at.Y, at.V_X]] = 1.0
    fix = np.square([noise.fix_position, noise.fix_position, noise.fix_speed])
    return (
        np.vstack([slopes.H, rows]),
        np.vstack([slopes.h_theta, np.zeros((3, slopes.h_theta.shape[1]))]),
        np.concatenate([R, fix]),
    )
