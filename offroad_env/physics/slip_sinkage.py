"""Slip-sinkage: how much deeper a wheel sinks because it slips."""

from __future__ import annotations

from offroad_env.physics._jit import inline_kernel

__all__ = ["linear_sinkage_factor", "lyasko_sinkage_factor"]


@inline_kernel
def lyasko_sinkage_factor(slip: float) -> float:
    """Sinkage of a wheel at this slip over Bekker's static sinkage [-].

    The factor is of driven wheels that run straight; towed wheels are taken to sink alike.
    """
    s = abs(slip)
    return (1.0 + s) / (1.0 - 0.5 * s)  # M. Lyasko, J. Terramechanics 47 (2010) 21-31


@inline_kernel
def linear_sinkage_factor(rate: float, slip: float) -> float:
    """Sinkage at this slip over the static one [-], 1 + ``rate`` |slip|.

    First order of the slip-sinkage laws compared by M. Lyasko, J. Terramechanics 47 (2010) 21-31.
    """
    return 1.0 + rate * abs(slip)
