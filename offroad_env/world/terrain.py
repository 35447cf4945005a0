"""Height fields and soil maps: flat, grades, the paper's field, ISO 8608 roughness, soil patches."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from offroad_env.errors import InvalidParameter
from offroad_env.physics.ground import ground_heights
from offroad_env.physics.path_geometry import PathTable, path_point
from offroad_env.physics.records import Ground, SoilMap
from offroad_env.world.catalogue import Quantity

__all__ = [
    "ISO_8608_CLASSES",
    "Terrain",
    "add",
    "flat",
    "grade",
    "height_map",
    "heights",
    "paper_terrain",
    "rough_terrain",
    "soil_map",
    "soil_patches_along",
]

#: Displacement PSD G_d(n_0) of a profile at n_0 = 0.1 cycles/m [m^3]: geometric means of the road
#: classes of ISO 8608:2016, a factor of 4 from one class to the next.
ISO_8608_CLASSES = MappingProxyType({name: 16e-6 * 4.0**i for i, name in enumerate("ABCDEFGH")})

_REFERENCE_FREQUENCY = 0.1  # n_0 of ISO 8608 [cycles/m]

_SLOPE = Quantity("in [-0.8, 0.8] rad", -0.8, 0.8, mistakes=((0.8000001, 46.0, "degrees"),))
_DIRECTION = Quantity("in [-2 pi, 2 pi] rad", -6.2832, 6.2832, mistakes=((6.2833, 360.0, "degrees"),))
_HEIGHT = Quantity("in [-2, 2] m", -2.0, 2.0, mistakes=((2.0000001, 2e3, "mm or cm given as m"),))
_ROUGHNESS = Quantity(
    "in (0, 1] m^3", 0.0, 1.0, low_open=True, mistakes=((1.0000001, 1e6, "1e-6 m^3 given as m^3"),)
)
_FREQUENCY = Quantity(
    "in [1e-3, 10] cycles/m", 1e-3, 10.0, mistakes=((10.0000001, 1e3, "rad/m, or a wavelength"),)
)
_PLACE = Quantity("in [-1e4, 1e4] m", -1e4, 1e4)
_LENGTH = Quantity("in (0, 1e4] m", 0.0, 1e4, low_open=True)
_EXPONENT = Quantity("in (0.05, 2.5]", 0.05, 2.5, low_open=True)

#: Angles from 0 to a quarter of a turn between which the search for frequencies begins [rad]; from the line
#: between two of them two steps of Newton's method reach rounding.
_ANGLES = np.linspace(0.0, 0.5 * math.pi, 2001)[:-1]
_RATIOS = _ANGLES / np.cos(_ANGLES)


@dataclass(frozen=True, kw_only=True, eq=False)
class Terrain:
    """Where a vehicle drives: the shape of the ground, and where the soil differs from the base soil."""

    ground: Ground  #: height field
    soil_map: SoilMap = field(default_factory=lambda: soil_map())  #: patches of another exponent n

    def describe(self) -> dict[str, object]:
        """Numbers that characterise the terrain, for a report or a JSON file.

        Returns
        -------
        dict with the plane (``height`` [m], ``slope_X``, ``slope_Y`` [-]), the waves (``waves`` their
        number, ``height_sd`` [m], ``slope_sd`` [-] over all points and directions, ``wavelengths``
        shortest and longest [m] or None) and ``patch_edge`` [m], ``patches`` (x, y, radius [m], n).
        """
        amplitude, p, q, _ = self.ground.waves.T
        wavenumber = np.hypot(p, q)
        present = wavenumber[(wavenumber > 0.0) & (amplitude != 0.0)]
        lengths = 2.0 * math.pi / present
        return {
            "height": self.ground.H_0,
            "slope_X": self.ground.S_x,
            "slope_Y": self.ground.S_y,
            "waves": len(amplitude),
            "height_sd": math.sqrt(float(np.sum(amplitude**2)) / 2.0),
            "slope_sd": math.sqrt(float(np.sum((amplitude * wavenumber) ** 2)) / 2.0),
            "wavelengths": [float(lengths.min()), float(lengths.max())] if lengths.size else None,
            "patch_edge": self.soil_map.edge,
            "patches": self.soil_map.patches.tolist(),
        }


def _waves(rows: ArrayLike) -> np.ndarray:
    return np.ascontiguousarray(np.asarray(rows, dtype=np.float64).reshape(-1, 4))


def flat(height: float = 0.0) -> Ground:
    """Level ground at ``height`` [m].

    Raises
    ------
    InvalidParameter
        If the height lies outside -2 ... 2 m.
    """
    return Ground(_HEIGHT.check("height", height), 0.0, 0.0, _waves([]))


def grade(slope: float, direction: float = 0.0) -> Ground:
    """A plane through the origin that climbs by ``slope`` towards ``direction``.

    Parameters
    ----------
    slope
        Angle of the plane, positive uphill [rad].
    direction
        Heading in which it climbs, from the X axis towards the Y axis [rad].

    Raises
    ------
    InvalidParameter
        If the slope is steeper than 0.8 rad (46 degrees) or the direction is outside a full turn.
    """
    rise = math.tan(_SLOPE.check("slope", slope))
    direction = _DIRECTION.check("direction", direction)
    return Ground(0.0, rise * math.cos(direction), rise * math.sin(direction), _waves([]))


def paper_terrain(H_0: float = 0.05) -> Ground:
    """The paper's field H_0 sin^2(0.5 X) cos(1.5 Y), written as three plane waves.

    sin^2(X/2) = (1 - cos X)/2 turns it into H_0/2 cos(1.5 Y) - H_0/4 [cos(X + 1.5 Y) + cos(X - 1.5 Y)].

    Parameters
    ----------
    H_0
        Greatest height [m]; the paper uses 0.05 and 0.01.

    Raises
    ------
    InvalidParameter
        If H_0 lies outside -2 ... 2 m.

    References
    ----------
    Buzhardt & Tallapragada, ACC 2021 (arXiv 2202.04727), section II-C.
    """
    H_0 = _HEIGHT.check("H_0", H_0)
    cosine = 0.5 * math.pi
    rows = [
        (0.5 * H_0, 0.0, 1.5, cosine),
        (-0.25 * H_0, 1.0, 1.5, cosine),
        (-0.25 * H_0, 1.0, -1.5, cosine),
    ]
    return Ground(0.0, 0.0, 0.0, _waves(rows))


def _variance_beyond(frequency: np.ndarray, high: float) -> np.ndarray:
    """Variance of the waves shorter than 1/``frequency``, per unit of C in G(n) = C / n^2 [1/m].

    Arc cosine over frequency: the closed form derived in ``rough_terrain``.
    """
    variance: np.ndarray = np.arccos(np.minimum(frequency / high, 1.0)) / frequency
    return variance


class _Bins(NamedTuple):
    """M bins of the spectrum, each of which a wave stands for."""

    edges: np.ndarray  #: (M + 1,) rising frequencies [cycles/m]
    beyond: np.ndarray  #: (M + 1,) `_variance_beyond` the edges
    minus_variance: np.ndarray  #: (M,) of the bins, negative
    turns: np.ndarray  #: (M,) of the waves' directions from one to the next, in half turns


@lru_cache(maxsize=64)
def _bins(low: float, high: float, count: int) -> _Bins:
    """Frequencies ``low`` ... ``high`` [cycles/m] that share the spectrum out evenly.

    Steps of equal ratio alone would put most of the shortest waves into the last bin, where the
    variance grows with the angle arccos(k / high): the steps are equal in the sum of both.
    """
    angle = np.linspace(math.acos(low / high), 0.0, 4001)
    progress = np.log(np.cos(angle)) - 2.0 * angle
    chosen = np.interp(np.linspace(progress[0], progress[-1], count + 1), progress, angle)
    edges = high * np.cos(chosen)
    beyond = _variance_beyond(edges, edges[-1])
    golden = 0.5 * (math.sqrt(5.0) - 1.0)
    found = _Bins(edges, beyond, np.diff(beyond), golden * np.arange(count))
    for array in found:
        array.flags.writeable = False  # kept for the next ground
    return found


def _draw_frequencies(bins: _Bins, rng: np.random.Generator) -> np.ndarray:
    """One frequency [cycles/m] from each bin, with probability in proportion to the variance density."""
    edges, beyond = bins.edges, bins.beyond
    share = rng.random(len(edges) - 1)
    ratio = edges[-1] * ((1.0 - share) * beyond[:-1] + share * beyond[1:])
    # The variance beyond k = K cos a is a / (K cos a). In the angle it has no place of infinite slope.
    angle = np.interp(ratio, _RATIOS, _ANGLES)
    for _ in range(2):
        cos, sin = np.cos(angle), np.sin(angle)
        angle -= (angle - ratio * cos) / (1.0 + ratio * sin)
    drawn: np.ndarray = edges[-1] * np.cos(angle)
    return drawn


def rough_terrain(
    iso_class: str | None,
    rng: np.random.Generator,
    *,
    roughness: float | None = None,
    waves: int = 64,
    band: tuple[float, float] = (0.05, 1.5),
) -> Ground:
    """Isotropic random roughness whose straight profiles have the spectrum of ISO 8608.

    Parameters
    ----------
    iso_class
        Class "A" (very good) ... "H" (very rough) of ISO 8608; None where ``roughness`` is given.
    rng
        Source of frequencies, directions and phases; always ``2 waves + 1`` draws.
    roughness
        One-sided displacement PSD of a profile G_d(n_0) at n_0 = 0.1 cycles/m [m^3].
    waves
        Number of plane waves.
    band
        Lowest and highest spatial frequency [cycles/m]. ISO 8608 asks for no measurement below 0.05 off
        the road; waves much shorter than the contact patch do not act on a rigid wheel.

    Returns
    -------
    Ground of mean height 0.

    Raises
    ------
    InvalidParameter
        If neither or both of class and roughness are given, or a value is out of range.

    Notes
    -----
    A profile of the ground shall have the PSD G(n) = C / n^2 in the band, with C = G_d(n_0) n_0^2 (ISO
    8608:2016, waviness 2). A plane wave of frequency k that runs at the angle a to the profile shows in
    it at n = k |cos a|. With a variance g(k) dk of the waves from k to k + dk and uniform directions,

        G(n) = (2 / pi) integral from n to infinity of g(k) / sqrt(k^2 - n^2) dk,

    an Abel transform; its inverse g(k) = -k integral of G'(n) / sqrt(n^2 - k^2) dn, for a spectrum that
    ends at the top of the band K, gives after integration from k to K

        variance of the waves beyond k = C arccos(k / K) / k.

    Each wave stands for one of ``waves`` bins: A^2/2 is the bin's variance, its frequency is drawn from
    the density g within the bin, so the spectrum averaged over seeds is exact, not only at bin centres.
    Directions follow the golden ratio from a random start, which spreads them evenly over neighbouring
    bins. Below the band profiles keep a low plateau: waves met at a flat angle look long.

    References
    ----------
    ISO 8608:2016, Mechanical vibration - Road surface profiles - Reporting of measured data.
    Dodds & Robson, The description of road surface roughness, J. Sound Vib. 31 (1973): isotropy.
    Kamash & Robson, The application of isotropy in road surface modelling, J. Sound Vib. 57 (1978).
    """
    C = _profile_roughness(iso_class, roughness) * _REFERENCE_FREQUENCY**2
    low, high = _checked_band(waves, band)
    if not isinstance(rng, np.random.Generator):
        raise InvalidParameter(f"rng must be a numpy Generator, got {rng!r} - default_rng(seed)?")
    return Ground(0.0, 0.0, 0.0, _drawn_waves(C, _bins(low, high, waves), rng))


def _drawn_waves(C: float, bins: _Bins, rng: np.random.Generator) -> np.ndarray:
    """(M, 4) waves as in `Ground`, one from each of M bins of the spectrum; ``C`` as in `rough_terrain`."""
    count = len(bins.minus_variance)
    amplitude = np.sqrt(-2.0 * C * bins.minus_variance)
    wavenumber = 2.0 * math.pi * _draw_frequencies(bins, rng)
    angle = math.pi * ((rng.random() + bins.turns) % 1.0)  # half a turn: waves have no front
    phase = 2.0 * math.pi * rng.random(count)
    waves = np.empty((count, 4))
    waves[:, 0], waves[:, 3] = amplitude, phase
    np.multiply(wavenumber, np.cos(angle), out=waves[:, 1])
    np.multiply(wavenumber, np.sin(angle), out=waves[:, 2])
    return waves


def _checked_band(waves: int, band: tuple[float, float]) -> tuple[float, float]:
    """Lowest and highest frequency [cycles/m] of so many waves, or a refusal."""
    if isinstance(waves, bool) or not isinstance(waves, int) or not 1 <= waves <= 10_000:
        raise InvalidParameter(f"waves must be a whole number in [1, 10000], got {waves!r}")
    low, high = (_FREQUENCY.check(f"band[{i}]", value) for i, value in enumerate(band))
    if not low < high:
        raise InvalidParameter(f"band must be (lowest, highest) frequency, got {band} - wavelengths instead?")
    return low, high


def _profile_roughness(iso_class: str | None, roughness: float | None) -> float:
    """G_d(n_0) [m^3] from a class or a number, exactly one of which is given."""
    if (iso_class is None) == (roughness is None):
        raise InvalidParameter("give either iso_class (A ... H) or roughness (G_d(n_0) in m^3), not both")
    if roughness is not None:
        return _ROUGHNESS.check("roughness", roughness)
    if iso_class is None or iso_class not in ISO_8608_CLASSES:
        raise InvalidParameter(f"iso_class must be one of A ... H, got {iso_class!r}")
    return ISO_8608_CLASSES[iso_class]


def add(*grounds: Ground) -> Ground:
    """Superposition: the height is the sum of the heights.

    Raises
    ------
    InvalidParameter
        If nothing is given, or something that is not a ground.
    """
    if not grounds or not all(isinstance(ground, Ground) for ground in grounds):
        raise InvalidParameter("add needs at least one Ground, and nothing else - a Terrain's .ground?")
    return Ground(
        H_0=math.fsum(ground.H_0 for ground in grounds),
        S_x=math.fsum(ground.S_x for ground in grounds),
        S_y=math.fsum(ground.S_y for ground in grounds),
        waves=_waves(np.concatenate([ground.waves for ground in grounds])),
    )


def heights(ground: Ground, X: ArrayLike, Y: ArrayLike) -> np.ndarray:
    """Height [m] at the points X, Y [m], which broadcast against each other."""
    X, Y = np.broadcast_arrays(np.asarray(X, dtype=np.float64), np.asarray(Y, dtype=np.float64))
    out = np.empty(X.size)
    ground_heights(ground, X.ravel(), Y.ravel(), out)
    return out.reshape(X.shape)


def height_map(ground: Ground, X: ArrayLike, Y: ArrayLike) -> np.ndarray:
    """Height [m] on the grid of the axes ``X`` (J,) and ``Y`` (I,) [m]: shape (I, J), as images want it."""
    return heights(ground, np.asarray(X)[None, :], np.asarray(Y)[:, None])


def soil_map(patches: Iterable[Sequence[float]] = (), edge: float = 0.3) -> SoilMap:
    """Discs in which the sinkage exponent differs from the base soil's.

    Parameters
    ----------
    patches
        Rows (x [m], y [m], radius [m], n inside [-]); later rows lie over earlier ones.
    edge
        Width over which n passes from outside to inside, centred on the radius [m].

    Raises
    ------
    InvalidParameter
        If a row has not four numbers, a value is out of range, or an edge is wider than its disc.
    """
    edge = _LENGTH.check("edge", edge)
    rows = []
    for i, row in enumerate(patches):
        if len(row) != 4:
            raise InvalidParameter(f"patches[{i}] must be (x, y, radius, n), got {row!r}")
        x, y = (_PLACE.check(f"patches[{i}] {axis}", value) for axis, value in zip("xy", row, strict=False))
        radius = _LENGTH.check(f"patches[{i}] radius", row[2])
        if radius < 0.5 * edge:
            raise InvalidParameter(
                f"patches[{i}] radius must be >= edge/2 = {0.5 * edge:g} m, got {radius:g}"
            )
        rows.append((x, y, radius, _EXPONENT.check(f"patches[{i}] n", row[3])))
    return SoilMap(edge, _waves(rows))


def soil_patches_along(
    path: PathTable,
    sections: Iterable[Sequence[float]],
    *,
    half_width: float = 3.0,
    edge: float = 0.3,
) -> SoilMap:
    """Soil whose exponent steps along a path: a chain of discs for each section.

    Parameters
    ----------
    path
        The path; a curve should be wider than ``half_width``.
    sections
        Rows (start [m], end [m], n [-]) in arc length; on the path itself n changes exactly there.
    half_width
        The strip to both sides of the path that a section fills [m]. At this distance a section starts
        and ends up to 0.4 half_width later and earlier, because discs are round.
    edge
        Width of the change [m].

    Raises
    ------
    InvalidParameter
        If a section lies outside the path or is shorter than the two end discs.
    """
    edge = _LENGTH.check("edge", edge)
    half_width = _LENGTH.check("half_width", half_width)
    # Within (radius - edge/2) of a centre n is the section's own. Centres every half_width leave the
    # strip covered even outside a bend as sharp as the strip is wide: sqrt(1 + 1) < 1.5.
    radius = 1.5 * half_width + 0.5 * edge
    rows = []
    for i, row in enumerate(sections):
        if len(row) != 3:
            raise InvalidParameter(f"sections[{i}] must be (start, end, n), got {row!r}")
        start, end = _PLACE.check(f"sections[{i}] start", row[0]), _PLACE.check(f"sections[{i}] end", row[1])
        if start < 0.0 or end > path.length or end - start < 2.0 * radius:
            raise InvalidParameter(
                f"sections[{i}] must lie in 0 ... {path.length:g} m and be at least {2.0 * radius:g} m long "
                f"(3 half_width + edge), got {start:g} ... {end:g} m"
            )
        first, last = _centre(path, start, radius), _centre(path, end, -radius)
        for s in np.linspace(first, last, max(math.ceil((last - first) / half_width), 0) + 1):
            centre = path_point(path, float(s))
            rows.append((centre.X, centre.Y, radius, row[2]))
    return soil_map(rows, edge)


def _centre(path: PathTable, mark: float, radius: float) -> float:
    """Arc length [m] of the disc whose rim crosses the path at ``mark``; ahead of it for radius > 0."""
    start = path_point(path, mark)
    s = mark + radius
    for _ in range(30):  # a chord is a little shorter than its arc: the rest shrinks tenfold each time
        end = path_point(path, s)
        s += math.copysign(abs(radius) - math.hypot(end.X - start.X, end.Y - start.Y), radius)
    return s
