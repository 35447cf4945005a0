"""How fast a wheel slides over the soil, whichever way."""

from __future__ import annotations

import math

from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.wheel_soil import slip_ratio

__all__ = ["whole_slip"]


@inline_kernel
def whole_slip(motion, v_eps):
    """Slip along the wheel and across it together, 0 ... 1; ``motion`` = (r omega, v_l, v_c) [m/s].

    Across the wheel it is the side speed over the larger of rim and travel speed. Smooth at zero,
    where a bend would show in every force.
    """
    r_omega, v_l, v_c = motion
    along = slip_ratio(r_omega, v_l, v_eps)
    largest = max(r_omega * r_omega, v_l * v_l + v_c * v_c) + v_eps * v_eps
    square = along * along + v_c * v_c / (largest + 1e-24)
    return min(math.sqrt(square + 1e-4) - 1e-2, 1.0)
