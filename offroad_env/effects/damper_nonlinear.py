"""The damper hardens with speed."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel

__all__ = ["EFFECT"]


@inline_kernel
def _law(N_0, row, spring, axle):
    rate = min(max(spring[1], -2.0), 2.0)
    return N_0 - row[0] * rate * rate * rate


EFFECT = Effect(
    id="damper_nonlinear",
    family="suspension",
    hook="suspension",
    size=Parameter(name="cubic", unit="N s^3/m^3", low=-1e7, high=1e7),
    plausible=lambda vehicle: 10.0 * (vehicle.c_f + vehicle.c_r),
    sentence="the dampers add {size} times the cube of their speed",
    look_alikes=("coulomb_friction",),
    separated_by="bumps, small and large",
    law=_law,
)
