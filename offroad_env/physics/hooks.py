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

__all__ = ["ROW", "change_body_forces", "change_load", "change_soil", "change_wheel_forces", "install"]

#: Modules whose sources decide what the hooks do, for the cache of compiled kernels.
LATE_IMPORTS = ("offroad_env.effects",)

#: Numbers in a row: whether it acts, and its parameters.
ROW = 4

_soil_laws: Callable | None = None
_wheel_laws: Callable | None = None
_load_laws: Callable | None = None
_body_laws: Callable | None = None


def install(*, soil: Callable, wheel: Callable, load: Callable, body: Callable) -> None:
    """Set what the hooks call where a plant has effects; once, before anything with effects runs."""
    global _soil_laws, _wheel_laws, _load_laws, _body_laws
    _soil_laws, _wheel_laws, _load_laws, _body_laws = soil, wheel, load, body


@inline_kernel
def change_soil(effects, soil, motion, where):
    """The soil under an axle; ``motion`` = (r omega, v_l, v_c) [m/s], ``where`` = (x, y, arm, v_eps)."""
    if effects is None:
        return soil
    return _soil_laws(effects, soil, motion, where)


@inline_kernel
def change_wheel_forces(effects, forces, motion, contact, vehicle):
    """(F_x, F_y, torque) of an axle in the contact's axes; ``contact`` = (F_n, sinkage, arm, v_eps)."""
    if effects is None:
        return forces
    return _wheel_laws(effects, forces, motion, contact, vehicle)


@inline_kernel
def change_load(effects, N_0, spring, axle):
    """Load of an axle on ground that does not yield [N].

    ``spring`` = (height [m], its rate [m/s]) of the axle over the ground, from static equilibrium;
    ``axle`` = (static load [N], k, c).
    """
    if effects is None:
        return N_0
    return _load_laws(effects, N_0, spring, axle)


@inline_kernel
def change_body_forces(effects, forces, x, vehicle):
    """(forward force [N], left force [N], yaw moment [N m]) on the vehicle in heading axes."""
    if effects is None:
        return forces
    return _body_laws(effects, forces, x, vehicle)
