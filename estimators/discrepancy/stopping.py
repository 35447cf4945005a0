"""What stops a vehicle that would drive on as it is stated.

No law of a rolling vehicle can be fitted where a vehicle is stuck: its wheels tell nothing of its speed, and
nothing moves. That it stands there is itself an observation. A vehicle as stated, with mass and soil at the
unfavourable ends of their tolerances, is driven by the logged inputs from the same instants. Where even that
one drives off, something is wrong; and what may be wrong are effects that hold the stated vehicle where it
stands, with its wheels spinning or standing like those of the log, and that let it drive where it drove.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimators.discrepancy.model.run_model import RunModel
from estimators.discrepancy.model.starts import StartSensors
from estimators.discrepancy.model.windows import FIT, Windows
from estimators.discrepancy.search.score_test import effects_for
from estimators.logs.immobile import stuck_spans
from estimators.logs.log import Log
from offroad_env.effects import EFFECTS, Setup, apply
from offroad_env.errors import OffroadError
from offroad_env.physics import state as at
from offroad_env.simulation.simulator import settled_state

__all__ = ["Stop", "stop_of", "stops_of"]

#: Pieces of a log that are simulated: their length, of which the last third counts, and how many [s].
_LENGTH, _COUNT = 3.0, 3
#: A simulated vehicle that is slower stands, where the wheels' regularised friction lets it creep; it must
#: not stand where that of the log is faster than the second [m/s].
_STANDS, _DRIVES = 0.5, 1.0
#: A rim that is faster spins [m/s]; rims that spin must be as fast as those of the log within this factor.
_SPINS, _ALIKE = 1.0, 2.0
#: Sizes that are tried, as shares of the physical range.
_SHARES = (0.0625, 0.125, 0.1875, 0.25, 0.375, 0.5, 0.75, 1.0)
#: Numbers with which a vehicle sinks and slips more, in standard deviations: five at once are 3.4 of them
#: away from what is stated. And how far the exponent n may be from it.
_UNFAVOURABLE: Mapping[str, float] = {
    "mass": 1.5, "moduli": -1.5, "cohesion": -1.5, "strength": -1.5, "shear_moduli": 1.5,
}  # fmt: skip
_EXPONENTS = (-0.1, 0.0, 0.1)

_RIMS = {"omega_f": at.OMEGA_F, "omega_r": at.OMEGA_R}


@dataclass(frozen=True, kw_only=True)
class Stop:
    """A vehicle that is stuck, though it would drive on as stated."""

    log: str  #: name of the log
    begin: float  #: when it is stuck first [s]
    speed: float  #: at which the stated vehicle would drive there, at least, after 3 s [m/s]
    least: float  #: likewise with mass and soil at the unfavourable ends of their tolerances [m/s]
    #: Effects that hold the stated vehicle there, and from which size; the least unusual first.
    effects: tuple[tuple[str, float], ...]

    def to_dict(self) -> dict[str, Any]:
        """As JSON takes it."""
        return {
            "log": self.log,
            "begin": self.begin,
            "speed": self.speed,
            "least": self.least,
            "effects": dict(self.effects),
        }


def stops_of(logs: Sequence[Log], library: Sequence[str]) -> tuple[Stop, ...]:
    """Of every log in which the vehicle is stuck and would not be, what may stop it.

    Parameters
    ----------
    library
        Effects that may be named.
    """
    found = (stop_of(log, library) for log in logs)
    return tuple(stop for stop in found if stop is not None)


def stop_of(log: Log, library: Sequence[str]) -> Stop | None:
    """What stops the vehicle of one log; None where it is not stuck, or might be as stated."""
    spans = stuck_spans(log)
    if not spans or log.config.model != "full" or log.config.soil.rigid > 0.5:
        return None
    run = RunModel(log)
    stuck, driven = _pieces(run, spans)
    if not run.driven or not len(stuck):
        return None
    speed, least = _least_speed(run, run.setup, stuck), _unfavourable(run, stuck)
    if speed is None or least is None or least < _STANDS:
        return None
    vehicle = run.setup.plant.vehicle
    names = [name for name in effects_for(run, library) if not EFFECTS[name].sensors_only]
    sizes = {name: _stopping(run, name, stuck, driven) for name in names}
    known = [(name, size) for name, size in sizes.items() if size is not None]
    known.sort(key=lambda one: abs(one[1] - EFFECTS[one[0]].size.off) / EFFECTS[one[0]].plausible(vehicle))
    return Stop(log=log.name, begin=spans[0][0], speed=speed, least=least, effects=tuple(known))


def _pieces(run: RunModel, spans: Sequence[tuple[float, float]]) -> tuple[Windows, Windows]:
    """Pieces in which the vehicle is stuck, and pieces in which it drives."""
    end = run.t_0 + run.step * run.count
    stuck = [t for a, b in spans for t in np.arange(a, b - _LENGTH + 1e-6, _LENGTH)]
    free = zip([run.t_0, *(b for _, b in spans)], [*(a for a, _ in spans), end], strict=True)
    driven = [t for a, b in free for t in np.arange(a, b - _LENGTH + 1e-6, _LENGTH)]
    fast = [t for t in driven if _speed(run, t) > _DRIVES]
    return _some(run, stuck, end), _some(run, fast, end)


def _speed(run: RunModel, begin: float) -> float:
    """Speed of the log's vehicle in the last third of a piece, by its slower rims if nothing else tells."""
    for name in ("v_x", "speed"):
        if name in run.log.channels:
            return _mean(run.log, name, begin)
    return run.setup.plant.vehicle.r * min(
        (_mean(run.log, rim, begin) for rim in _RIMS if rim in run.log.channels), default=0.0
    )


