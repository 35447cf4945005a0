"""Natural soil: correlated random fields of all its parameters, and patches of other soils.

Soil varies over metres. Its variograms are those of Matern's correlation (B. Minasny & A. B. McBratney, The
Matern function as a general model for soil variograms, Geoderma 128, 2005); here with smoothness 3/2, whose
realisations have slopes. The field is a sum of plane waves with random directions and phases.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import astuple, dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from offroad_env.errors import InvalidParameter
from offroad_env.physics.pressure_sinkage import bekker_modulus, bekker_pressure
from offroad_env.physics.records import Soil, SoilField
from offroad_env.physics.soil_field import REFERENCE_SINKAGE, local_soils
from offroad_env.world.catalogue import Quantity
from offroad_env.world.yaml_text import shown

__all__ = [
    "REFERENCE_WIDTH",
    "SoilMaps",
    "SoilSpread",
    "matern_correlation",
    "natural_soil",
    "reference_pressure",
    "soil_maps",
    "spread_of",
    "spread_within",
    "wave_vectors",
]

#: Width of the plate whose pressure at 5 cm stands for a soil: a tyre of a light vehicle [m].
REFERENCE_WIDTH = 0.2

_CORRELATION_LENGTH = Quantity("in [0.2, 1000] m", 0.2, 1e3, mistakes=((1000.0000001, 1e6, "mm given as m"),))
_SPREAD = Quantity("in [0, 0.5]", 0.0, 0.5, mistakes=((0.5000001, 100.0, "per cent"),))
_PLACE = Quantity("in [-1e4, 1e4] m", -1e4, 1e4)
_LENGTH = Quantity("in (0, 1e4] m", 0.0, 1e4, low_open=True)

#: The exponent stays this many standard deviations inside its range.
_MARGIN = 3.0
_N_RANGE = (0.05, 2.5)
#: Root x of (1 + x) exp(-x) = 1/e: Matern's correlation 3/2 falls to 1/e over the correlation length.
_MATERN_REACH = 2.1461932206205825
_GOLDEN = 0.6180339887498949


@dataclass(frozen=True, kw_only=True)
class SoilSpread:
    """Standard deviation of a random field over the plane, within one soil.

    Defaults: n 0.03, the pressure at 5 cm 8 %, cohesion and tan(phi) 5 %. Of the shear modulus no survey
    over metres is known to the authors: 0.
    """

    pressure: float = 0.08  #: of log p(5 cm)
    n: float = 0.03  #: of the exponent [-]
    c: float = 0.05  #: of log c
    tan_phi: float = 0.05  #: of log tan(phi)
    K: float = 0.0  #: of the logarithm of both shear moduli


def spread_within(n: float) -> SoilSpread:
    """The usual spread about an exponent; near an end of its range n varies less, so that it stays within."""
    room = max(min(n - _N_RANGE[0], _N_RANGE[1] - n), 0.0) / _MARGIN
    return SoilSpread(n=min(SoilSpread.n, room))


def spread_of(given: Any) -> bool | SoilSpread:
    """A spread from a mapping of its fields; True is the usual one, False none.

    Raises
    ------
    InvalidParameter
        For anything else.
    """
    if isinstance(given, bool | SoilSpread):
        return given
    names = [item.name for item in fields(SoilSpread)]
    if not isinstance(given, Mapping) or not set(given) <= set(names):
        raise InvalidParameter(f"natural_soil must be True, or hold {', '.join(names)}, got {shown(given)}")
    return SoilSpread(**given)


class SoilMaps(NamedTuple):
    """Soil over places; every array has the broadcast shape of the places."""

    pressure: np.ndarray  #: Bekker pressure at 5 cm of a plate of `REFERENCE_WIDTH` [Pa]
    n: np.ndarray  #: exponent [-]
    c: np.ndarray  #: cohesion [Pa]
    phi: np.ndarray  #: angle of internal shearing resistance [rad]
    K: np.ndarray  #: longitudinal shear modulus [m]


def reference_pressure(soil: Soil, width: float = REFERENCE_WIDTH) -> float:
    """Bekker pressure [Pa] of a plate of ``width`` [m] at 5 cm: what n is compared at."""
    return bekker_pressure(bekker_modulus(soil, width), soil.n, REFERENCE_SINKAGE)


def matern_correlation(distance: ArrayLike, correlation_length: float) -> np.ndarray:
    """Matern's correlation of smoothness 3/2 over a distance [m]; 1/e at the correlation length [m]."""
    x = _MATERN_REACH * np.abs(np.asarray(distance, dtype=np.float64)) / correlation_length
    result: np.ndarray = (1.0 + x) * np.exp(-x)
    return result


