"""The vehicle from behind: roll, and how each of four wheels stands in the soil."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from offroad_env.environment.snapshot import Snapshot
from offroad_env.physics import state as at
from offroad_env.rendering.canvas import Canvas, number, rectangle, turned
from offroad_env.rendering.style import BODY, CAB, EDGE, FRONT, INK, MUTED, REAR, SOIL, TYRE, Box
from offroad_env.world.terrain import heights

__all__ = ["REAR_WIDTH", "RearView"]

#: Width of the panel [pixels].
REAR_WIDTH = 150


class RearView:
    """Rear axle and body from behind, at true scale, and the loads of all four wheels."""

    def __init__(self, canvas: Canvas) -> None:
        self.canvas = canvas

    def draw(self, snapshot: Snapshot, box: Box) -> None:
        """The whole panel; for vehicles with roll only."""
        vehicle, state = snapshot.plant.vehicle, snapshot.state
        wheels = snapshot.readings[at.WHEELS : at.ROLL_ACC].reshape(at.WHEEL_COUNT, at.AXLE)
        rear = wheels[2:]
        track = float(np.hypot(*np.diff(rear[:, [at.WHEEL_X, at.WHEEL_Y]], axis=0)[0]))
        scale = 0.62 * box.width / (track + vehicle.b)
        datum = float(rear[:, at.HEIGHT].mean())
        origin = np.array([box.left + 0.5 * box.width, box.top + box.height - 34.0])

        def put(places: np.ndarray) -> np.ndarray:
            return np.asarray(origin + scale * (np.asarray(places) - [0.0, datum]) * [1.0, -1.0])

        canvas = self.canvas
        with canvas.clipped(box):
            # Seen from behind the left side is on the left.
            across = np.linspace(-0.5, 0.5, 41) * box.width / scale
            yaw = float(state[at.YAW])
            middle = rear[:, [at.WHEEL_X, at.WHEEL_Y]].mean(axis=0)
            X, Y = middle[0] + across * math.sin(yaw), middle[1] - across * math.cos(yaw)
            line = put(np.column_stack((across, heights(snapshot.course.ground, X, Y))))
            base = box.top + box.height
            canvas.shape(np.concatenate((line, [[line[-1, 0], base], [line[0, 0], base]])), SOIL)
            self._draw_body(snapshot, rear, put, track)
            canvas.stroke(line, EDGE, 1.0)
        self._write(snapshot, wheels, box)

    def _draw_body(
        self, snapshot: Snapshot, rear: np.ndarray, put: Callable[[np.ndarray], np.ndarray], track: float
    ) -> None:
        vehicle, roll = snapshot.plant.vehicle, float(snapshot.state[at.ROLL])
        bottoms = rear[:, at.HEIGHT] - rear[:, at.SINKAGE]
        r = vehicle.r
        for place, bottom in zip((-0.5 * track, 0.5 * track), bottoms, strict=True):
            self.canvas.shape(put(rectangle(place, bottom + r, vehicle.b, 2.0 * r)), TYRE, REAR)
        # The left side up is a turn to the right as seen from behind.
        floor = np.array([0.0, float(bottoms.mean()) + 1.3 * r])
        hull = [[-0.46, 0.0], [0.46, 0.0], [0.42, 0.38], [-0.42, 0.38]]
        cage = [[-0.36, 0.38], [0.36, 0.38], [0.28, 0.85], [-0.28, 0.85]]
        for shape, colour in ((cage, CAB), (hull, BODY)):
            self.canvas.shape(put(floor + turned(track * np.array(shape), -roll)), colour, INK)

    def _write(self, snapshot: Snapshot, wheels: np.ndarray, box: Box) -> None:
        canvas, middle = self.canvas, box.left + 0.5 * box.width
        roll = number(math.degrees(snapshot.state[at.ROLL]), 1, "\u00b0", sign=True)
        canvas.text((middle, box.top + 10), f"rear view, roll {roll}", anchor="center")
        y = box.top + box.height - 22
        for name, pair, colour, down in (("front", wheels[:2], FRONT, 0), ("rear", wheels[2:], REAR, 15)):
            left, right = (number(1e-3 * float(load), 1) for load in pair[:, at.N])
            canvas.text((box.left + 4, y + down), left, colour=colour)
            canvas.text((middle, y + down), f"{name} [kN]", colour=MUTED, anchor="center")
            canvas.text((box.left + box.width - 4, y + down), right, colour=colour, anchor="midright")
