"""Changes of the soil that several effects make."""

from __future__ import annotations

from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.records import Soil

__all__ = ["stiffer"]


@inline_kernel
def stiffer(soil, factor):
    """The same soil with another pressure at every depth."""
    return Soil(
        factor * soil.k_c,
        factor * soil.k_phi,
        soil.n,
        soil.c,
        soil.phi,
        soil.k_x,
        soil.k_y,
        soil.a_0,
        soil.a_1,
        soil.b_0,
        soil.b_1,
        soil.rigid,
        soil.mu,
        soil.C_alpha,
    )
