"""Force and sinkage of one wheel on a soil, over slip and over load: for `agents.reports.figures.soil`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics.records import Soil, Wheel
from offroad_env.simulation.wheel import wheel_forces

__all__ = ["SoilCurves", "soil_curves"]

_SLIP_POINTS, _LOAD_POINTS = 101, 41


@dataclass(frozen=True, kw_only=True)
class SoilCurves:
    """Curves over slip at fixed loads (first axis L) and over load at fixed slips (first axis S).

    NaN where the soil cannot carry the wheel.
    """

    soil: Soil
    wheel: Wheel
    shear: str
    slip_angle: float  #: of the side force [rad]; sinkage and drawbar pull are for straight running
    loads: np.ndarray  #: (L,) wheel loads of the curves over slip [N]
    slips: np.ndarray  #: (S,) slips of the curves over load [-]
    slip_axis: np.ndarray  #: (K,) [-]
    load_axis: np.ndarray  #: (M,) [N]
    over_slip: dict[str, np.ndarray]  #: "sinkage" [m], "drawbar" [N], "side_force" [N]: (L, K) each
    over_load: dict[str, np.ndarray]  #: the same, (S, M)


def soil_curves(
    soil: Soil,
    wheel: Wheel,
    *,
    loads: Sequence[float],
    slips: Sequence[float] = (0.0, 0.1, 0.3),
    slip_angle: float = 0.1745,
    shear: str = "independent",
) -> SoilCurves:
    """Evaluate `wheel_forces` along both axes.

    Parameters
    ----------
    soil, wheel
    loads
        Wheel loads of the curves over slip [N]; the largest ends the axis of the curves over load.
    slips
        Slips of the curves over load [-].
    slip_angle
        At which the side force is evaluated [rad].
    shear
        As in `wheel_forces`.

    Raises
    ------
    InvalidParameter
        For an empty list, a load that is not positive, or values that `wheel_forces` refuses.
    """
    if len(loads) == 0 or len(slips) == 0 or min(loads) <= 0.0:
        raise InvalidParameter(f"loads must be positive [N] and slips not empty, got {loads} and {slips}")
    slip_axis = np.linspace(-1.0, 1.0, _SLIP_POINTS)
    load_axis = np.linspace(max(loads) / _LOAD_POINTS, max(loads), _LOAD_POINTS)

    def curves(load: np.ndarray, slip: np.ndarray) -> dict[str, np.ndarray]:
        straight = _forces(soil, wheel, load, slip, 0.0, shear)
        turned = _forces(soil, wheel, load, slip, slip_angle, shear)
        return {"sinkage": straight[0], "drawbar": straight[1], "side_force": -turned[2]}

    return SoilCurves(
        soil=soil,
        wheel=wheel,
        shear=shear,
        slip_angle=slip_angle,
        loads=np.array(loads, dtype=np.float64),
        slips=np.array(slips, dtype=np.float64),
        slip_axis=slip_axis,
        load_axis=load_axis,
        over_slip=curves(np.array(loads)[:, None], slip_axis[None, :]),
        over_load=curves(load_axis[None, :], np.array(slips)[:, None]),
    )


def _forces(
    soil: Soil, wheel: Wheel, load: np.ndarray, slip: np.ndarray, slip_angle: float, shear: str
) -> np.ndarray:
    """(3, ...) sinkage, F_x, F_y of the broadcast shape; NaN where the soil cannot carry the wheel."""
    load, slip = np.broadcast_arrays(load, slip)
    out = np.full((3, *load.shape), np.nan)
    for place in np.ndindex(load.shape):
        try:
            at = wheel_forces(
                soil, wheel, load=load[place], slip=slip[place], slip_angle=slip_angle, shear=shear
            )
        except SolverFailure:
            continue  # the wheel digs itself in: the curve ends here
        out[(slice(None), *place)] = at.sinkage, at.F_x, at.F_y
    return out
