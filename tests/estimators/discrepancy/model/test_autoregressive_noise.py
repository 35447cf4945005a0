"""Whitening: coloured noise becomes white, whatever gaps the samples have."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from estimators.discrepancy.model.autoregressive_noise import (
    AutoregressiveNoise,
    ChannelNoise,
    stretches,
    white_deviation,
)
from estimators.discrepancy.model.protocol import Channel
from estimators.discrepancy.model.windows import FIT, REPORT, SELECT, cut


def _coloured(rng: np.random.Generator, count: int) -> np.ndarray:
    return lfilter([1.0], [1.0, -1.5, 0.7], rng.standard_normal(count + 200))[200:]


def test_noise_of_known_colour_is_whitened_and_its_memory_found():
    rng = np.random.default_rng(1)
    pieces = [_coloured(rng, 400) for _ in range(20)]
    noise = ChannelNoise.fitted(pieces, freedom=0.0)
    assert noise.order >= 2
    assert noise.predictors[2] == pytest.approx([1.5, -0.7], abs=0.05)
    white = np.concatenate([noise.whiten(piece) for piece in pieces])
    assert white.std() == pytest.approx(1.0, abs=0.03)
    assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 0.03


def test_the_first_samples_of_a_stretch_count_as_much_as_the_others():
    rng = np.random.default_rng(2)
    noise = ChannelNoise.fitted([_coloured(rng, 400) for _ in range(20)], freedom=0.0)
    first = np.array([noise.whiten(_coloured(rng, 30))[:2] for _ in range(3000)])
    assert first.std(axis=0) == pytest.approx([1.0, 1.0], abs=0.06)


def test_whitening_is_linear_and_treats_columns_alike():
    rng = np.random.default_rng(3)
    noise = ChannelNoise.fitted([_coloured(rng, 300)], freedom=0.0)
    a, b = rng.standard_normal((2, 50))
    together = noise.whiten(np.column_stack([a, b]))
    assert np.allclose(together[:, 0], noise.whiten(a))
    assert np.allclose(noise.whiten(2.0 * a - b), 2.0 * together[:, 0] - together[:, 1])


def test_parameters_that_a_fit_has_spent_widen_the_noise():
    rng = np.random.default_rng(4)
    pieces = [rng.standard_normal(100)]
    assert ChannelNoise.fitted(pieces, freedom=50.0, order=0).deviation[0] == pytest.approx(
        ChannelNoise.fitted(pieces, freedom=0.0, order=0).deviation[0] * np.sqrt(2.0)
    )


def test_a_gap_and_the_end_of_a_window_begin_a_new_stretch():
    t = np.concatenate([np.arange(10), np.arange(15, 30)]) * 0.1
    window = (t >= 2.0).astype(int)
    channel = Channel(
        name="a_x", rows=slice(5, 30), t=t, window=window, record=np.zeros(25, int), weight=np.zeros(25)
    )
    assert stretches(channel, offset=100) == [slice(105, 115), slice(115, 120), slice(120, 130)]


def test_stamps_that_come_after_one_period_and_after_two_by_turns_are_no_gaps():
    """Else every second sample begins a stretch, no noise has a memory, and all that it does is evidence."""
    t = np.cumsum(np.tile([0.02, 0.04], 30))
    row = np.zeros(60, int)
    channel = Channel(name="a_x", rows=slice(0, 60), t=t, window=row, record=row, weight=np.zeros(60))
    assert stretches(channel) == [slice(0, 60)]
    lost = np.arange(60) * 0.02 + 0.02 * (np.arange(60) >= 40)
    channel = Channel(name="a_x", rows=slice(0, 60), t=lost, window=row, record=row, weight=np.zeros(60))
    assert stretches(channel) == [slice(0, 40), slice(40, 60)]


def test_the_parts_of_a_run_lie_apart_and_take_their_shares():
    windows = cut(6000, 0.01)
    last = {use: (windows.first + windows.count)[windows.use == use].max() for use in (FIT, SELECT)}
    begin = {use: windows.first[windows.use == use].min() for use in (SELECT, REPORT)}
    assert begin[SELECT] - last[FIT] >= 500
    assert begin[REPORT] - last[SELECT] >= 500
    length = [windows.count[windows.use == use].sum() for use in (FIT, SELECT, REPORT)]
    assert np.allclose(length / np.sum(length), [0.6, 0.2, 0.2], atol=0.01)
    assert (windows.count >= 300).all()
    assert (windows.count <= 500).all()


def test_windows_keep_out_of_what_cannot_be_simulated():
    usable = np.ones(6000, dtype=bool)
    usable[1500:3000] = False
    windows = cut(6000, 0.01, usable=usable)
    for first, count in zip(windows.first, windows.count, strict=True):
        assert usable[first : first + count].all()
        # What the actuators did in the pause is as unknown as what they did before the log.
        assert not 3000 <= first < 3100
    length = [windows.count[windows.use == use].sum() for use in (FIT, SELECT, REPORT)]
    assert np.allclose(length / np.sum(length), [0.6, 0.2, 0.2], atol=0.01)


def test_stretches_differ_in_their_level_only_where_that_is_asked_for():
    rng = np.random.default_rng(3)
    t = 0.01 * np.arange(800)
    channel = Channel(
        name="a_x", rows=slice(0, 800), t=t, window=(t >= 4.0).astype(int), record=np.zeros(800, int),
        weight=np.zeros(800),
    )  # fmt: skip
    residual = rng.normal(size=800) * np.where(t >= 4.0, 3.0, 1.0)
    noise = AutoregressiveNoise.of_rows([((channel,), 0)]).learned(residual, {})
    white = noise.whiten(residual)
    assert np.std(white[400:]) > 2.0 * np.std(white[:400])
    white = noise.with_levels(residual).whiten(residual)
    assert np.std(white[400:]) == pytest.approx(np.std(white[:400]), rel=0.1)


def test_a_channel_whose_noise_is_unknown_counts_nothing():
    """A course may begin after the fitted windows: its residuals there are no evidence of any size."""
    t, row = 0.01 * np.arange(50), np.zeros(50, int)
    channels = tuple(
        Channel(name=name, rows=slice(50 * i, 50 * i + 50), t=t, window=row, record=row, weight=np.zeros(50))
        for i, name in enumerate(("a_x", "course"))
    )
    fitted, held = (AutoregressiveNoise.of_rows([(own, 0)]) for own in (channels[:1], channels))
    noise = fitted.with_white({"a_x": 2.0}).on(held)
    assert set(noise.pieces) == {"a_x"}
    assert np.array_equal(noise.whiten(np.ones(100)), np.repeat([0.5, 0.0], 50))


def test_second_differences_show_the_noise_of_a_sensor_under_a_smooth_signal_with_jumps():
    rng, t = np.random.default_rng(5), np.linspace(0.0, 10.0, 1000)
    samples = 3.0 * np.sin(t) + (t > 5.0) + 0.02 * rng.standard_normal(len(t))
    assert white_deviation([samples[:400], samples[400:]]) == pytest.approx(0.02, rel=0.1)
    # A channel with lost samples may have no three in a row.
    assert white_deviation([samples[:2], samples[7:8]]) == 0.0
