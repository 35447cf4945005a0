"""What a page plays back: all of a drive in little room, as text that cannot leave its element."""

from __future__ import annotations

import json

import gymnasium as gym
import numpy as np
import pytest
from bad_logs import good_rows, rig, text_of, write

from agents.benchmark.natural import options_of
from agents.benchmark.runner import ENV_ID, draw_episodes
from agents.controllers.arms import make_arm
from agents.driving.episode import Drive
from agents.driving.playback import episode_playback
from agents.driving.recording import EpisodeLog
from agents.driving.unwrapped import bekker_env
from agents.reports.log_playback import log_playback
from agents.reports.output import Record, recorded, say, table
from agents.reports.page import Section, render_page
from agents.reports.playback import Above, Chart, Line, Playback, WheelSide
from agents.reports.study import render_study
from estimators.logs import read_log
from offroad_env.simulation.soil_holds import what_soil_holds


def long_drive(count=5000):
    t = np.linspace(0.0, 50.0, count)
    values = np.sin(t)
    values[10] = np.nan
    return Playback(
        t=t,
        above=Above(x=t, y=values, yaw=0.0 * t, path=np.column_stack((t, 0.0 * t)), corridor=2.0,
                    stretches=((10.0, 20.0, "n = 0.5"), (60.0, 70.0, "beyond the path"))),
        wheels=(WheelSide(name="front", radius=0.3, turned=3.0 * t, slip=0.1 * t),),
        charts=(Chart(title="</script><b>", unit="m", lines=(Line(label="&", values=values, low=values),)),),
    )  # fmt: skip


def test_a_long_drive_takes_as_many_samples_as_a_screen_has_columns():
    content = json.loads(str(long_drive().embedded()))
    assert len(content["t"]) == 1200
    assert content["t"][0] == 0.0
    assert content["t"][-1] == 50.0
    (line,) = content["charts"][0]["lines"]
    assert len(line["values"]) == len(line["low"]) == 1200
    assert line["high"] is None
    assert max(content["wheels"][0]["turned"]) < 6.2832


def test_a_short_drive_is_kept_whole_and_gaps_are_null():
    content = json.loads(str(long_drive(40).embedded()))
    assert len(content["t"]) == 40
    assert content["charts"][0]["lines"][0]["values"][10] is None


def test_stretches_follow_the_path_and_none_lies_beyond_it():
    (stretch,) = json.loads(str(long_drive().embedded()))["above"]["stretches"]
    assert stretch["name"] == "n = 0.5"
    places = np.array(stretch["points"])
    assert 9.9 < places[:, 0].min() < places[:, 0].max() < 20.1


def test_names_of_a_drive_cannot_end_the_script_that_holds_them():
    text = str(long_drive().embedded())
    assert "<" not in text
    page = render_page(
        [Section(name="a", title="a", sees="b", playback=long_drive())], title="t", intro="i", footer="f"
    )
    assert page.count("</script>") == 2  # of the data, and of the program
    assert "<script>" not in render_page(
        [Section(name="a", title="a", sees="b")], title="t", intro="i", footer="f"
    )


@pytest.fixture(scope="module")
def driven():
    arm = make_arm("aware", scenario="brake")
    env = gym.make(ENV_ID, scenario="brake", terrain_info=arm.terrain_info, max_episode_steps=120)
    drive = Drive(env, arm.agent, seed=0)
    for _ in drive:
        pass
    return drive, episode_playback(drive.log, bekker_env(env).briefing)


def test_an_episode_shows_n_and_what_the_soil_holds_with_bands(driven):
    _, played = driven
    for title in ("sinkage exponent n", "largest lateral acceleration that the soil holds", "largest pull"):
        (chart,) = [chart for chart in played.charts if chart.title == title]
        estimate, true = chart.lines
        assert (estimate.low <= estimate.values + 1e-9).all()
        assert (estimate.values <= estimate.high + 1e-9).all()
        assert estimate.high[-1] - estimate.low[-1] < estimate.high[0] - estimate.low[0]
        assert np.ptp(true.values) < 1e-9  # one soil
    assert all(chart.unit for chart in played.charts)