def _some(run: RunModel, starts: Sequence[float], end: float) -> Windows:
    """Windows of one length from some of these instants [s], spread over all of them."""
    count = round(_LENGTH / run.step)
    inside = [t for t in starts if t + _LENGTH <= end + 1e-6]
    chosen = np.unique(np.linspace(0, len(inside) - 1, min(_COUNT, len(inside))).round().astype(int))
    first = np.array([round((inside[i] - run.t_0) / run.step) for i in chosen], dtype=int)
    first = np.minimum(first, run.count - count)
    return Windows(first=first, count=np.full(len(first), count), use=np.full(len(first), FIT))


def _mean(log: Log, name: str, begin: float) -> float:
    """Mean of a channel over the last third of a piece; NaN without samples."""
    t, values = log.samples(name)
    inside = values[(t >= begin + 2.0 / 3.0 * _LENGTH) & (t < begin + _LENGTH)]
    return float(inside.mean()) if len(inside) else float("nan")


def _motion(run: RunModel, setup: Setup, windows: Windows, *, stuck: bool = True) -> np.ndarray | None:
    """(W, 3) speed of the vehicle and of the front and rear rims [m/s] in the last thirds of the windows.

    None where the vehicle cannot be simulated. One that is ``stuck`` begins at rest: without a sensor of its
    own speed that of its wheels would be taken.
    """
    radius = run.setup.plant.vehicle.r
    sensors = StartSensors(run.log, radius=radius, driven=run.driven)
    try:
        starts, warms = [], []
        for first in windows.first:
            t, begun = run.t_0 + run.step * int(first), np.zeros(at.STATE_SIZE)
            sensors.correct(begun, t)
            x, warm = settled_state(setup.plant, x=begun[at.X], y=begun[at.Y], yaw=begun[at.YAW], v_x=0.0)
            sensors.correct(x, t)
            x[at.V_X] = 0.0 if stuck else x[at.V_X]
            starts.append(x)
            warms.append(warm)
        states = run.simulate(setup, np.array(starts), np.array(warms), windows).states
    except (OffroadError, ArithmeticError):
        return None
    last = [states[end - (end - begin) // 3 : end] for begin, end in zip(*_ends(windows), strict=True)]
    scale = {at.V_X: 1.0, at.OMEGA_F: radius, at.OMEGA_R: radius}
    return np.array([[size * piece[:, i].mean() for i, size in scale.items()] for piece in last])


def _ends(windows: Windows) -> tuple[np.ndarray, np.ndarray]:
    return windows.begin[:-1], windows.begin[1:]


def _least_speed(run: RunModel, setup: Setup, stuck: Windows) -> float | None:
    """Least speed in the pieces in which the vehicle of the log is stuck [m/s]."""
    motion = _motion(run, setup, stuck)
    return None if motion is None else float(motion[:, 0].min())


def _unfavourable(run: RunModel, stuck: Windows) -> float | None:
    """The same of a vehicle whose mass and soil are at the ends of their tolerances, and n off, too."""
    numbers = {nuisance.name: nuisance for nuisance in run.nuisances}
    setup = run.setup
    for name, value in _UNFAVOURABLE.items():
        setup = numbers[name].change(setup, run, value)
    speeds = []
    for change in _EXPONENTS:
        try:
            speeds.append(_least_speed(run, numbers["ground"].change(setup, run, change), stuck))
        except OffroadError:
            return None
    known = [speed for speed in speeds if speed is not None]
    return min(known) if len(known) == len(speeds) else None


def _stopping(run: RunModel, effect: str, stuck: Windows, driven: Windows) -> float | None:
    """Smallest tried size of an effect that does to the stated vehicle what the log shows; None without."""
    found = []
    for end in run.size_limits(effect):
        sizes = [EFFECTS[effect].size.off + share * (end - EFFECTS[effect].size.off) for share in _SHARES]
        if end == EFFECTS[effect].size.off or not any(_stands(run, effect, s, stuck) for s in sizes[-1:3:-2]):
            continue
        for size in sizes:
            if _stands(run, effect, size, stuck, rims=True) and _drives(run, effect, size, driven):
                found.append(size)
                break
    return min(found, key=lambda size: abs(size - EFFECTS[effect].size.off), default=None)


def _with(run: RunModel, effect: str, size: float) -> Setup | None:
    try:
        return apply(run.setup, [(effect, {EFFECTS[effect].size.name: size})])
    except OffroadError:
        return None


def _stands(run: RunModel, effect: str, size: float, stuck: Windows, *, rims: bool = False) -> bool:
    """Whether the vehicle stands with this effect; with ``rims`` also whether they turn like the log's."""
    setup = _with(run, effect, size)
    motion = None if setup is None else _motion(run, setup, stuck)
    if motion is None or motion[:, 0].max() > _STANDS:
        return False
    return not rims or all(_alike(run, name, column, motion, stuck) for column, name in enumerate(_RIMS, 1))


def _alike(run: RunModel, rim: str, column: int, motion: np.ndarray, stuck: Windows) -> bool:
    """Whether a rim spins where that of the log does, about as fast, and stands where it stands."""
    if rim not in run.log.channels:
        return True
    radius = run.setup.plant.vehicle.r
    for first, speed in zip(stuck.first, motion[:, column], strict=True):
        logged = radius * _mean(run.log, rim, run.t_0 + run.step * int(first))
        if np.isfinite(logged) and (logged > _SPINS) != (speed > _SPINS):
            return False
        if logged > _SPINS and not 1.0 / _ALIKE < speed / logged < _ALIKE:
            return False
    return True


def _drives(run: RunModel, effect: str, size: float, driven: Windows) -> bool:
    """Whether the vehicle drives with this effect where that of the log does."""
    if not len(driven):
        return True
    setup = _with(run, effect, size)
    motion = None if setup is None else _motion(run, setup, driven, stuck=False)
    return motion is not None and bool(motion[:, 0].min() > _STANDS)
