"""The soil under a drive when n and phi are unknown and no structure is given.

Several structures are fitted to the same windows (`fit`) and weighted by how they predict windows that were
left out (`structure_choice`). The posterior is the mixture: where the drive does not decide between two
structures, the interval spans both.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.belief.fit import Fit, fit_unknowns, searched
from estimators.belief.structure_choice import structure_weights
from estimators.belief.unknowns import MODULUS, PHI, UNKNOWN_NAMES, C, K, N, Tolerances, Unknowns, unknowns_of
from estimators.belief.windows import LogWindows, cut
from estimators.logs.log import Log
from estimators.replay.structures import Case, plant_for
from offroad_env.errors import DataError
from offroad_env.physics.records import FloatArray

__all__ = ["ADEQUATE", "CANDIDATES", "DISCREPANCY", "Marginal", "SoilBelief", "StructureFit", "believe_log"]

#: Structures that compete where none is asked for.
CANDIDATES = ("full", "grid", "field")
#: Least weight after the search, on a third of the windows, with which a structure is fitted to all of them;
#: least weight with which it is also tried with four wheels.
_HOPELESS, _PROMISING = 1e-3, 0.05
#: Odds, before the drive, of the four wheels that the description states against a half-car: strong evidence
#: overrules them (H. Jeffreys, Theory of Probability, 1961, appendix B: 10 to 1).
_FOUR_WHEELS = 10.0
#: What even the best structure errs by in n [-] and phi [rad] for each scale of residual that it leaves
#: beyond the noise of the sensors, one standard deviation (docs/belief.md).
DISCREPANCY = (0.05, 0.08)
#: Root mean square residual beyond that noise up to which a window counts as predicted [scales of
#: `windows.SCALES`].
ADEQUATE = 1.0
#: Share of the windows that a valid model predicts.
_PREDICTED = 0.5
#: Share of a range next to an end that counts as this end.
_AT_END = 0.005
#: Width of the 95 % interval of n up to which an estimate is an answer [-].
_ANSWER = 0.3
_LEVEL = 0.95


@dataclass(frozen=True, kw_only=True)
class Marginal:
    """What is known of one quantity."""

    mean: float
    sd: float
    low: float  #: 2.5 %
    high: float  #: 97.5 %


@dataclass(frozen=True, kw_only=True)
class StructureFit:
    """One structure's part of the posterior."""

    case: Case
    weight: float
    fit: Fit

    @property
    def covariance(self) -> FloatArray:
        """(9, 9) covariance of the unknowns, with what the structure itself may be wrong by."""
        left = float(np.median(self.fit.unexplained))
        widened = self.fit.covariance.copy()
        for place, growth in zip((N, PHI), DISCREPANCY, strict=True):
            widened[place, place] += (growth * left) ** 2
        return widened


@dataclass(frozen=True, kw_only=True)
class SoilBelief:
    """Posterior of the soil under a drive."""

    log: str
    parts: tuple[StructureFit, ...]  #: by weight, the largest first
    windows: LogWindows
    unknowns: Unknowns
    left_out: tuple[str, ...]  #: structures far off already after the search

    @property
    def valid_share(self) -> float:
        """Share of the windows that the structures predict, each by its weight."""
        shares = [part.weight * float((part.fit.unexplained < ADEQUATE).mean()) for part in self.parts]
        return min(float(sum(shares)), 1.0)  # the weights add up to one but for rounding

    @property
    def at_ends(self) -> tuple[str, ...]:
        """Unknowns that the likeliest structure has at an end of their range: something else is wrong."""
        values = self.parts[0].fit.values
        low, high = self.unknowns.bounds
        near = _AT_END * (high - low)
        ended = (values < low + near) | (values > high - near)
        return tuple(name for name, one in zip(UNKNOWN_NAMES, ended, strict=True) if one)

    @property
    def valid(self) -> bool:
        """Whether some structure predicts most of the drive, with unknowns within their ranges."""
        return self.valid_share >= _PREDICTED and not self.at_ends

    @property
    def answered(self) -> bool:
        """Whether n is known to an interval of 0.3 at most, by a structure that predicts the drive."""
        n = self.marginal(N)
        return self.valid and n.high - n.low <= _ANSWER

    def marginal(self, place: int) -> Marginal:
        """What is known of the unknown in this column of `UNKNOWN_NAMES`."""
        means = np.array([part.fit.values[place] for part in self.parts])
        sds = np.sqrt([part.covariance[place, place] for part in self.parts])
        found = mixture([part.weight for part in self.parts], means, sds)
        low, high = (float(end[place]) for end in self.unknowns.bounds)
        mean = min(max(found.mean, low), high)
        low, high = min(max(found.low, low), mean), max(min(found.high, high), mean)
        return replace(found, mean=mean, low=low, high=high)

    def soil(self) -> dict[str, Marginal]:
        """n, phi and the stated parameters as they come out of the drive."""
        stated, (n, phi) = self.windows.log.config.soil, (self.marginal(N), self.marginal(PHI))
        return {
            "n": n,
            "phi": phi,
            "k_phi": _lognormal(stated.k_phi, self.marginal(MODULUS)),
            "c": _lognormal(stated.c, self.marginal(C)),
            "K": _lognormal(stated.k_x, self.marginal(K)),
        }


