"""The vehicle from its right side, and both wheels in the soil enlarged."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from offroad_env.environment.snapshot import Snapshot
from offroad_env.physics import state as at
from offroad_env.physics.contact_angles import entry_angle, wong_reece_angles
from offroad_env.rendering.canvas import Canvas, number, round_number, turned
from offroad_env.rendering.rear import REAR_WIDTH, RearView
from offroad_env.rendering.style import (
    BODY,
    EDGE,
    FRONT,
    INK,
    MUTED,
    PANEL,
    REAR,
    SIDE,
    SOIL,
    TYRE,
    Box,
    Colour,
)
from offroad_env.world.terrain import heights
from offroad_env.world.vehicles import static_loads

__all__ = ["AxlePlace", "SideView", "axle_place"]


class AxlePlace(NamedTuple):
    """One axle in the side view. Heights are above the undeformed ground's zero."""

    name: str
    colour: Colour
    arm: float  #: distance ahead of the CG [m]
    ground: float  #: undeformed ground under the wheel [m]
    bottom: float  #: lowest point of the wheel [m]
    mount: float  #: where ``bottom`` would be at static suspension travel [m]
    sinkage: float  #: [m]
    airborne: bool
    readings: np.ndarray  #: (13,) of this axle
    rut: float = 0.0  #: depth of the rut that the wheel runs into [m]


def axle_place(snapshot: Snapshot, *, front: bool) -> AxlePlace:
    vehicle, state = snapshot.plant.vehicle, snapshot.state
    readings = snapshot.readings[: at.AXLE] if front else snapshot.readings[at.AXLE : at.MOTION]
    arm = vehicle.l_f if front else -vehicle.l_r
    stiffness = vehicle.k_f if front else vehicle.k_r
    airborne = readings[at.N] <= 0.0
    ground, sinkage = float(readings[at.HEIGHT]), float(readings[at.SINKAGE])
    bottom = mount = ground - sinkage
    if snapshot.plant.half_car > 0.5:
        mount = float(state[at.Z] + arm * math.sin(state[at.PITCH]))
    if airborne:
        # The spring has given all its static load: the wheel hangs that far below its static place.
        bottom = max(bottom, mount - static_loads(vehicle)[0 if front else 1] / stiffness)
    name, colour = ("front", FRONT) if front else ("rear", REAR)
    rut = rut_ahead(snapshot, front=front)
    return AxlePlace(name, colour, arm, ground, bottom, mount, sinkage, bool(airborne), readings, rut)


