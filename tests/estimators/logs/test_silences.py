"""A clock that jumps costs nothing: the parts before and after are used, and the jump is a finding."""

from __future__ import annotations

import numpy as np
import pytest
from bad_logs import good_rows, text_of, write

from estimators.logs import quality, read_log
from estimators.logs.row_order import shortened


def log_with_jump(folder, by, at=20):
    head, *rows = good_rows()
    for i, row in enumerate(rows):
        row[0] = repr(0.01 * i + by * (i >= at))
    write(folder, text_of([head, *rows]))
    return read_log(folder / "run.csv")


@pytest.mark.parametrize("by", [1e3, 1e6, 1.7e9])
def test_a_jump_of_the_clock_keeps_all_samples_and_is_named_with_its_length(tmp_path, by):
    log = log_with_jump(tmp_path, by)
    plain = 0.01 * np.arange(40)
    assert len(log) == 40
    assert np.allclose(log.t[:20], plain[:20])
    assert np.allclose(np.diff(log.t[20:]), 0.01, atol=1e-6)  # stamps of 1.7e9 s have no more digits
    assert log.duration < 31.0
    (finding,) = (f for f in quality(log).findings if f.kind == "time jump")
    assert f"jumps by {by + 0.01:.4g} s at t = 0.190 s" in finding.sentence
    assert finding.numbers["longest"] == pytest.approx(by, rel=1e-4)


def test_a_pause_of_some_seconds_is_a_pause(tmp_path):
    log = log_with_jump(tmp_path, 20.0)
    assert log.duration == pytest.approx(20.39)
    assert not log.config.silences
    assert "time jump" not in {finding.kind for finding in quality(log).findings}


def test_many_silences_share_the_time_that_the_samples_allow():
    t = 0.01 * np.arange(10_000.0) + 25.0 * (np.arange(10_000) // 10)
    short, silences = shortened(t)
    assert len(silences) == 999
    active = 0.01 * 9 * 1000
    assert short[-1] - short[0] <= 11.0 * active + 1.0
    assert (np.diff(short) > 0.0).all()
    kept = np.diff(t) < 1.0
    assert np.allclose(np.diff(short)[kept], 0.01, atol=1e-9)


def test_stamps_without_silences_stay_bit_for_bit():
    t = np.cumsum(np.random.default_rng(3).uniform(0.005, 0.9, 500))
    assert shortened(t) == (t, ())
