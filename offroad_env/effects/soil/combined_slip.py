"""Combined slip: how fast a wheel slides over the soil, along itself and across together."""

from __future__ import annotations

import math

from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.records import WheelMotion
from offroad_env.physics.slip import slip_ratio

__all__ = ["combined_slip"]


@inline_kernel
def combined_slip(motion: WheelMotion, v_eps: float) -> float:
    """Slip along the wheel and across it together, 0 ... 1; ``v_eps`` [m/s] regularises it at low speed.

    Across the wheel it is the side speed over the larger of rim and travel speed. Smooth at zero,
    where a kink would show in every force.
    """
    along = slip_ratio(motion.rim_speed, motion.v_l, v_eps)
    travel_2 = motion.v_l * motion.v_l + motion.v_c * motion.v_c
    largest_2 = max(motion.rim_speed * motion.rim_speed, travel_2) + v_eps * v_eps
    # 1e-24 is the square of `slip.TINY_SPEED`; 1e-4 and 1e-2 round the kink at zero over a slip of 0.01.
    square = along * along + motion.v_c * motion.v_c / (largest_2 + 1e-24)
    return min(math.sqrt(square + 1e-4) - 1e-2, 1.0)
