"""Options that leave nothing to do, or nobody to do it, are refused before anything is driven."""

from __future__ import annotations

import pytest

import agents.benchmark.study as study
from agents.commands.benchmark import BenchmarkRun
from agents.commands.cli import main
from offroad_env.errors import InvalidParameter


@pytest.fixture(autouse=True)
def nothing_is_driven(monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    for name in ("run_study", "run_learned"):
        monkeypatch.setattr(study, name, lambda *_, **__: pytest.fail("it was driven"))


@pytest.mark.parametrize("option", ["scenario", "agents", "forms"])
def test_a_benchmark_of_nothing_is_refused(option, tmp_path, capsys):
    with pytest.raises(SystemExit) as leaving:
        main(["benchmark", f"--{option}", "--out", str(tmp_path)])
    assert leaving.value.code == 1
    assert f"offroad: {option} must name at least one, got none" in capsys.readouterr().err


def test_a_quick_benchmark_of_nobody_is_refused_too(tmp_path):
    with pytest.raises(InvalidParameter, match="agents must name at least one"):
        BenchmarkRun(agents=(), quick=True, out=tmp_path).run()


@pytest.mark.parametrize(
    "command", [("benchmark",), ("compare", "own:Agent"), ("reproduce", "table1"), ("reproduce", "belief")]
)
def test_no_processes_are_refused_in_every_command(command, capsys):
    with pytest.raises(SystemExit) as leaving:
        main([*command, "--jobs", "0"])
    assert leaving.value.code == 2
    said = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert "jobs must be 1 or more, or -1 for all processors, got 0" in said


@pytest.mark.parametrize(("given", "jobs"), [([], 2), (["--jobs", "3"], 3), (["--n-jobs", "-1"], -1)])
def test_other_numbers_of_processes_are_taken_as_joblib_takes_them(given, jobs, monkeypatch):
    seen = []
    monkeypatch.setattr(BenchmarkRun, "run", lambda self: seen.append(self.n_jobs))
    with pytest.raises(SystemExit) as leaving:
        main(["benchmark", *given])
    assert leaving.value.code == 0
    assert seen == [jobs]
