"""Parameters of a fit: sizes of effects, nuisances, and the start of every window."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from offroad_env.effects import EFFECTS

__all__ = ["Candidate", "CandidateKey", "Point"]

#: Identity of a candidate: the effect, then its other parameters.
CandidateKey = tuple[str | tuple[str, float], ...]


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """An effect, at one place of the route if it has one, whose size is estimated."""

    effect: str
    place: Mapping[str, float] = field(default_factory=dict)

    @property
    def key(self) -> CandidateKey:
        """Identity of the candidate."""
        return (self.effect, *sorted(self.place.items()))

    def values(self, size: float) -> dict[str, float]:
        """Parameters of the effect at this size, held within its limits."""
        parameter = EFFECTS[self.effect].size
        return {parameter.name: min(max(size, parameter.low), parameter.high), **self.place}


@dataclass(frozen=True, kw_only=True)
class Point:
    """Values of all parameters of a fit: what one simulation of all runs depends on."""

    nuisances: np.ndarray  #: (N,)
    candidates: tuple[Candidate, ...] = ()  #: effects in the model
    sizes: np.ndarray  #: (E,) of these effects
    starts: tuple[np.ndarray, ...]  #: for every run (W, 15): states at the beginning of its windows
    warm: tuple[np.ndarray, ...]  #: for every run (W, 2, 3): warm starts of the contact solver
    centre: tuple[np.ndarray, ...]  #: for every run (W, 15): prior mean of the starts

    @property
    def shared(self) -> np.ndarray:
        """(N + E,) parameters that all windows share: nuisances, then sizes."""
        return np.concatenate([self.nuisances, self.sizes])
