"""The study of adaptation: what learned models find is what they say, and lines count what they say."""

from __future__ import annotations

import numpy as np
import pytest

from agents.studies.adaptation.figure import adaptation_figure
from agents.studies.adaptation.results import FITTED, ONLINE, comparisons, method_lines
from agents.studies.adaptation.study import Adaptation
from estimators.experiments.motion_sequences import AT, STEP, DriveSequence
from offroad_env.errors import InvalidParameter

torch = pytest.importorskip("torch", reason="torch is in the extra rl")

_STEPS = 131


def _toy(brake: float, seed: int) -> DriveSequence:
    """A vehicle that only rolls straight on: its push less a resistance that belongs to the soil."""
    rng = np.random.default_rng(seed)
    push = np.repeat(rng.uniform(0.0, 2.0, 14), 10)[: _STEPS - 1]
    speed = 5.0 + np.concatenate([[0.0], np.cumsum(STEP * (push - brake))])
    true = np.zeros((_STEPS, 5))
    true[:, 0] = speed
    true[:, 1:] = 1e-3 * rng.standard_normal((_STEPS, 4))
    x = np.concatenate([[0.0], np.cumsum(STEP * 0.5 * (speed[1:] + speed[:-1]))])
    place = np.column_stack([x, np.zeros((_STEPS, 2))])
    return DriveSequence(true=true, measured=true, inputs=np.column_stack([0.0 * push, push]), place=place)


def _trained(method: str, rounds: int):
    from agents.studies.adaptation.learned import Choice, tensors_of, train

    soils = np.linspace(0.2, 1.8, 12)
    drives = tensors_of([_toy(brake, i) for i, brake in enumerate(soils)])
    check = tensors_of([_toy(brake, 50 + i) for i, brake in enumerate((0.5, 1.5))])
    return train(Choice(width=16, size=2), method, drives, check, rounds=rounds, seed=1)


@pytest.mark.check
@pytest.mark.parametrize("method", ["function_encoder", "meta_kalman"])
def test_a_learned_model_predicts_an_unseen_soil_once_it_has_driven_on_it(method: str) -> None:
    from agents.studies.adaptation.learned import final_states, tensors_of

    model = _trained(method, 150)
    soils = (0.4, 1.0, 1.6)
    drives = tensors_of([_toy(brake, 90 + i) for i, brake in enumerate(soils)])
    adapted = final_states(model, drives, method, AT[1])
    speed = drives.true[:, round((AT[1] + 3.0) / STEP), 0].numpy()
    start = round(AT[1] / STEP)
    with torch.no_grad():
        without = model.rollout(drives, start, torch.zeros(3, 2))[:, -1, 3].numpy()
    assert np.abs(adapted[:, 3] - speed).mean() < 0.5 * np.abs(without - speed).mean()


def test_least_squares_are_those_of_the_recursion() -> None:
    """The study solves at once what a vehicle would update row by row."""
    from agents.studies.adaptation.learned import Choice, Model, tensors_of

    model = Model(Choice(width=8, size=3), tensors_of([_toy(1.0, 0), _toy(0.5, 1)]))
    rng = torch.Generator().manual_seed(0)
    rows, targets = torch.randn(1, 9, 5, 3, generator=rng), torch.randn(1, 9, 5, generator=rng)
    c, P = torch.zeros(3), torch.eye(3)
    for H, y in zip(rows[0].reshape(-1, 3), targets[0].reshape(-1), strict=True):
        gain = P @ H / (H @ P @ H + 1.0)
        c, P = c + gain * (y - H @ c), P - torch.outer(gain, H @ P)
    np.testing.assert_allclose(model.least_squares(rows, targets)[0].detach(), c, atol=1e-5)


def test_the_filter_of_a_soil_that_does_not_wander_is_least_squares() -> None:
    from agents.studies.adaptation.learned import Choice, Model, tensors_of

    model = Model(Choice(width=8, size=3), tensors_of([_toy(1.0, 0), _toy(0.5, 1)]))
    with torch.no_grad():
        model.log_walk.fill_(-20.0)
        model.log_noise.fill_(0.0)
        rng = torch.Generator().manual_seed(0)
        rows, targets = torch.randn(2, 9, 5, 3, generator=rng), torch.randn(2, 9, 5, generator=rng)
        np.testing.assert_allclose(
            model.filtered(rows, targets), model.least_squares(rows, targets), atol=1e-4
        )


def _errors() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    sizes = {
        "nominal": 2.0,
        "filter for n": 1.0,
        ONLINE: 0.4,
        FITTED: 0.25,
        "oracle of the soil alone": 0.5,
        "oracle": 0.2,
    }
    sizes |= {"a, 100 soils": 0.6, "b, 100 soils": 0.5}
    return {name: size * rng.uniform(0.9, 1.1, (50, len(AT), 2)) for name, size in sizes.items()}


def test_the_belief_is_compared_with_the_better_learned_model_on_the_same_drives() -> None:
    errors = _errors()
    found = comparisons(errors, {100: ("a, 100 soils", "b, 100 soils")})
    by_name = {(*line.methods, line.quantity): line for line in found}
    learned = by_name[ONLINE, "b, 100 soils", "position"]
    assert learned.ratio == pytest.approx(0.8, abs=0.03)
    assert learned.low < learned.ratio < learned.high
    assert learned.met
    assert not by_name[ONLINE, "oracle", "speed"].met
    assert by_name[FITTED, "oracle", "speed"].met
    # Twice the belief's error, and it is worse.
    worse = comparisons({**errors, ONLINE: 2.0 * errors[ONLINE]}, {100: ("a, 100 soils", "b, 100 soils")})
    assert not {(*line.methods, line.quantity): line for line in worse}[
        ONLINE, "b, 100 soils", "position"
    ].met


def test_every_method_is_in_the_figure() -> None:
    lines = method_lines(_errors())
    assert len(lines) == 8 * len(AT)
    assert lines[0].position_low < lines[0].position < lines[0].position_high
    figure = adaptation_figure(lines, (100,), ("a", "b"))
    assert len(figure.axes[0].get_legend_handles_labels()[1]) == 8


def test_no_training_is_refused(tmp_path) -> None:
    with pytest.raises(InvalidParameter, match="1 or more"):
        Adaptation(out=tmp_path, rounds=0).run()
