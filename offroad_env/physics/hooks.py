"""Where an extension of the model may change what the base model computes.

``effects`` is None for the base model: then every hook hands back what it was given, the compiler
leaves nothing of it, and the base model is the base model bit for bit. Otherwise it is an array with
one row for every effect of the library (`offroad_env.effects`): (active 0/1, up to three parameters).
The laws live one floor up, which this floor may not import; they are installed from there, and a
second version of the models is compiled that knows all of them and asks each row whether it is active.
"""

from __future__ import annotations

from collections.abc import Callable

from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.records import (
    AxleContact,
    AxleForces,
    AxlePlace,
    AxleSpring,
    BodyForces,
    FloatArray,
    Soil,
    SpringState,
    Vehicle,
    WheelMotion,
)

__all__ = ["ROW", "change_body_forces", "change_load", "change_soil", "change_wheel_forces", "install"]

#: Modules whose sources decide what the hooks do, for the cache of compiled kernels.
LATE_IMPORTS = ("offroad_env.effects",)

#: Numbers in a row: whether it acts, and its parameters.
ROW = 4

_soil_laws: Callable[..., Soil]
_wheel_laws: Callable[..., AxleForces]
_load_laws: Callable[..., float]
_body_laws: Callable[..., BodyForces]


def install(
    *,
    soil: Callable[..., Soil],
    wheel: Callable[..., AxleForces],
    load: Callable[..., float],
    body: Callable[..., BodyForces],
) -> None:
    """Set what the hooks call where a plant has effects; once, before anything with effects runs."""
    global _soil_laws, _wheel_laws, _load_laws, _body_laws
    _soil_laws, _wheel_laws, _load_laws, _body_laws = soil, wheel, load, body


@inline_kernel
def change_soil(effects: FloatArray | None, soil: Soil, motion: WheelMotion, place: AxlePlace) -> Soil:
    """The soil under an axle."""
    if effects is None:
        return soil
    return _soil_laws(effects, soil, motion, place)


@inline_kernel
def change_wheel_forces(
    effects: FloatArray | None, forces: AxleForces, motion: WheelMotion, contact: AxleContact
) -> AxleForces:
    """Forces of the soil on an axle, in the contact's axes."""
    if effects is None:
        return forces
    return _wheel_laws(effects, forces, motion, contact)


@inline_kernel
def change_load(effects: FloatArray | None, N_0: float, state: SpringState, spring: AxleSpring) -> float:
    """Load of an axle on ground that does not yield [N]."""
    if effects is None:
        return N_0
    return _load_laws(effects, N_0, state, spring)


@inline_kernel
def change_body_forces(
    effects: FloatArray | None, forces: BodyForces, x: FloatArray, vehicle: Vehicle
) -> BodyForces:
    """Horizontal forces on the vehicle in heading axes; ``x`` is the state of the vehicle."""
    if effects is None:
        return forces
    return _body_laws(effects, forces, x, vehicle)