def natural_soil(
    base: Soil,
    rng: np.random.Generator | int,
    *,
    correlation_length: float = 5.0,
    spread: SoilSpread | None = None,
    correlation: ArrayLike | None = None,
    waves: int = 64,
    patches: Iterable[tuple[float, float, float, Soil]] = (),
    edge: float = 0.3,
) -> SoilField:
    """A random field around a soil, with patches of other soils under it.

    Parameters
    ----------
    base
        The soil that the field is for, a deformable one: the median of c, tan(phi), p(5 cm) and K, the mean
        of n.
    rng
        Source of directions and phases, or a seed; always ``5 waves + 1`` draws.
    correlation_length
        Distance over which the correlation falls to 1/e [m]; soils have 1 ... 20 m.
    spread
        Standard deviations; default `SoilSpread()`. Exact over the whole plane; over an area of a few
        correlation lengths less is seen.
    correlation
        (5, 5) correlation of (log p(5 cm), n, log c, log tan(phi), log K) at one place; default: none.
    waves
        Number of plane waves, 8 ... 4096.
    patches
        Rows (x [m], y [m], radius [m], soil): discs of another whole soil; later ones lie over earlier ones.
        The random field moves them as it moves the base.
    edge
        Width over which one soil passes to the other, centred on the radius [m].

    Raises
    ------
    InvalidParameter
        For hard ground, a spread that takes n out of its range, a correlation that is none, a patch whose
        edge is wider than itself, or any value out of range.
    """
    if base.rigid > 0.5:
        raise InvalidParameter("natural soil needs a deformable base, got hard ground")
    length = _CORRELATION_LENGTH.check("correlation_length", correlation_length)
    deviations = _checked_spread(SoilSpread() if spread is None else spread)
    edge = _LENGTH.check("edge", edge)
    rows = [_patch_row(i, patch, edge) for i, patch in enumerate(patches)]
    for n in (base.n, *(row[5] for row in rows)):
        _check_exponent(n, deviations[1])
    factor = _square_root(correlation) * deviations[:, None]
    generator = np.random.default_rng(rng) if isinstance(rng, int) else rng
    return SoilField(
        edge, np.array(rows, dtype=np.float64).reshape(-1, 14), _wave_rows(generator, waves, length, factor)
    )


def _checked_spread(spread: SoilSpread) -> np.ndarray:
    """(5,) standard deviations in the order of the record."""
    names = [f"spread.{entry.name}" for entry in fields(spread)]
    return np.array([_SPREAD.check(name, sd) for name, sd in zip(names, astuple(spread), strict=True)])


def _check_exponent(n: float, sd: float) -> None:
    low, high = _N_RANGE[0] + _MARGIN * sd, _N_RANGE[1] - _MARGIN * sd
    if not low <= n <= high:
        raise InvalidParameter(
            f"spread.n = {sd:g} needs soils with n in [{low:.3g}, {high:.3g}], {_MARGIN:g} of it inside "
            f"{_N_RANGE[0]:g} ... {_N_RANGE[1]:g}, got n = {n:g} - a smaller spread?"
        )


def _patch_row(i: int, patch: tuple[float, float, float, Soil], edge: float) -> list[float]:
    """A row of `SoilField.patches`."""
    if len(patch) != 4 or not isinstance(patch[-1], Soil):
        raise InvalidParameter(f"patches[{i}] must be (x, y, radius, soil), got {shown(patch)}")
    x, y, radius, soil = patch
    if soil.rigid > 0.5:
        raise InvalidParameter(f"patches[{i}] must be a deformable soil, got hard ground")
    x, y = _PLACE.check(f"patches[{i}] x", x), _PLACE.check(f"patches[{i}] y", y)
    radius = _LENGTH.check(f"patches[{i}] radius", radius)
    if radius < 0.5 * edge:
        raise InvalidParameter(f"patches[{i}] radius must be >= edge/2 = {0.5 * edge:g} m, got {radius:g}")
    power = REFERENCE_SINKAGE**soil.n
    strength = (soil.n, soil.c, math.tan(soil.phi), soil.k_x, soil.k_y)
    angles = (soil.a_0, soil.a_1, soil.b_0, soil.b_1)
    return [x, y, radius, soil.k_c * power, soil.k_phi * power, *strength, *angles]


