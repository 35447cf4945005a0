"""Fixed-interval smoother of one channel: a local linear trend whose roughness is the most probable one.

The signal's slope is a random walk, so the smoothed channel is a cubic spline (Wecker & Ansley, J. Am. Stat.
Assoc. 78 (1983), 81-89). A Kalman filter gives the likelihood of the roughness, the backward pass of Rauch,
Tung & Striebel (AIAA J. 3 (1965), 1445-1450) the signal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from offroad_env.physics._jit import kernel
from offroad_env.physics.records import FloatArray

__all__ = ["SmoothChannel", "smooth_channel"]

_LOG_2PI = math.log(2.0 * math.pi)
#: Search of the roughness: decades about that of a signal which moves by its noise in one sample.
_DECADES = (-14.0, 4.0)
#: Noise that is so small a share of a channel's range is rounding.
_NEGLIGIBLE = 1e-9


@dataclass(frozen=True, kw_only=True)
class SmoothChannel:
    """A channel without its noise, a row per sample."""

    value: np.ndarray  #: (T,) [unit of the channel]
    slope: np.ndarray  #: (T,) its rate of change [1/s]
    sd: np.ndarray  #: (T,) standard deviation of ``value``


@kernel
def _forward(
    values: FloatArray, step: float, q: float, variance: float, means: FloatArray, covs: FloatArray
) -> float:
    """Kalman filter of the trend; filtered means (T, 2) and covariances (T, 2, 2); the log-likelihood."""
    likelihood = 0.0
    v, s = values[0], 0.0
    # The first sample, and a slope that nothing is known of yet.
    p, r, w = variance, 0.0, 1e4 * max(variance, 1e-12) / step**2
    for k in range(values.shape[0]):
        if k > 0:
            v += step * s
            p += 2.0 * step * r + step * step * w + q * step**3 / 3.0
            r += step * w + 0.5 * q * step * step
            w += q * step
            if not math.isnan(values[k]):
                total, innovation = p + variance, values[k] - v
                likelihood -= 0.5 * (math.log(total) + innovation * innovation / total + _LOG_2PI)
                v += p / total * innovation
                s += r / total * innovation
                w -= r * r / total
                r *= variance / total
                p *= variance / total
        means[k, 0], means[k, 1] = v, s
        covs[k, 0, 0], covs[k, 0, 1], covs[k, 1, 0], covs[k, 1, 1] = p, r, r, w
    return likelihood


@kernel
def _backward(means: FloatArray, covs: FloatArray, step: float, q: float) -> None:
    """Pass of Rauch, Tung & Striebel: filtered becomes smoothed, in place."""
    for back in range(means.shape[0] - 1):
        k = means.shape[0] - 2 - back
        v, s = means[k, 0] + step * means[k, 1], means[k, 1]
        p, r, w = covs[k, 0, 0], covs[k, 0, 1], covs[k, 1, 1]
        # Covariance with the state one step on, and that state's own, predicted.
        p_v, r_v = p + step * r, r + step * w
        P, R = p_v + step * r_v + q * step**3 / 3.0, r_v + 0.5 * q * step**2
        W = w + q * step
        det = P * W - R * R
        if not det > 0.0:  # lost to rounding
            det = math.nan
        g_vv, g_vs = (p_v * W - r * R) / det, (r * P - p_v * R) / det
        g_sv, g_ss = (r_v * W - w * R) / det, (w * P - r_v * R) / det
        late_v, late_s = means[k + 1, 0] - v, means[k + 1, 1] - s
        means[k, 0] += g_vv * late_v + g_vs * late_s
        means[k, 1] += g_sv * late_v + g_ss * late_s
        P, R, W = covs[k + 1, 0, 0] - P, covs[k + 1, 0, 1] - R, covs[k + 1, 1, 1] - W
        covs[k, 0, 0] += g_vv * g_vv * P + 2.0 * g_vv * g_vs * R + g_vs * g_vs * W
        covs[k, 0, 1] += g_vv * g_sv * P + (g_vv * g_ss + g_vs * g_sv) * R + g_vs * g_ss * W
        covs[k, 1, 0] = covs[k, 0, 1]
        covs[k, 1, 1] += g_sv * g_sv * P + 2.0 * g_sv * g_ss * R + g_ss * g_ss * W


def smooth_channel(values: np.ndarray, step: float, sd: float) -> SmoothChannel:
    """The signal under white noise.

    Parameters
    ----------
    values : array (T,)
        Samples ``step`` [s] apart, NaN where there is none.
    sd : float
        Standard deviation of the noise; a negligible one leaves the samples as they are.

    Raises
    ------
    numpy.linalg.LinAlgError
        Where a covariance becomes singular to rounding.
    """
    values = np.array(values, dtype=np.float64)
    present = ~np.isnan(values)
    if not sd > _NEGLIGIBLE * float(np.ptp(values[present])):
        filled = np.interp(np.arange(len(values)), np.flatnonzero(present), values[present])
        return SmoothChannel(value=filled, slope=np.gradient(filled, step), sd=np.zeros(len(values)))
    values[0] = values[present][0]
    means, covs = np.empty((len(values), 2)), np.empty((len(values), 2, 2))
    # In this unit q = 1 moves the signal by one standard deviation of the noise within a sample.
    unit, variance = sd**2 / step**3, sd**2

    def cost(decade: float) -> float:
        return -_forward(values, step, unit * 10.0**decade, variance, means, covs)

    found = minimize_scalar(cost, bounds=_DECADES, method="bounded", options={"xatol": 0.02})
    q = unit * 10.0**found.x
    _forward(values, step, q, variance, means, covs)
    _backward(means, covs, step, q)
    if not np.isfinite(means).all():
        raise np.linalg.LinAlgError("a covariance of the trend is singular to rounding")
    return SmoothChannel(value=means[:, 0].copy(), slope=means[:, 1].copy(), sd=np.sqrt(covs[:, 0, 0]))
