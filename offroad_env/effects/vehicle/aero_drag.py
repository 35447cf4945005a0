"""Air resistance that the model lacks."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import AIR_DENSITY
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import BodyForces, FloatArray, Vehicle

__all__ = ["EFFECT"]


@inline_kernel
def _law(forces: BodyForces, row: FloatArray, x: FloatArray, vehicle: Vehicle) -> BodyForces:
    area = row[0]
    drag = 0.5 * AIR_DENSITY * area * math.sqrt(x[at.V_X] * x[at.V_X] + x[at.V_Y] * x[at.V_Y])
    return replace(forces, F_x=forces.F_x - drag * x[at.V_X], F_y=forces.F_y - drag * x[at.V_Y])


EFFECT = Effect(
    id="aero_drag",
    family="longitudinal",
    hook="body force",
    size=Parameter(name="area", unit="m^2", low=-20.0, high=50.0),
    plausible=lambda vehicle: 1.5 * vehicle.track,
    sentence="air drag area is {size} larger than stated",
    source="Gillespie, Fundamentals of Vehicle Dynamics (1992): aerodynamic drag",
    look_alikes=("rolling_resistance", "rut_drag"),
    separated_by="coasting down from high speed",
    law=_law,
)
