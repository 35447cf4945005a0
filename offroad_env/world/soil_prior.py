"""What soils there are: the population that the measured soils of the catalogue are drawn from.

Some twenty published soils, five numbers each: log p(5 cm), n, log c, phi, log K. The first four are taken as
normal with unknown mean and covariance; a further soil then follows a multivariate t. The six correlations of
twenty soils are uncertain, so they are shrunk towards none (target: diagonal with the sample's variances;
weight by J. Schaefer & K. Strimmer, Stat. Appl. Genet. Mol. Biol. 4, 2005, after O. Ledoit & M. Wolf, 2004).
K is printed for three soils only; its distribution is a stated prior without correlation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics.records import Soil
from offroad_env.physics.soil_field import REFERENCE_SINKAGE
from offroad_env.world.natural_soil import REFERENCE_WIDTH, reference_pressure
from offroad_env.world.soils import SOILS, make_soil

__all__ = [
    "ANGLE_SLOPE",
    "EXIT_SHARE",
    "LARGEST_PRESSURE_SHARE",
    "MEASURED_SOILS",
    "PRIOR_NAMES",
    "LeaveOneOut",
    "SoilPrior",
    "leave_one_out",
    "soil_numbers",
]

#: What a row of numbers holds.
PRIOR_NAMES = ("log p(5 cm)", "n", "log c", "phi", "log K")
_K = 4

#: Deformable soils of the catalogue but snow, which is another material.
MEASURED_SOILS = tuple(name for name in SOILS if SOILS[name].rigid < 0.5 and not name.startswith("snow"))

#: Soils whose source prints K with the other numbers; in all others it is a class value of the catalogue.
_K_PRINTED = ("lete_sand", "lunar_regolith", "lunar_simulant")
#: Ends of the range of K in Wong, Theory of Ground Vehicles, section 2.4: firm clay, loose sand [m]. They
#: count as one value each beside the printed ones.
_K_CLASSES = (0.006, 0.025)
#: c tuned to wheel tests, phi an angle of repose: the remark of the entry has it.
_STRENGTH_TUNED = ("cmu_sand",)

#: Contact angles, a stated prior: theta_m/theta_f = a_0 + 0.32 s with a_0 between loose and compact sand
#: (Wong & Reece, J. Terramechanics 4, 1967); theta_r/theta_f between no rebound and twice the catalogue's.
LARGEST_PRESSURE_SHARE, ANGLE_SLOPE, EXIT_SHARE = (0.18, 0.43), 0.32, (-0.2, 0.0)
#: No published soil has a larger phi [rad]: 52 degrees.
_PHI_HIGHEST = 0.9
_TRIES = 1000


def soil_numbers(name: str) -> np.ndarray:
    """(5,) numbers of a soil of the catalogue as `PRIOR_NAMES` has them; NaN for what was not measured."""
    soil = SOILS[name]
    numbers = np.array(
        [math.log(reference_pressure(soil)), soil.n, math.log(soil.c), soil.phi, math.log(soil.k_x)]
    )
    if name in _STRENGTH_TUNED:
        numbers[2:4] = math.nan
    if name not in _K_PRINTED:
        numbers[_K] = math.nan
    return numbers


@dataclass(frozen=True, kw_only=True)
class SoilPrior:
    """Distribution of whole soils; made by `SoilPrior.fitted`."""

    soils: tuple[str, ...]  #: of the catalogue, from which it was learnt
    mean: np.ndarray  #: (5,) as `PRIOR_NAMES`, pressures in [Pa] at `REFERENCE_WIDTH`, K in [m]
    scale: np.ndarray  #: (5, 5) of a further soil: t for the first four, normal for log K
    degrees_of_freedom: float  #: of that t
    shrinkage: float  #: weight of the target, 0 (sample correlations) ... 1 (none)
    missing: int  #: how many of the numbers of these soils were not measured, K left out
    shares: tuple[float, ...]  #: of k_c / b in the modulus k_c / b + k_phi of these soils

    @classmethod
    def fitted(cls, soils: Sequence[str] = MEASURED_SOILS) -> SoilPrior:
        """The population of these soils.

        Parameters
        ----------
        soils
            Names in `SOILS`, six or more, deformable.

        Raises
        ------
        InvalidParameter
            For fewer soils, or hard ground.
        """
        hard = [name for name in soils if SOILS[name].rigid > 0.5]
        if len(soils) < 6 or hard:
            wrong = f"hard ground: {', '.join(hard)}" if hard else f"{len(soils)} soils"
            raise InvalidParameter(f"soils must name 6 or more deformable soils, got {wrong}")
        rows = np.array([soil_numbers(name) for name in soils])
        mean, covariance, shrinkage = _estimate(rows[:, :_K])
        K = np.concatenate([rows[np.isfinite(rows[:, _K]), _K], np.log(_K_CLASSES)])
        scale = np.zeros((5, 5))
        # A further soil differs from a mean that is itself uncertain: 1 + 1/N.
        scale[:_K, :_K] = (1.0 + 1.0 / len(rows)) * covariance
        scale[_K, _K] = (1.0 + 1.0 / len(K)) * K.var(ddof=1)
        return cls(
            soils=tuple(soils),
            mean=np.append(mean, K.mean()),
            scale=scale,
            degrees_of_freedom=len(rows) - 1.0,
            shrinkage=shrinkage,
            missing=int(np.isnan(rows[:, :_K]).sum()),
            shares=tuple(_cohesive_share(SOILS[name]) for name in soils),
        )

    @property
    def correlation(self) -> np.ndarray:
        """(5, 5) correlation of the numbers."""
        sd = np.sqrt(np.diag(self.scale))
        result: np.ndarray = self.scale / np.outer(sd, sd)
        return result

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """(5,) numbers of a soil, without regard to what `make_soil` accepts."""
        widened = math.sqrt(self.degrees_of_freedom / rng.chisquare(self.degrees_of_freedom))
        free = rng.standard_normal(5) * np.array([widened] * _K + [1.0])
        drawn: np.ndarray = self.mean + np.linalg.cholesky(self.scale) @ free
        return drawn

    def sample(self, rng: np.random.Generator) -> Soil:
        """A whole soil.

        Numbers outside of what a soil can have (n from 0.05 to 2.5, phi from 0 to 52 degrees, and what
        `make_soil` refuses) are drawn again. The share of k_c in the modulus is that of one of the soils.

        Raises
        ------
        SolverFailure
            When 1000 draws give no soil.
        """
        for _ in range(_TRIES):
            numbers = self.draw(rng)
            share = self.shares[rng.integers(len(self.shares))]
            a_0, b_0 = rng.uniform(*LARGEST_PRESSURE_SHARE), rng.uniform(*EXIT_SHARE)
            try:
                return _whole_soil(numbers, share, float(a_0), float(b_0))
            except InvalidParameter:
                continue
        raise SolverFailure(f"{_TRIES} draws from the prior of {len(self.soils)} soils gave no soil")


def _whole_soil(numbers: np.ndarray, share: float, a_0: float, b_0: float) -> Soil:
    """A validated soil of these numbers, with ``share`` of its modulus from k_c."""
    log_pressure, n, log_c, phi = numbers[:_K].tolist()
    if not 0.0 < phi <= _PHI_HIGHEST:
        raise InvalidParameter(f"phi must be in (0, {_PHI_HIGHEST:g}] rad, got {phi:g}")
    modulus = math.exp(log_pressure) / REFERENCE_SINKAGE**n
    k_c = share * modulus * REFERENCE_WIDTH
    return make_soil(
        k_c=k_c if k_c >= 50.0 else 0.0,
        k_phi=(1.0 - share) * modulus,
        n=n,
        c=math.exp(log_c),
        phi=phi,
        k_x=math.exp(numbers[_K]),
        a_0=a_0,
        a_1=ANGLE_SLOPE,
        b_0=b_0,
        b_1=0.0,
    )


def _cohesive_share(soil: Soil) -> float:
    """Share of k_c / b in the modulus at `REFERENCE_WIDTH`."""
    return soil.k_c / (soil.k_c + REFERENCE_WIDTH * soil.k_phi)


def _shrinkage(rows: np.ndarray) -> float:
    """Weight of "no correlation": summed variances of the sample correlations over their summed squares.

    Schaefer & Strimmer (2005), target D, correlations of standardised ``rows`` (N, d) without gaps.
    """
    z = (rows - rows.mean(axis=0)) / rows.std(axis=0, ddof=1)
    N, d = z.shape
    products = z[:, :, None] * z[:, None, :]
    variances = N / (N - 1.0) ** 3 * ((products - products.mean(axis=0)) ** 2).sum(axis=0)
    apart = ~np.eye(d, dtype=bool)
    squares = (products.sum(axis=0) / (N - 1.0))[apart] ** 2
    return float(min(1.0, variances[apart].sum() / squares.sum()))


def _estimate(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """(mean (d,), covariance (d, d), shrinkage) of ``rows`` (N, d) with gaps, missing at random.

    Expectation maximisation (Dempster, Laird & Rubin 1977) with the correlations shrunk in every step; the
    weight is that of the rows without gaps.
    """
    complete = rows[np.isfinite(rows).all(axis=1)]
    weight, N = _shrinkage(complete), len(rows)
    mean, covariance = complete.mean(axis=0), np.diag(complete.var(axis=0, ddof=1))
    for _ in range(200):
        filled, spread = np.empty_like(rows), np.zeros_like(covariance)
        for i, row in enumerate(rows):
            filled[i], own = _completed(row, mean, covariance)
            spread += own
        mean = filled.mean(axis=0)
        moved = filled - mean
        sample = (moved.T @ moved + spread) / (N - 1.0)
        shrunk = (1.0 - weight) * sample + weight * np.diag(np.diag(sample))
        if np.allclose(shrunk, covariance, rtol=1e-12, atol=0.0):
            break
        covariance = shrunk
    return mean, covariance, weight


def _completed(row: np.ndarray, mean: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A row with its gaps filled by what is expected there, and the covariance (d, d) of that."""
    gap, spread = np.isnan(row), np.zeros_like(covariance)
    if not gap.any():
        return row, spread
    known = ~gap
    gain = np.linalg.solve(covariance[np.ix_(known, known)], covariance[np.ix_(known, gap)]).T
    filled = row.copy()
    filled[gap] = mean[gap] + gain @ (row[known] - mean[known])
    spread[np.ix_(gap, gap)] = covariance[np.ix_(gap, gap)] - gain @ covariance[np.ix_(known, gap)]
    return filled, spread


