"""Where along a route an effect may begin: the places that a search tries."""

from __future__ import annotations

import math

import numpy as np

from offroad_env.effects.protocol import Parameter

__all__ = ["PLACE_AND_DIRECTION", "borders", "middle_of_route"]

#: Where a border lies along a direction of the map.
PLACE_AND_DIRECTION = (
    Parameter(name="place", unit="m", low=-1e8, high=1e8),
    Parameter(name="direction", unit="rad", low=-1e5, high=1e5),
)

#: Shares of the route's extent at which a border is tried.
_SHARES = (0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85)


def _extent(route: np.ndarray) -> tuple[np.ndarray, float]:
    """Positions along the main direction of the route (T, 2) [m], and that direction [rad]."""
    centred = route - route.mean(axis=0)
    _, axes = np.linalg.eigh(centred.T @ centred)
    axis = axes[:, -1]
    # Forwards, as the vehicle went.
    if axis @ (route[-1] - route[0]) < 0.0:
        axis = -axis
    return route @ axis, math.atan2(axis[1], axis[0])


def middle_of_route(route: np.ndarray) -> list[dict[str, float]]:
    """The one place that leaves the mean of n as it is."""
    along, direction = _extent(route)
    return [{"place": float(along.mean()), "direction": direction}]


def borders(route: np.ndarray) -> list[dict[str, float]]:
    """Straight borders across the route."""
    along, direction = _extent(route)
    return [{"place": float(np.quantile(along, share)), "direction": direction} for share in _SHARES]
