"""Power that soil takes from a wheel: what its shaft puts in, less what the wheel does on the vehicle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from offroad_env.errors import InvalidParameter
from offroad_env.physics._jit import kernel
from offroad_env.physics.records import (
    ContactOptions,
    FloatArray,
    RutSection,
    Soil,
    Structure,
    Wheel,
    WheelMotion,
)
from offroad_env.physics.structured_contact import structured_reaction

__all__ = ["VIRGIN", "PowerStates", "random_rolling_states", "soil_power"]

#: Soil that no wheel has pressed before.
VIRGIN = RutSection(0.0, 0.0, 0.0)
#: Speed below which resistance is viscous, as in `make_plant` [m/s].
_SLOW = 0.2


class PowerStates(NamedTuple):
    """How a wheel moves and how deep it is; arrays that broadcast against each other."""

    rim: np.ndarray  #: rim speed r omega [m/s]
    v_l: np.ndarray  #: speed along the wheel [m/s]
    v_c: np.ndarray  #: speed to its left [m/s]
    sinkage: np.ndarray  #: [m]


@kernel
def _powers(
    structure: Structure,
    soil: Soil,
    wheel: Wheel,
    rows: FloatArray,
    rut: RutSection,
    options: ContactOptions,
    out: FloatArray,
) -> None:
    """Row by row: ``rows`` (M, 4) as `PowerStates`; the rut's depth is a share of the sinkage."""
    for i in range(rows.shape[0]):
        motion, h = WheelMotion(rows[i, 0], rows[i, 1], rows[i, 2]), rows[i, 3]
        track = RutSection(rut.share, rut.depth * h, rut.shear)
        found = structured_reaction(structure, soil, wheel, motion, h, 0.0, track, options)
        power = found.torque * motion.rim_speed / wheel.r - found.F_x * motion.v_l - found.F_y * motion.v_c
        out[i] = power / (abs(found.F_z) * (abs(motion.rim_speed) + abs(motion.v_l)))


def soil_power(
    structure: Structure, soil: Soil, wheel: Wheel, states: PowerStates, *, rut: RutSection = VIRGIN
) -> np.ndarray:
    """Power that the soil takes up, over the load times the speeds |r omega| + |v_l| [-].

    Negative: the soil drives the wheel.

    Parameters
    ----------
    structure
        Laws of a rigid wheel.
    soil
        A deformable one.
    wheel
        From `make_wheel`.
    states
        How the wheel moves, at a given sinkage.
    rut
        What it follows; its ``depth`` is a share of the sinkage here, 0 ... 1.

    Returns
    -------
    array
        Of the broadcast shape of the states.

    Raises
    ------
    InvalidParameter
        For hard ground, or a tyre, which stores energy of its own.
    """
    if soil.rigid > 0.5:
        raise InvalidParameter("soil must be deformable: the power that soil takes up, got hard ground")
    if structure.tyre is not None:
        raise InvalidParameter("structure must have no tyre: a tyre stores energy of its own")
    columns = np.broadcast_arrays(*states)
    rows = np.column_stack([np.asarray(column, dtype=np.float64).ravel() for column in columns])
    out = np.empty(len(rows))
    _powers(structure, soil, wheel, rows, rut, ContactOptions(_SLOW, structure.resultant, False), out)
    return out.reshape(columns[0].shape)


def random_rolling_states(rng: np.random.Generator, count: int) -> PowerStates:
    """States (count,) of steady rolling, in which the rim turns the way it travels.

    Rim and travel 0.05 ... 8 m/s, to the side up to 3 m/s, 2 ... 120 mm deep.
    """
    return PowerStates(
        rng.uniform(0.05, 8.0, count),
        rng.uniform(0.05, 8.0, count),
        rng.uniform(-3.0, 3.0, count),
        rng.uniform(0.002, 0.12, count),
    )
