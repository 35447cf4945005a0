"""The damper hardens with speed."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.records import AxleSpring, FloatArray, SpringState

__all__ = ["EFFECT"]

#: Largest rate of the suspension in the law [m/s]: the cube grows without bound.
_FASTEST = 2.0


@inline_kernel
def _law(N_0: float, row: FloatArray, state: SpringState, spring: AxleSpring) -> float:
    cubic: float = row[0]
    rate = min(max(state.rate, -_FASTEST), _FASTEST)
    return N_0 - cubic * rate * rate * rate


EFFECT = Effect(
    id="damper_nonlinear",
    family="suspension",
    hook="suspension",
    size=Parameter(name="cubic", unit="N s^3/m^3", low=-1e7, high=1e7),
    plausible=lambda vehicle: 10.0 * (vehicle.c_f + vehicle.c_r),
    sentence="the dampers add {size} times the cube of their speed",
    source="assumption of this project: the cubic term of an odd force-velocity curve",
    look_alikes=("coulomb_friction",),
    separated_by="bumps, small and large",
    law=_law,
)
