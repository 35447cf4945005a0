"""Every fault does what the effect of its name does, though it is implemented a second time."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS
from estimators.discrepancy.faults.unmodelled import UNMODELLED_FAULTS
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.model.run_model import RunModel
from estimators.discrepancy.model.windows import FIT, Windows
from offroad_env.effects import EFFECTS, apply
from offroad_env.simulation.simulator import settled_state

#: Noise of the channels, by the beginning of their names: units for their changes.
_UNITS = {
    "a_": 0.1,
    "pitch": 0.01,
    "yaw": 0.01,
    "omega": 0.1,
    "x": 0.3,
    "y": 0.3,
    "speed": 0.05,
    "course": 0.02,
}
#: Both vehicles have to get used to what acts on them [s].
_SETTLED = 1.0
#: A small share of the plausible size keeps both sides near their first order; delays come in ticks of 5 ms.
_SHARE, _DELAY = 0.05, 0.05
_PLACES = {"n_step": {"place": 35.0, "direction": 0.0}, "n_trend": {"place": 80.0, "direction": 0.0}}
_CASE = draw_case(12, road="flat", gnss=True, n=1.0, soil="lete_sand", duration=13.0, drive="blind")


def _whole(log) -> RunModel:
    """The run as one window from its start."""
    run = RunModel(log, whole=FIT)
    return run.with_windows(Windows(first=np.array([0]), count=np.array([run.count]), use=np.array([FIT])))


@lru_cache(maxsize=1)
def _plain() -> RunModel:
    """The drive without a fault."""
    return _whole(simulated_log(_CASE))


def _simulated(setup) -> np.ndarray:
    run = _plain()
    # The simulated vehicle has settled before anything acts on it.
    x, warm = settled_state(setup.plant._replace(effects=None), v_x=3.0)
    return run.predict(setup, run.simulate(setup, x[None], warm[None], run.windows))


def _changes(name: str) -> np.ndarray:
    """Changes of all samples by the fault and by the effect of the library, in units of their noise.

    The noise of both logs is the same, sample for sample.
    """
    run, effect = _plain(), EFFECTS[name]
    base = run.setup.with_soil(n=_CASE.n)
    size = _DELAY if effect.family == "timing" else _SHARE * effect.plausible(base.plant.vehicle)
    values = Candidate(effect=name, place=_PLACES.get(name, {})).values(size)
    faulty = _whole(simulated_log(_CASE, FAULTS[name](size)))
    there = _simulated(apply(base, [(name, values)])) - _simulated(base)
    pairs = []
    for mine, channel in zip(faulty.channels, run.channels, strict=True):
        unit = next(u for start, u in _UNITS.items() if channel.name.startswith(start))
        kept = channel.t[channel.t > _SETTLED]
        # A course is only kept at speed, so one of the two may lack a sample.
        kept = kept[np.isin(kept, mine.t)]
        own, other = (c.rows.start + np.searchsorted(c.t, kept) for c in (mine, channel))
        pairs.append(np.stack([faulty.y[own] - run.y[other], there[other]]) / unit)
    return np.concatenate(pairs, axis=1)


@pytest.mark.parametrize("name", list(FAULTS))
def test_a_fault_and_the_effect_of_its_name_change_the_same_samples_by_as_much(name):
    here, there = _changes(name)
    size = np.linalg.norm(there)
    assert size > 0.0
    assert here @ there / (np.linalg.norm(here) * size) > 0.99
    assert here @ there / size**2 == pytest.approx(1.0, abs=0.02)


def test_most_of_the_library_has_a_fault_independent_of_its_laws():
    searched = {name for name, effect in EFFECTS.items() if effect.searched and effect.models != ("rig",)}
    assert searched >= set(FAULTS)
    assert len(FAULTS) >= 0.85 * len(searched)


def test_a_force_without_a_name_kicks_the_vehicle_by_its_share_of_the_weight():
    plain = simulated_log(_CASE).channels["speed"]
    for name, make in UNMODELLED_FAULTS.items():
        strange = simulated_log(_CASE, make(0.05)).channels["speed"]
        assert np.nanmax(np.abs(strange - plain)) > 0.02, name
        assert np.nanmax(np.abs(strange - plain)) < 0.05 * 9.81 * _CASE.duration, name
