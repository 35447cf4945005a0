"""Vehicles that get stuck though they would drive on as stated, and what may hold them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from estimators.discrepancy import stopping
from estimators.discrepancy import verdict as verdict_module
from estimators.discrepancy.diagnosis import diagnose
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS
from estimators.discrepancy.model.run_model import RunModel
from estimators.discrepancy.model.windows import Windows
from estimators.discrepancy.stopping import Stop, stop_of, stops_of
from estimators.discrepancy.summarise import summarise
from estimators.discrepancy.verdict import VehicleDiagnosis, Verdict
from estimators.discrepancy.wording import terminal_lines, verdict_sentence
from estimators.logs import Log
from estimators.logs.immobile import stuck_spans

_SOME = (
    "rut_drag",
    "rolling_resistance",
    "torque_scale",
    "drive_scale",
    "steer_gain",
    "accel_bias_x",
    "payload",
)


def _log(
    fault: str, size: float, *, soil: str = "rubicon_sandy_loam", n: float = 0.7, gnss: bool = True
) -> Log:
    case = draw_case(28006, soil=soil, n=n, road="unknown", gnss=gnss, natural=True, duration=14.0)
    return simulated_log(case, FAULTS[fault](size))


@pytest.fixture(scope="module")
def ruts() -> Log:
    """Its front wheels spin, its rear wheels stand."""
    return _log("rut_drag", 26500.0)


@pytest.fixture(scope="module")
def weak() -> Log:
    """All its wheels stand, though their logged torques are large."""
    return _log("torque_scale", -0.65)


def test_a_vehicle_that_ruts_hold_would_drive_as_stated(ruts):
    assert stuck_spans(ruts)
    stop = stop_of(ruts, _SOME)
    assert stop is not None
    assert stop.speed > 2.0
    assert 0.5 < stop.least < stop.speed - 0.5
    names = [name for name, _ in stop.effects]
    assert names[0] == "rut_drag"
    # Without a drive all wheels would stand, a little load holds nobody, and a sensor never does.
    assert set(names) <= {"rut_drag", "rolling_resistance"}
    assert dict(stop.effects)["rut_drag"] < 26500.0
    assert stop.to_dict()["effects"] == dict(stop.effects)


def test_where_all_wheels_stand_the_drive_is_too_weak(weak):
    stop = stop_of(weak, _SOME)
    assert stop is not None
    assert {name for name, _ in stop.effects} == {"torque_scale", "drive_scale"}
    assert all(-0.75 < size < -0.5 for _, size in stop.effects)


def test_without_a_sensor_of_its_speed_a_vehicle_that_is_stuck_begins_at_rest(ruts):
    """Its front wheels are 5 m/s fast, and the mean of all wheels is no speed of the vehicle."""
    seen, blind = (stop_of(log, _SOME) for log in (ruts, _log("rut_drag", 26500.0, gnss=False)))
    assert seen is not None
    assert blind is not None
    assert "rut_drag" in dict(blind.effects)
    assert blind.speed == pytest.approx(seen.speed, abs=0.2)


def test_a_vehicle_that_may_be_stuck_as_stated_says_nothing(ruts):
    soft = replace(ruts, config=replace(ruts.config, soil=ruts.config.soil._replace(phi=0.12, c=500.0)))
    assert stuck_spans(soft)
    assert stop_of(soft, _SOME) is None


@pytest.mark.parametrize(("least", "said"), [(0.45, False), (0.55, True)])
def test_it_must_drive_off_at_the_unfavourable_ends_of_all_tolerances(ruts, monkeypatch, least, said):
    monkeypatch.setattr(stopping, "_unfavourable", lambda run, stuck: least)
    assert (stop_of(ruts, ["steer_gain"]) is not None) == said


def test_tolerances_slow_the_stated_vehicle_down(ruts):
    run = RunModel(ruts)
    stuck, _ = stopping._pieces(run, stuck_spans(ruts))
    assert len(stuck) == 3
    speed, least = stopping._least_speed(run, run.setup, stuck), stopping._unfavourable(run, stuck)
    # Each of mass, stiffness, cohesion, strength and shear modulus is 1.5 of its deviations off, n by 0.1.
    assert least == pytest.approx(0.42 * speed, rel=0.15)


def test_a_vehicle_that_drives_is_not_asked():
    case = draw_case(28006, road="unknown", natural=True, duration=14.0)
    assert stops_of([simulated_log(case)], _SOME) == ()


def test_what_would_hold_it_where_it_drove_is_no_explanation():
    """A large resistance stops a vehicle that drives; without a piece in which it drives nothing is known."""
    run = RunModel(simulated_log(draw_case(28006, road="unknown", natural=True, duration=14.0)))
    fast = Windows(first=np.array([200]), count=np.array([round(3.0 / run.step)]), use=np.zeros(1, int))
    assert stopping._drives(run, "rolling_resistance", 0.01, fast)
    assert not stopping._drives(run, "rolling_resistance", 0.3, fast)
    assert stopping._drives(run, "rolling_resistance", 0.3, fast.only(1))


def test_an_effect_that_would_hold_it_where_it_drove_is_not_listed(ruts, monkeypatch):
    monkeypatch.setattr(stopping, "_drives", lambda run, effect, size, driven: effect != "rut_drag")
    stop = stop_of(ruts, ("rut_drag", "rolling_resistance"))
    assert stop is not None
    assert [name for name, _ in stop.effects] == ["rolling_resistance"]


@pytest.mark.parametrize(
    ("logged", "simulated", "alike"),
    [
        (0.2, 0.9, True),
        (0.2, 1.1, False),
        (3.0, 0.9, False),
        (3.0, 1.6, True),
        (3.0, 5.8, True),
        (3.0, 6.2, False),
    ],
)
def test_rims_spin_where_those_of_the_log_do_and_as_fast(monkeypatch, logged, simulated, alike):
    run = SimpleNamespace(
        log=SimpleNamespace(channels={"omega_f": ()}),
        setup=SimpleNamespace(plant=SimpleNamespace(vehicle=SimpleNamespace(r=0.5))),
        t_0=0.0,
        step=0.01,
    )
    monkeypatch.setattr(stopping, "_mean", lambda log, name, begin: logged / 0.5)
    stuck = Windows(first=np.array([0]), count=np.array([300]), use=np.zeros(1, int))
    assert stopping._alike(run, "omega_f", 1, np.array([[0.0, simulated, 0.0]]), stuck) == alike
    assert stopping._alike(run, "omega_r", 2, np.array([[0.0, simulated, 0.0]]), stuck)


def test_a_vehicle_that_is_stuck_from_the_start_is_outside_the_model_and_the_report_says_what_may_hold_it(
    ruts,
):
    diagnosis = diagnose([ruts], library=_SOME)
    assert diagnosis.verdict is Verdict.OUTSIDE
    assert not diagnosis.only_stopped
    summary = summarise(diagnosis)
    assert "the walls of the rut drag" in summary.sentence
    assert "or soil that is softer there" in summary.sentence
    assert summary.to_dict()["stops"][0]["effects"]["rut_drag"] > 0.0
    assert terminal_lines(summary)


def _stop(**effects: float) -> Stop:
    return Stop(log="run", begin=12.0, speed=3.0, least=1.0, effects=tuple(effects.items()))


def test_a_drive_without_an_error_that_ends_stuck_has_one(monkeypatch):
    quiet = VehicleDiagnosis(
        search=SimpleNamespace(refused=False, capped=False, strayed=(), uncertain=(), causes=())
    )
    for name in ("inaccurate", "misled", "overlapping", "incomplete"):
        monkeypatch.setattr(VehicleDiagnosis, name, False)
    monkeypatch.setattr(verdict_module.Diagnosis, "_without_causes", lambda self, asked: Verdict.NO_EFFECT)
    assert quiet.verdict is Verdict.NO_EFFECT
    held = replace(quiet, stops=(_stop(rut_drag=9e3, cg_shift=0.3, grade=0.1, payload=0.9, inertia=1.0),))
    assert held.only_stopped
    assert held.verdict is Verdict.ONE_OF
    assert replace(quiet, stops=(_stop(),)).verdict is Verdict.UNEXPLAINED
    said = verdict_sentence(held.verdict, held)
    assert "or another inertia; or soil" in said
    assert verdict_sentence(Verdict.UNEXPLAINED, replace(quiet, stops=(_stop(),))).endswith("softer there?")


def test_the_section_on_what_stops_a_vehicle_may_break_down(ruts, monkeypatch):
    def broken(logs, library):
        raise ArithmeticError("no solution")

    monkeypatch.setattr("estimators.discrepancy.diagnosis.stops_of", broken)
    diagnosis = diagnose([ruts], library=_SOME)
    assert diagnosis.failed == {verdict_module.STOPS: "ArithmeticError: no solution"}
    assert diagnosis.verdict is Verdict.OUTSIDE
