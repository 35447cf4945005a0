"""The quick form of ``offroad benchmark`` drives model-predictive control on three episodes."""

from __future__ import annotations

import pytest

from agents.benchmark import study
from agents.commands.benchmark import BenchmarkRun


@pytest.mark.parametrize(
    ("tasks", "forms", "driven"),
    [
        (("speed", "patches", "brake"), ("matched", "mismatch"), ("speed", "patches")),
        (("brake",), ("matched",), None),
        (("speed",), ("natural",), None),
    ],
)
def test_it_is_driven_in_the_matched_form_of_the_tasks_that_it_knows(
    tasks, forms, driven, tmp_path, monkeypatch
):
    pytest.importorskip("casadi")
    asked = []
    monkeypatch.setattr(study, "run_study", lambda args, out: asked.append(args) or {})
    run = BenchmarkRun(out=tmp_path, quick=True, tasks=tasks, forms=forms)
    run._show_predictive(run.arguments())
    if driven is None:
        assert not asked
        return
    (args,) = asked
    assert (args.tasks, args.forms, args.episodes) == (driven, ("matched",), 3)
    assert args.agents == ("oracle", "nmpc_truth")
