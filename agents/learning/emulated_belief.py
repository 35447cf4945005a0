"""The error of the belief about the soil, emulated: the belief takes several times as long as the wheels.

A policy that is to be driven with ``terrain_info="belief"`` needs hours of driving with it. In training it is
therefore shown the true limits with an error like the belief's. In logarithms the belief is taken as
Bayesian: a prior (mean, standard deviation S) of which a share w of the variance is left has the mean
``w mean + (1 - w) truth + S sqrt(w (1 - w)) xi``, xi standard normal and slow. What is left depends on how
much of the grip has been used: w = f + (1 - f) / (1 + k U) with U the time integral of (acceleration /
lateral limit)^2; for n it depends on the time of driving. The slip of the largest pull and the risk of no
pull stay those of the truth. Tests and benchmarks use the belief itself.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from estimators.filters.online_soil_belief import BELIEF_VECTOR, LONGEST

__all__ = ["EmulatedBelief"]

#: Quantity -> median and logarithmic standard deviation of the prior, sign of the common error. Fitted by
#: eye, as are the constants below, to 9 training episodes of `speed` (natural form, seed 77) with the belief,
#: resistance and sinkage to 14 others (seed 78): means of the first quarter of a second, standard deviations
#: against use of the grip and time. These two stay off by a factor of e where the others err by 15 %.
_PRIOR = {
    "lateral": (5.6, 0.41, 1.0),
    "pull": (8400.0, 0.40, 1.0),
    "resistance": (330.0, 1.2, -1.0),
    "sinkage": (0.016, 1.3, -1.0),
    "stopping": (2.1, 0.42, -1.0),
}
#: Variance that is never unlearnt, and gain of use.
_FLOOR, _GAIN = 0.12, 3.0
#: n: mean, standard deviation, and the time in which half of its variance goes [s].
_N_MEAN, _N_SD, _N_TIME = 0.69, 0.42, 3.5
#: Duration of an error, and of driving until the flag is up [s].
_ERROR_TIME, _FLAG_TIME = 5.0, 2.0
_AT = {name: BELIEF_VECTOR.index(name) for name in BELIEF_VECTOR}


class EmulatedBelief:
    """Beliefs of ``count`` episodes that are driven side by side.

    Parameters
    ----------
    count
    dt
        Time between two calls of `shown` [s].
    seed
        Of the errors.
    """

    def __init__(self, count: int, dt: float, seed: int | None) -> None:
        self._dt = dt
        self._rng = np.random.default_rng(seed)
        self._used, self._time = np.zeros(count), np.zeros(count)
        self._error = self._rng.standard_normal((count, 2))

    def restart(self, rows: np.ndarray) -> None:
        """Begin anew in the episodes ``rows`` (N,) bool: nothing is known of their soils."""
        self._used[rows], self._time[rows] = 0.0, 0.0
        self._error[rows] = self._rng.standard_normal((int(rows.sum()), 2))

    def shown(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """(N, 17) beliefs for observations with the true limits; the next moment of every episode."""
        truth, imu = observations["terrain"].astype(float), observations["imu"]
        rho = np.exp(-self._dt / _ERROR_TIME)
        self._error *= rho
        self._error += np.sqrt(1.0 - rho * rho) * self._rng.standard_normal(self._error.shape)
        limit = np.maximum(truth[:, _AT["lateral"]], 0.3)
        self._used += self._dt * np.minimum(np.hypot(imu[:, 0], imu[:, 1]) / limit, 1.5) ** 2
        self._time += self._dt
        left = _FLOOR + (1.0 - _FLOOR) / (1.0 + _GAIN * self._used)
        out = truth.copy()
        for name, (median, sd, sign) in _PRIOR.items():
            positive = np.maximum(truth[:, _AT[name]], 1e-3 * median)
            noise = sign * sd * np.sqrt(left * (1.0 - left)) * self._error[:, 0]
            mean = np.exp(left * np.log(median) + (1.0 - left) * np.log(positive) + noise)
            out[:, _AT[name]], out[:, _AT[f"{name}_sd"]] = mean, mean * sd * np.sqrt(left)
        left = _FLOOR + (1.0 - _FLOOR) / (1.0 + (self._time / _N_TIME) ** 2)
        noise = _N_SD * np.sqrt(left * (1.0 - left)) * self._error[:, 1]
        out[:, _AT["n"]] = np.maximum(left * _N_MEAN + (1.0 - left) * truth[:, _AT["n"]] + noise, 0.1)
        out[:, _AT["n_sd"]] = _N_SD * np.sqrt(left)
        out[:, _AT["stop_in"]] = LONGEST
        out[:, _AT["valid"]] = self._time >= _FLAG_TIME
        return out.astype(np.float32)
