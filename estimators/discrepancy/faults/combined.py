"""Several faults in one drive."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from offroad_env.simulation.drive import Command, Faults
from offroad_env.simulation.simulator import Plant

__all__ = ["combined"]


def combined(parts: Sequence[Faults]) -> Faults:
    """All these faults in one drive: each acts on the result of those before it."""
    if len(parts) == 1:
        return parts[0]
    # The commands that every part has passed on, one a tick: the past of the next part.
    sent: list[list[Command]] = [[] for _ in parts]

    def plant(plant: Plant) -> Plant:
        for part in parts:
            plant = part.plant(plant)
        return plant

    def command(past: list[Command]) -> Command:
        for part, own in zip(parts, sent, strict=True):
            own.append(part.command(past))
            past = own
        return past[-1]

    def step(x: np.ndarray, readings: np.ndarray, plant: Plant) -> Plant:
        for part in parts:
            plant = part.step(x, readings, plant) if part.step is not None else plant
        return plant

    def kick(x: np.ndarray, readings: np.ndarray, plant: Plant, span: float) -> None:
        for part in parts:
            if part.kick is not None:
                part.kick(x, readings, plant, span)

    def feel(x: np.ndarray, readings: np.ndarray, plant: Plant) -> None:
        for part in parts:
            if part.feel is not None:
                part.feel(x, readings, plant)

    def sample(sample: np.ndarray) -> None:
        for part in parts:
            part.sample(sample)

    kicks = any(part.kick is not None for part in parts)
    return Faults(
        plant=plant, command=command, step=step, kick=kick if kicks else None, feel=feel, sample=sample
    )
