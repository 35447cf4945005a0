"""The truth of an episode with effects of an extended model: drives where the compiled period cannot.

The compiled period holds the base model alone, so that no effect can slow it down; here the same
step is taken call by call. It costs some ten times as much.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable

import numpy as np

from offroad_env.effects import Extension, Setup, apply
from offroad_env.effects.protocol import Inputs
from offroad_env.environment.episode_records import CONTROL_PERIOD, SAMPLES
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics.contact import NO_ROOT, SUNK
from offroad_env.physics.full_vehicle import WORK_ROWS, full_continue, full_derivative
from offroad_env.physics.imu import CHANNELS, GNSS, IMU, OFFSET, SCALE, WHEEL, ImuMount, sense
from offroad_env.physics.paper_vehicle import paper_advance
from offroad_env.physics.sensor_errors import sense_into
from offroad_env.simulation.drive import Command
from offroad_env.simulation.simulator import FULL_STEP, Plant

__all__ = ["ExtendedTruth", "InputChain"]

_ACCELEROMETERS = slice(0, 3)


class InputChain:
    """What becomes of commands (steering [rad], drive, brake) on their way to the vehicle, step by step."""

    def __init__(self, inputs: Inputs) -> None:
        self.inputs = inputs
        self._stamps: list[float] = []
        self._commands: list[Command] = []
        self._steer: float | None = None  # state of the lag [rad]

    def push(self, t: float, command: Command) -> None:
        """From ``t`` [s] on this is commanded."""
        self._stamps.append(t)
        self._commands.append(command)
        longest = self.inputs.delay + self.inputs.steer_delay
        while len(self._stamps) > 2 and self._stamps[1] < t - longest - 1.0:
            del self._stamps[0], self._commands[0]

    def _at(self, t: float) -> Command:
        i = bisect_right(self._stamps, t) - 1
        return self._commands[max(i, 0)]

    def acting(self, t: float, dt: float) -> Command:
        """What acts from ``t`` to ``t + dt`` [s]; called in the order of time."""
        inputs, middle = self.inputs, t + 0.5 * dt - self.inputs.delay
        steer = inputs.steer_gain * self._at(middle - inputs.steer_delay)[0] + inputs.steer_offset
        _, drive, brake = self._at(middle)
        if inputs.steer_lag > 0.0:
            before = steer if self._steer is None else self._steer
            share = dt / inputs.steer_lag
            self._steer = steer + (before - steer) * math.exp(-share)
            steer += (before - steer) * (1.0 - math.exp(-share)) / share
        return steer, inputs.drive_scale * drive, inputs.brake_scale * brake


class ExtendedTruth:
    """Effects on one episode: its plant, its inputs, its sensors.

    Parameters
    ----------
    extension
        The extended model.
    plant, mount
        The base model's truth.
    """

    def __init__(self, extension: Extension, plant: Plant, mount: ImuMount) -> None:
        if plant.four_wheel is not None:
            raise InvalidParameter(
                "an extended model is one of two axles: leave out vehicle_model='four_wheel'"
            )
        self.setup: Setup = apply(Setup(plant=plant, mount=mount), extension.effects)
        self.chain = InputChain(self.setup.inputs)
        self._full = extension.model == "full"
        self._work = np.empty((WORK_ROWS, at.READINGS_SIZE))
        errors = self.setup.errors
        self._displaced = errors.pose_delay > 0.0 or errors.antenna != 0.0
        self._past: list[np.ndarray] = []  # states, one a sample, as far back as a receiver is late
        self._fix = np.empty(CHANNELS)

    def imperfect(self, errors: np.ndarray) -> np.ndarray:
        """Errors (3, CHANNELS) of the sensors with those of the effects."""
        errors, extra = errors.copy(), self.setup.errors
        errors[OFFSET, IMU] += extra.offset
        errors[SCALE, _ACCELEROMETERS] += extra.accel_scale - 1.0
        errors[SCALE, WHEEL] += extra.wheel_scale - 1.0 + extra.wheel_split * np.array([1.0, -1.0])
        return errors

    def drive(
        self,
        e: np.void,
        action: np.ndarray,
        command: Callable[[], Command],
        noise: np.ndarray,
        sensing: np.ndarray | None,
    ) -> None:
        """What the compiled period does under DRIVE, for the record ``e`` of an episode.

        ``sensing`` (1,) is what its sensors remember, None where they remember nothing.
        """
        if sensing is not None and self._displaced:
            raise InvalidParameter(
                "pose_delay and antenna_x need sensors without a memory, such as sensors='paper'"
            )
        action = np.clip(action, -1.0, 1.0)
        e["change"] = float(np.sum((action - e["action"]) ** 2))
        e["action"] = action
        t, span = float(e["time"]), CONTROL_PERIOD / SAMPLES
        self.chain.push(t, command())
        going_on = self._goes_on(e)
        e["samples"], e["status"] = 0.0, 0.0
        for i in range(int(e["count"])):
            status = self._advance(e, self.chain.acting(t + i * span, span), fresh=i == 0 and not going_on)
            e["status"] = max(float(e["status"]), status)
            if e["status"] >= SUNK:
                break
            self._sense(e, noise, sensing, i)
        e["slope"] = self._work[0][: at.STATE_SIZE]
        self._keep_sound(e)

    def _goes_on(self, e: np.void) -> bool:
        """Whether the last period has ended with this state, and its slope with it; then it is at hand."""
        if e["steps"] <= 0 or e["status"] >= SUNK or not np.array_equal(e["state"], e["sound_state"]):
            return False
        self._work[0][: at.STATE_SIZE] = e["slope"]
        return True

    def _advance(self, e: np.void, acting: Command, *, fresh: bool) -> float:
        """To the next sample; returns the worst contact status."""
        x, warm, readings, steps = e["state"], e["warm"], e["readings"], int(e["steps"])
        plant = self.setup.plant
        if not self._full:
            return float(paper_advance(x, warm, acting, plant, FULL_STEP, steps, readings))
        if fresh:  # otherwise it goes on from the slope of the sample before
            full_derivative(x, acting, plant, warm, self._work[0], readings)
        return float(full_continue(x, warm, acting, plant, (FULL_STEP, steps), self._work, readings))

    def _sense(self, e: np.void, noise: np.ndarray, sensing: np.ndarray | None, i: int) -> None:
        wheel_due = e["wheel_every"] > 0 and e["tick"] % max(e["wheel_every"], 1) == 0
        gnss_due = e["gnss_every"] > 0 and e["tick"] % max(e["gnss_every"], 1) == 0
        due = bool(wheel_due), bool(gnss_due)
        mount, row, sample = self.setup.mount, noise[e["noise_row"]], e["samples"][i]
        if sensing is not None:
            sense_into(e["state"], e["readings"], mount, e["errors"], row, due, sensing, sample)
        else:
            sense(e["state"], e["readings"], mount, e["errors"], row, due, sample)
        if self._displaced:
            sense(self._received(e["state"]), e["readings"], mount, e["errors"], row, due, self._fix)
            sample[GNSS] = self._fix[GNSS]
        e["tick"] += 1
        e["noise_row"] += 1
        if wheel_due and not math.isnan(sample[WHEEL][0]):
            e["rims"] = e["samples"][i][WHEEL]

    def _received(self, x: np.ndarray) -> np.ndarray:
        """The state that a receiver measures: as old as its fixes are, and where its antenna sits."""
        errors = self.setup.errors
        late = round(max(errors.pose_delay, 0.0) * SAMPLES / CONTROL_PERIOD)
        self._past = [*self._past[-late:], x.copy()] if late else [x.copy()]
        seen = self._past[0].copy()
        seen[at.X] += errors.antenna * math.cos(seen[at.YAW])
        seen[at.Y] += errors.antenna * math.sin(seen[at.YAW])
        seen[at.V_Y] += errors.antenna * seen[at.YAW_RATE]
        return seen

    @staticmethod
    def _keep_sound(e: np.void) -> None:
        if e["status"] >= NO_ROOT:
            e["state"], e["readings"] = e["sound_state"], e["sound_readings"]
        else:
            e["sound_state"], e["sound_readings"] = e["state"], e["readings"]