def rut_ahead(snapshot: Snapshot, *, front: bool) -> float:
    """Depth [m] of the rut that an axle's wheels run into, of the share of their width that is on it."""
    structure = snapshot.plant.structure
    if front or structure is None or structure.ruts < 0.5:
        return 0.0
    rows = snapshot.contact[len(snapshot.contact) // 2 :]
    return float(np.mean(rows[:, at.RUT_SHARE] * rows[:, at.RUT_DEPTH]))


class SideView:
    """The vehicle from its right side, at true scale, and both wheels in the soil enlarged."""

    _ENLARGED = 146  # height of the pictures of the wheels
    _CAPTION = 40  # of it for words

    def __init__(self, canvas: Canvas) -> None:
        self.canvas = canvas
        self._rear = RearView(canvas)
        self._turned = np.zeros(2)  # how far the front and rear wheels have turned [rad]
        self._time = 0.0

    def restart(self) -> None:
        """A new episode."""
        self._turned[:] = self._time = 0.0

    def draw(self, snapshot: Snapshot) -> None:
        """The whole panel."""
        canvas, (left, top, width, height) = self.canvas, SIDE
        self._roll(snapshot)
        axles = axle_place(snapshot, front=True), axle_place(snapshot, front=False)
        canvas.box(SIDE, PANEL, MUTED)
        canvas.text((left + 8, top + 13), "Side view", size=20)
        self._write_posture(snapshot, axles)
        whole = Box(left + 1, top + 24, width - 2, height - self._ENLARGED - 34)
        if len(snapshot.state) > at.STATE_SIZE:
            self._rear.draw(snapshot, whole._replace(left=left + width - 1 - REAR_WIDTH, width=REAR_WIDTH))
            whole = whole._replace(width=whole.width - REAR_WIDTH - 4)
        self._draw_whole(snapshot, axles, whole)
        half = (width - 24) // 2
        for i, axle in enumerate(axles):
            x, y = left + 8 + (1 - i) * (half + 8), top + height - self._ENLARGED - 8
            box = Box(x, y, half, self._ENLARGED)
            self._draw_wheel(snapshot, axle, float(self._turned[i]), box)

    def _roll(self, snapshot: Snapshot) -> None:
        """Turn the wheels by the rim speed since the last picture."""
        rims = snapshot.readings[[at.R_OMEGA, at.AXLE + at.R_OMEGA]]
        self._turned += max(snapshot.time - self._time, 0.0) * rims / snapshot.plant.vehicle.r
        self._turned %= 2.0 * math.pi
        self._time = snapshot.time

    def _write_posture(self, snapshot: Snapshot, axles: tuple[AxlePlace, AxlePlace]) -> None:
        left, top, width, _ = SIDE
        place = (left + width - 8, top + 13)
        if snapshot.plant.half_car < 0.5:
            text = "bicycle model: the body does not move"
            self.canvas.text(place, text, colour=MUTED, anchor="midright")
            return
        pitch = number(math.degrees(snapshot.state[at.PITCH]), 1, "\u00b0", sign=True)
        front, rear = (number(1e3 * (axle.bottom - axle.mount), 0, " mm", sign=True) for axle in axles)
        x = self.canvas.text((left + 92, top + 13), f"pitch {pitch}") + 14
        x = self.canvas.text((x, top + 13), "compression") + 6
        self.canvas.words((x, top + 13), [(f"front {front}", FRONT), (f"rear {rear}", REAR)])

    def _draw_whole(self, snapshot: Snapshot, axles: tuple[AxlePlace, AxlePlace], box: Box) -> None:
        vehicle = snapshot.plant.vehicle
        wheelbase = vehicle.l_f + vehicle.l_r
        scale = min(box.width / (1.9 * wheelbase), box.height / (5.6 * vehicle.r))
        middle = 0.5 * (vehicle.l_f - vehicle.l_r)
        datum = min(axle.bottom for axle in axles)
        origin = np.array([box.left + 0.5 * box.width, box.top + box.height - 0.6 * vehicle.r * scale])

        def put(places: np.ndarray) -> np.ndarray:
            return np.asarray(origin + scale * (np.asarray(places) - [middle, datum]) * [1.0, -1.0])

        reach = np.linspace(-0.5, 0.5, 121) * box.width / scale + middle
        yaw = float(snapshot.state[at.YAW])
        X, Y = (snapshot.state[i] + reach * f(yaw) for i, f in ((at.X, math.cos), (at.Y, math.sin)))
        profile = put(np.column_stack((reach, heights(snapshot.course.ground, X, Y))))
        base = box.top + box.height
        with self.canvas.clipped(box):
            soil = np.concatenate((profile, [[profile[-1, 0], base], [profile[0, 0], base]]))
            self.canvas.shape(soil, SOIL)
            self._draw_body(snapshot, axles, put, scale)
            self.canvas.stroke(profile, EDGE, 1.0)
            self._draw_scale(box, scale)

    def _draw_body(
        self,
        snapshot: Snapshot,
        axles: tuple[AxlePlace, AxlePlace],
        put: Callable[[np.ndarray], np.ndarray],
        scale: float,
    ) -> None:
        vehicle = snapshot.plant.vehicle
        r = vehicle.r
        # The line through both mounts is the body's: it carries pitch, slope and heave at once.
        (front, rear), wheelbase = axles, vehicle.l_f + vehicle.l_r
        tilt = math.atan2(front.mount - rear.mount, wheelbase)
        start = np.array([-vehicle.l_r, rear.mount + r])

        def body(shape: list[list[float]]) -> np.ndarray:
            return put(start + turned(np.array(shape), tilt))

        L, over = wheelbase, 1.35 * r
        hull = [
            [-over, 1.25 * r], [-0.95 * r, 1.25 * r], [0.95 * r, 0.25 * r], [L - 0.95 * r, 0.25 * r],
            [L + 0.8 * r, 1.25 * r], [L + over, 1.25 * r], [L + over, 1.55 * r], [L - 0.9 * r, 2.15 * r],
            [-over, 2.15 * r],
        ]  # fmt: skip
        for cage in (
            [[-0.6 * r, 2.1 * r], [-0.2 * r, 3.1 * r], [0.62 * L, 3.1 * r], [L - 0.9 * r, 2.1 * r]],
            [[0.35 * L, 2.1 * r], [0.35 * L, 3.1 * r]],
        ):
            self.canvas.stroke(body(cage), BODY, 3.0)
        self.canvas.shape(body(hull), BODY, INK)
        for i, axle in enumerate(axles):
            hub = put(np.array([axle.arm, axle.bottom + r]))
            self._draw_disc(hub, r * scale, float(self._turned[i]), axle.colour)
            self._draw_spring(hub, body([[L if i == 0 else 0.0, 1.75 * r]])[0])

    def _draw_spring(self, hub: np.ndarray, mount: np.ndarray) -> None:
        """A zigzag whose length is the true distance of wheel and body."""
        along = mount - hub
        across = np.array([-along[1], along[0]]) / max(float(np.hypot(*along)), 1e-9)
        share = np.linspace(0.0, 1.0, 10)
        swing = np.array([0.0, 0.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 0.0, 0.0])
        self.canvas.stroke(hub + share[:, None] * along + 5.0 * swing[:, None] * across, PANEL, 2.0)
        for end in (hub, mount):
            self.canvas.disc(end, 3.0, PANEL)

    def _draw_disc(self, hub: np.ndarray, radius: float, roll: float, colour: Colour) -> None:
        """A wheel with spokes that turn to the right as it rolls forward."""
        self.canvas.disc(hub, radius, TYRE)
        self.canvas.disc(hub, 0.62 * radius, colour)
        for spoke in range(5):
            angle = roll + 0.4 * math.pi * spoke
            end = hub + 0.62 * radius * np.array([math.cos(angle), math.sin(angle)])
            self.canvas.stroke(np.array([hub, end]), TYRE, max(0.05 * radius, 2.0))

    def _draw_scale(self, box: Box, scale: float) -> None:
        length = round_number(60.0 / scale)
        x, y = box.left + 10, box.top + 14
        self.canvas.stroke(np.array([[x, y], [x + length * scale, y]]), INK, 3.0)
        self.canvas.text((x + length * scale + 7, y - 1), f"{length:g} m")

    def _draw_wheel(self, snapshot: Snapshot, axle: AxlePlace, roll: float, box: Box) -> None:
        """The lower part of a wheel, the soil ahead of it and the rut behind it, at one scale."""
        canvas, r = self.canvas, snapshot.plant.vehicle.r
        self._write_wheel(axle, box)
        left, top, width, height = box.left, box.top + self._CAPTION, box.width, box.height - self._CAPTION
        scale = width / (2.3 * r)
        # The surface stays where it is unless the wheel would leave the picture below.
        surface = min(top + 0.58 * height, top + height - 12.0 - axle.sinkage * scale)
        origin = np.array([left + 0.42 * width, surface])

        def put(places: np.ndarray) -> np.ndarray:
            return np.asarray(origin + scale * places * [1.0, -1.0])

        with canvas.clipped((left, top, width, height)):
            canvas.box((left, top, width, height), (240, 243, 246))
            line = self._surface(snapshot, axle)
            base = (top + height + 4 - surface) / -scale
            canvas.shape(put(np.concatenate((line, [[line[-1, 0], base], [line[0, 0], base]]))), SOIL)
            canvas.stroke(put(line), EDGE, 2.0)
            hub = put(np.array([0.0, axle.bottom - axle.ground + r]))
            self._draw_disc(hub, r * scale, roll, axle.colour)
            self._draw_depth(axle, origin, scale, left + width - 40.0)
        canvas.pygame.draw.rect(canvas.surface, axle.colour, box, 2)

    def _surface(self, snapshot: Snapshot, axle: AxlePlace) -> np.ndarray:
        """(N, 2) line of the soil around a wheel [m], from its lowest undeformed point: rut, arc, ahead.

        The rut is as deep as the wheel where it leaves the soil, at the model's exit angle.
        """
        plant, yaw = snapshot.plant, float(snapshot.state[at.YAW])
        reach = 1.5 * plant.vehicle.r
        x = np.linspace(-reach, reach, 61)
        way = 1.0 if axle.readings[at.R_OMEGA] >= 0.0 else -1.0
        place = axle.readings[[at.WHEEL_X, at.WHEEL_Y]]
        X, Y = place[0] + x * math.cos(yaw), place[1] + x * math.sin(yaw)
        line = heights(snapshot.course.ground, X, Y) - axle.ground
        if axle.sinkage > 0.0:
            r = plant.vehicle.r
            ahead = way * x
            line = np.where(ahead > 0.0, line - axle.rut, line)
            theta_f = entry_angle(max(axle.sinkage - axle.rut, 0.0), r)
            # From a point's own sinkage the soil springs back by less than could be drawn.
            elastic = plant.structure is not None and plant.structure.own_sinkage > 0.5
            share = 0.0 if elastic else wong_reece_angles(plant.soil, float(axle.readings[at.SLIP])).r
            theta_r = share * theta_f
            rut = axle.sinkage - r * (1.0 - math.cos(theta_r))
            inside = np.clip(ahead, r * math.sin(theta_r), r * math.sin(theta_f))
            arc = r - np.sqrt(r * r - inside * inside) - axle.sinkage
            behind = ahead < r * math.sin(theta_r)
            line = np.where(behind, line - rut, np.where(ahead <= r * math.sin(theta_f), arc, line))
        return np.column_stack((x, line))

    def _draw_depth(self, axle: AxlePlace, origin: np.ndarray, scale: float, x: float) -> None:
        """The sinkage as a dimension beside the wheel, from its lowest point to the level of the ground."""
        if axle.sinkage <= 0.0:
            return
        top, bottom = float(origin[1]), float(origin[1] + axle.sinkage * scale)
        self.canvas.stroke(np.array([[x - 8.0, top], [x + 8.0, top]]), INK, 2.0)
        self.canvas.stroke(np.array([[origin[0], bottom], [x + 8.0, bottom]]), INK, 1.0)
        self.canvas.stroke(np.array([[x, top], [x, bottom]]), INK, 2.0)

    def _write_wheel(self, axle: AxlePlace, box: Box) -> None:
        readings, canvas = axle.readings, self.canvas
        right, y = box.left + box.width - 8, box.top + 12
        sinkage = "no contact" if axle.airborne else f"sinkage {number(1e3 * axle.sinkage, 0)} mm"
        canvas.text((box.left + 8, y), axle.name, size=20, colour=axle.colour)
        canvas.text((right, y), sinkage, size=20, anchor="midright")
        load = float(readings[at.N])
        text = number(1e-3 * load, 1, " kN") if load >= 1e3 else number(load, 0, " N")
        canvas.text((box.left + 52, y), text, colour=MUTED)
        canvas.text((box.left + 8, y + 17), f"slip {number(readings[at.SLIP], 2, sign=True)}")
        angle = math.degrees(math.atan2(readings[at.V_C], max(abs(readings[at.V_L]), 1e-3)))
        text = f"slip angle {number(angle, 1, sign=True)}\u00b0"
        canvas.text((right, y + 17), text, anchor="midright")