@dataclass(frozen=True, kw_only=True)
class LeaveOneOut:
    """Where each soil lies in the prior that was learnt without it; K left out, which is no learnt one."""

    soils: tuple[str, ...]
    probability: np.ndarray  #: (N, 4) share of the prior below the soil's number; NaN: not measured
    joint: np.ndarray  #: (N,) share of the prior nearer to its middle than the soil, in its measured numbers

    def coverage(self, level: float) -> np.ndarray:
        """(5,) share of the soils inside the prior's central ``level``: number by number, then jointly."""
        single = np.abs(2.0 * self.probability - 1.0)
        inside = [float(np.mean(column[np.isfinite(column)] < level)) for column in single.T]
        return np.array([*inside, float(np.mean(self.joint < level))])


def leave_one_out(soils: Sequence[str] = MEASURED_SOILS, *, sites: bool = False) -> LeaveOneOut:
    """Learn the prior without each soil in turn and look where that soil lies in it.

    Parameters
    ----------
    soils
        Names in `SOILS`.
    sites
        Leave out the wet and the drier state of the same soil together: two states are no two soils.

    Raises
    ------
    InvalidParameter
        As `SoilPrior.fitted`.
    """
    from scipy import stats  # loads in half a second; sampling does without

    probability, joint = np.full((len(soils), _K), math.nan), np.empty(len(soils))
    for i, name in enumerate(soils):
        site = name.removesuffix("_wet")
        others = [o for o in soils if o != name and not (sites and o.removesuffix("_wet") == site)]
        prior = SoilPrior.fitted(others)
        row = soil_numbers(name)[:_K]
        known = np.isfinite(row)
        moved = (row - prior.mean[:_K])[known]
        scale, dof = prior.scale[:_K, :_K][np.ix_(known, known)], prior.degrees_of_freedom
        probability[i, known] = stats.t.cdf(moved / np.sqrt(np.diag(scale)), dof)
        distance = float(moved @ np.linalg.solve(scale, moved)) / known.sum()
        joint[i] = stats.f.cdf(distance, known.sum(), dof)
    return LeaveOneOut(soils=tuple(soils), probability=probability, joint=joint)