def _square_root(correlation: ArrayLike | None) -> np.ndarray:
    """(5, 5) L with L L' = the correlation."""
    if correlation is None:
        return np.eye(5)
    matrix = np.asarray(correlation, dtype=np.float64)
    if matrix.shape != (5, 5) or not np.isfinite(matrix).all():
        raise InvalidParameter(f"correlation must be (5, 5) finite numbers, got shape {matrix.shape}")
    if not (np.allclose(matrix, matrix.T, atol=1e-9) and np.allclose(np.diag(matrix), 1.0, atol=1e-9)):
        raise InvalidParameter("correlation must be symmetric with 1 on the diagonal - a covariance?")
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    if values.min() < -1e-9:
        raise InvalidParameter(
            f"correlation must be positive semidefinite, its least eigenvalue is {values.min():.3g}"
        )
    root: np.ndarray = vectors * np.sqrt(np.maximum(values, 0.0))
    return root


def wave_vectors(count: int, correlation_length: float, turn: float = 0.0) -> np.ndarray:
    """(M, 2) plane waves [rad/m], each with the same share of the variance of Matern's correlation.

    Parameters
    ----------
    count
        M, 8 ... 4096.
    correlation_length
        [m]
    turn
        By which share of half a turn all of them are turned.

    Raises
    ------
    InvalidParameter
        For another number of waves.
    """
    if not 8 <= count <= 4096:
        raise InvalidParameter(f"waves must be in 8 ... 4096, got {count}")
    # Share of the variance over the plane beyond wavenumber k: (1 + k^2/a^2)^(-3/2), a = reach / length.
    beyond = (np.arange(count) + 0.5) / count
    wavenumber = _MATERN_REACH / correlation_length * np.sqrt(beyond ** (-2.0 / 3.0) - 1.0)
    # Golden section of the half circle: waves of about one length come from all directions.
    direction = math.pi * ((turn + _GOLDEN * np.arange(count)) % 1.0)
    return np.column_stack([wavenumber * np.cos(direction), wavenumber * np.sin(direction)])


def _wave_rows(rng: np.random.Generator, count: int, length: float, factor: np.ndarray) -> np.ndarray:
    """(M, 12) plane waves with the spectrum of Matern's correlation and amplitudes of covariance F F'."""
    waves = wave_vectors(count, length, rng.random())
    phase = 2.0 * math.pi * rng.random((count, 5))
    # Each number has the same power in every wave, with a phase of its own.
    drawn = np.concatenate([np.sin(phase), np.cos(phase)])
    # Over the plane the five would be correlated a little by their random phases: the symmetric root of their
    # covariance, close to one, takes that out, and the stated covariance stands exactly.
    values, vectors = np.linalg.eigh(drawn.T @ drawn / count)
    amplitudes = math.sqrt(2.0 / count) * drawn @ (vectors / np.sqrt(values)) @ vectors.T @ factor.T
    return np.ascontiguousarray(np.column_stack([waves, amplitudes[:count], amplitudes[count:]]))


def soil_maps(field: SoilField, base: Soil, X: ArrayLike, Y: ArrayLike) -> SoilMaps:
    """The soil at the places X, Y [m], which broadcast against each other."""
    X, Y = np.broadcast_arrays(np.asarray(X, dtype=np.float64), np.asarray(Y, dtype=np.float64))
    out = np.empty((X.size, 6))
    local_soils(field, base, X.ravel(), Y.ravel(), out)
    k_c, k_phi, n, c, phi, K = (column.reshape(X.shape) for column in out.T)
    pressure = (k_c / REFERENCE_WIDTH + k_phi) * REFERENCE_SINKAGE**n
    return SoilMaps(pressure, n, c, phi, K)