def _lognormal(stated: float, factor: Marginal) -> Marginal:
    """A stated number times the exponential of a normal variable."""
    mean = stated * math.exp(factor.mean)
    low, high = stated * math.exp(factor.low), stated * math.exp(factor.high)
    return Marginal(mean=mean, sd=mean * factor.sd, low=low, high=high)


def mixture(weights: Sequence[float], means: FloatArray, sds: FloatArray) -> Marginal:
    """Mean, standard deviation and central 95 % of a mixture of normal distributions."""
    from scipy import optimize, special

    shares = np.asarray(weights)
    mean = float(shares @ means)
    sd = math.sqrt(float(shares @ (sds**2 + (means - mean) ** 2)))

    def below(x: float) -> float:
        return float(shares @ special.ndtr((x - means) / sds))

    ends = float((means - 6.0 * sds).min()), float((means + 6.0 * sds).max())
    outside = 0.5 * (1.0 - _LEVEL)
    low = optimize.brentq(lambda x: below(x) - outside, *ends)
    high = optimize.brentq(lambda x: below(x) - 1.0 + outside, *ends)
    return Marginal(mean=mean, sd=sd, low=float(low), high=float(high))


def believe_log(
    log: Log,
    *,
    structures: Sequence[str] = CANDIDATES,
    tolerances: Tolerances | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> SoilBelief:
    """The soil under a drive.

    Parameters
    ----------
    log
        Of a vehicle on deformable soil, with steering and torques of the wheels. n and phi of its description
        are not read.
    structures
        That compete, as `world.structures.read_structure` knows them; and the one that the log states.
    tolerances
        Of what the description states.
    progress
        Called with the share that is done and what is being done.

    Raises
    ------
    DataError
        For a log that cannot be replayed, or soil that no structure lets carry the vehicle.
    """
    if log.config.soil.rigid > 0.5:
        raise DataError(f"{log.name}: stands on hard ground, which has no sinkage exponent to estimate")

    def tell(share: float, doing: str) -> None:
        if progress is not None:
            progress(share, doing)

    tell(0.0, "smoothing")
    windows, unknowns = cut(log), unknowns_of(tolerances)
    names = structures if log.config.structure in structures else (*structures, log.config.structure)
    found: dict[str, Fit] = {}
    for i, name in enumerate(names):
        tell(0.05 + 0.45 * i / len(names), f"searching with {name}")
        found[name] = searched(windows, plant_for(log, Case(name, "half_car")), unknowns)
    if all(np.isnan(fit.alone).all() for fit in found.values()):
        raise DataError(f"{log.name}: under no structure does the soil carry the vehicle")
    kept = _promising(found, _HOPELESS)
    fits: dict[Case, Fit] = {}
    for i, name in enumerate(kept):
        case = Case(name, "half_car")
        report = _within(tell, 0.5 + 0.2 * i / len(kept), 0.2 / len(kept), f"fitting {name}")
        fits[case] = fit_unknowns(windows, plant_for(log, case), unknowns, found[name].values, report=report)
    likely = _promising({case.structure: fit for case, fit in fits.items()}, _PROMISING)
    for i, name in enumerate(likely if _has_four_wheels(log) else ()):
        case, start = Case(name, "four_wheel"), fits[Case(name, "half_car")].values
        doing = f"fitting {name} with four wheels"
        report = _within(tell, 0.7 + 0.3 * i / len(likely), 0.3 / len(likely), doing)
        fits[case] = fit_unknowns(windows, plant_for(log, case), unknowns, start, report=report)
    left_out = tuple(name for name in names if name not in kept)
    return SoilBelief(
        log=log.name, parts=_weighed(fits), windows=windows, unknowns=unknowns, left_out=left_out
    )


def _weighed(fits: Mapping[Case, Fit]) -> tuple[StructureFit, ...]:
    """The structures with their weights, the largest first."""
    odds = [_FOUR_WHEELS if case.vehicle_model == "four_wheel" else 1.0 for case in fits]
    weights = structure_weights(list(fits.values()), odds)
    parts = [
        StructureFit(case=case, weight=float(weight), fit=fit)
        for (case, fit), weight in zip(fits.items(), weights, strict=True)
    ]
    return tuple(sorted(parts, key=lambda part: -part.weight))


def _within(
    tell: Callable[[float, str], None], begin: float, length: float, doing: str
) -> Callable[[float], None]:
    """Tells the share of a stage as one of the whole; the stage begins now."""
    tell(begin, doing)
    return lambda share: tell(begin + share * length, doing)


def _promising(fits: Mapping[str, Fit], least: float) -> list[str]:
    """Structures with this weight at least."""
    weights = structure_weights(list(fits.values()))
    return [name for name, weight in zip(fits, weights, strict=True) if weight >= least]


def _has_four_wheels(log: Log) -> bool:
    return log.vehicle.wheels_per_axle == 2 and log.vehicle.track > 0.0
