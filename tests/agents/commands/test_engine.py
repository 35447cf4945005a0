"""Where runs are computed changes nothing in their results."""

from __future__ import annotations

from dataclasses import replace

import pytest
from joblib import Parallel, delayed

from agents.benchmark.runner import draw_episodes, run_jobs
from agents.commands.cli import main
from agents.commands.engine import EngineError, using_engine
from agents.controllers.arms import make_arm
from offroad_env.errors import InvalidParameter


def driven(n_jobs=2):
    """Results of two arms without what a clock measured: the time of agent and environment."""
    jobs = {name: make_arm(name) for name in ("nominal", "aware")}
    draws = draw_episodes("speed", 2, seed=3)
    limit = {"max_episode_steps": 150}
    results = run_jobs("speed", jobs, draws, n_jobs=n_jobs, env_options=limit)
    return {
        key: [replace(episode, step_time=0.0, env_time=0.0) for episode in result.episodes]
        for key, result in results.items()
    }


@pytest.mark.check
@pytest.mark.filterwarnings("default")
def test_a_local_cluster_of_dask_gives_the_results_of_local_processes():
    pytest.importorskip("dask.distributed")
    from dask.distributed import default_client

    with using_engine("dask"):
        client = default_client()
        on_dask = driven()
        computed = sum(
            len(log) for log in client.run(lambda dask_worker: list(dask_worker.state.log)).values()
        )
    assert computed > 0
    assert on_dask == driven(n_jobs=1)


@pytest.mark.filterwarnings("default")
def test_ray_gives_the_results_of_local_processes():
    pytest.importorskip("ray")
    with using_engine("ray"):
        on_ray = driven()
    assert on_ray == driven(n_jobs=1)


def test_after_the_engine_runs_are_local_again():
    with using_engine("local"):
        assert Parallel(n_jobs=1)(delayed(abs)(i) for i in (-1, 2)) == [1, 2]
    assert Parallel(n_jobs=1)(delayed(abs)(i) for i in (-1, 2)) == [1, 2]


@pytest.mark.parametrize("name", ["spark", "", "local:here", "Dask"])
def test_an_unknown_engine_is_refused_with_the_names_of_the_known(name):
    with pytest.raises(InvalidParameter, match="engine must be one of local, dask, ray"), using_engine(name):
        pass


@pytest.mark.parametrize("kind", ["dask", "ray"])
def test_an_engine_that_is_not_installed_names_what_to_install(monkeypatch, kind):
    import sys

    for name in ("dask.distributed", "ray"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(EngineError, match=rf"pip install offroad-bekker\[{kind}\]"), using_engine(kind):
        pass


def test_the_command_line_takes_the_engine_before_or_behind_the_command(capsys):
    for arguments in (["--engine", "spark", "soil", "--list"], ["soil", "--list", "--engine=spark"]):
        with pytest.raises(SystemExit) as left:
            main(arguments)
        assert left.value.code == 1
        assert "engine must be one of" in capsys.readouterr().err
    with pytest.raises(SystemExit) as left:
        main(["soil", "--list", "--engine", "local"])
    assert left.value.code == 0
    with pytest.raises(SystemExit) as left:
        main(["soil", "--engine"])
    assert left.value.code == 2
