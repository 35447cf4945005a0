"""Estimates from simulated noise, to compare their scatter with the Cramer-Rao bound of a drive."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np

from estimators.experiments.fisher_information import PARAMETERS, Linearised, fix_at
from estimators.experiments.manoeuvres import stepper
from offroad_env.errors import SolverFailure
from offroad_env.physics import state as at
from offroad_env.simulation.simulator import settled_state

__all__ = ["estimation_errors"]

#: Most Gauss-Newton steps of an estimate, and the change that ends them, in standard deviations.
_ITERATIONS, _CONVERGED = 20, 0.01


def estimation_errors(
    line: Linearised, seeds: Sequence[int], *, progress: Callable[[float], None] | None = None
) -> np.ndarray:
    """Errors of estimates over noise seeds: the most probable parameters given all readings and a prior.

    Every seed draws a true start, process and sensor noise, and a prior mean about the truth. The
    estimate is iterated on the nonlinear model; only its slopes are those of the undisturbed drive
    (Gauss-Newton with a fixed Jacobian). The search begins at the truth: the bound is local, and
    whether a search gets there from afar is another question.

    Returns
    -------
    (len(seeds), q) in shown units; a row of NaN where the estimate did not converge or left the model.
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
    prior, guess = rng.normal(size=len(sd)) * sd, np.zeros(len(sd))
    weight = np.diag(1.0 / np.square(sd))
    for _ in range(_ITERATIONS):
        gradient = _score(line, z, guess) + weight @ (prior - guess)
        change = information.bound @ gradient
        guess = guess + change
        if np.max(np.abs(change) / np.sqrt(np.diag(information.bound))) < _CONVERGED:
            return np.asarray(guess)
    return np.full(len(sd), math.nan)


def _measured(line: Linearised, rng: np.random.Generator) -> list[np.ndarray]:
    """Readings of a drive that differs from the planned one by start, process and sensor noise."""
    noise, plant, drive = line.noise, line.manoeuvre.plant, line.manoeuvre
    step, S = stepper(plant, drive.dt), len(line.start_slope)
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
        z.append(np.concatenate([imu, fix]) if fix_at(noise, drive.dt, k) else imu)
    return z


def _score(line: Linearised, z: list[np.ndarray], guess: np.ndarray) -> np.ndarray:
    """Gradient (q,) of the log likelihood at a guess of the parameters, by the filter of the state."""
    plant, drive = line.manoeuvre.plant, line.manoeuvre
    for name, shown in zip(line.parameters, guess, strict=True):
        plant = PARAMETERS[name].changed(plant, float(shown))
    step, S = stepper(plant, drive.dt), len(line.start_slope)
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