def _coasting(plant, **options):
    """Charts of an episode that rolls straight on, by title, and what the true soil holds, by title."""
    env = gym.make(ENV_ID, **{"scenario": "speed", **options})
    base, draw = bekker_env(env), draw_episodes("speed", 2, 0, form="natural")[0]
    log = EpisodeLog.start(env, env.reset(seed=draw.seed)[1])
    for _ in range(60):
        log.add((0.0, 0.3), env.step(np.array([0.0, 0.3], np.float32))[4])
    played = episode_playback(log, base.briefing, *([base.plant] if plant else []))
    held = what_soil_holds(base.plant._replace(soil_field=None))
    true = {
        "largest lateral acceleration that the soil holds": held.lateral,
        "largest pull": 1e-3 * held.pull,
    }
    return {chart.title: chart for chart in played.charts}, true


def test_the_limits_of_an_episode_of_the_natural_form_are_those_of_its_true_soil_or_none():
    """A soil that is drawn whole, under flexible tyres, holds another limit than the believed one has."""
    options = {"terrain_info": "belief", **options_of("speed", "natural")}
    charts, true = _coasting(plant=False, **options)
    assert not set(true) & set(charts)
    charts, true = _coasting(plant=True, **options)
    for title, value in true.items():
        (line,) = charts[title].lines  # it does not follow from the estimate of n
        assert line.values == pytest.approx(value)


def test_the_true_limits_of_an_unusual_vehicle_and_soil_are_their_own():
    drawn = {"soil.k_phi": (3.0e5, 3.0e5), "vehicle.m": (1500.0, 1500.0)}
    charts, true = _coasting(plant=True, terrain_info="estimate", randomise=drawn)
    for title, value in true.items():
        estimate, line = charts[title].lines
        assert line.values == pytest.approx(value, rel=1e-3)
        assert estimate.values[-1] != pytest.approx(value, rel=1e-3)


def test_wheels_turn_as_fast_as_the_vehicle_and_its_slip_ask_for(driven):
    drive, played = driven
    columns = drive.log.columns()
    for wheel in played.wheels:
        way = wheel.radius * (wheel.turned[-1] - wheel.turned[0])
        travelled = float(np.sum(columns["speed"][1:] * np.diff(columns["time"])))
        assert way == pytest.approx(travelled / (1.0 - np.mean(wheel.slip)), rel=0.1)


def test_a_log_is_played_back_and_the_trials_of_a_rig_are_not(tmp_path):
    (tmp_path / "drive").mkdir()
    write(tmp_path / "drive", text_of(good_rows()))
    played = log_playback(read_log(tmp_path / "drive" / "run.csv"))
    assert played is not None
    assert played.charts
    assert all(len(line.values) == len(played.t) for chart in played.charts for line in chart.lines)
    (tmp_path / "rig").mkdir()
    rig(lambda rows: None)(tmp_path / "rig")
    assert log_playback(read_log(tmp_path / "rig" / "run.csv")) is None


def test_what_a_study_shows_becomes_its_page():
    with recorded() as record:
        say("figure: out/x.png")
        say("the bank is best <on all rows>")
        table("errors", ("filter", "RMSE"), [("bank", "0.01"), ("EKF", "0.02")])
    page = render_study("filters", "all filters", record, command="offroad reproduce filters", footer="f")
    verdict = page.partition('class="verdict')[2].partition("</div>")[0]
    assert "The bank is best &lt;on all rows&gt;." in verdict
    assert "out/x.png" not in page
    assert page.count("<tr>") == 3
    say("not recorded")
    assert record.lines[-1] != "not recorded"
    assert "All filters" in render_study("filters", "all filters", Record(), command="c", footer="f")
