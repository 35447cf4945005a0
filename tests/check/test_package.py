"""The package as a stranger gets it: built, installed into an empty environment, and used."""

from __future__ import annotations

import resource
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from pathlib import Path

import pytest

from helpers import REPOSITORY

pytestmark = pytest.mark.check

#: Processor time from the installed wheel to the first picture [s].
LONGEST = 60.0
PARTS = ("agents", "estimators", "offroad_env", "README.md", "LICENSE", "pyproject.toml")
FIRST_STEP = """
import gymnasium as gym
env = gym.make("offroad_env:OffroadBekker-v0")
env.reset(seed=0)
env.step(env.action_space.sample())
import agents, offroad_env
print(agents.__file__, offroad_env.__file__)
"""


def run(*command: str | Path, cwd: Path) -> str:
    done = subprocess.run(list(map(str, command)), cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    return done.stdout


def spent() -> float:
    """Processor time of all processes that this one has started and that have ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """A folder with the wheel and the source distribution, built from a copy of the sources."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("dist")
    for part in PARTS:
        here = REPOSITORY / part
        if here.is_dir():
            shutil.copytree(here, source / part, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(here, source / part)
    hooks = f"import setuptools.build_meta as b; b.build_sdist({str(out)!r}); b.build_wheel({str(out)!r})"
    run(sys.executable, "-c", hooks, cwd=source)
    return out


def test_the_wheel_holds_data_and_types_and_no_tests(built):
    (wheel,) = built.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    for package in ("agents", "estimators", "offroad_env"):
        assert f"{package}/py.typed" in names
        files = (path for path in (REPOSITORY / package).rglob("*") if path.is_file())
        present = {str(path.relative_to(REPOSITORY)) for path in files if "__pycache__" not in path.parts}
        assert not present - set(names)  # code, templates, recipes, weights, scores: whatever lies there
    assert not any(name.startswith("tests/") for name in names)


def test_the_source_distribution_holds_the_licence(built):
    (sdist,) = built.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        assert any(name.endswith("/LICENSE") for name in archive.getnames())


def test_a_wheel_from_the_source_distribution_is_the_same(built, tmp_path):
    (sdist,) = built.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path, filter="data")
    (source,) = tmp_path.iterdir()
    out = tmp_path / "out"
    out.mkdir()
    hook = f"import setuptools.build_meta as b; b.build_wheel({str(out)!r})"
    run(sys.executable, "-c", hook, cwd=source)
    (wheel,), (again,) = built.glob("*.whl"), out.glob("*.whl")
    assert wheel.name == again.name
    first, second = (zipfile.ZipFile(path) for path in (wheel, again))
    assert set(first.namelist()) == set(second.namelist())
    assert all(
        first.read(name) == second.read(name) for name in first.namelist() if not name.endswith("RECORD")
    )


def test_the_installed_wheel_makes_a_first_step_and_a_first_picture(built, tmp_path):
    """Dependencies are those of the environment that runs this test; the project itself is the wheel's."""
    (wheel,) = built.glob("*.whl")
    run(sys.executable, "-m", "venv", "--without-pip", tmp_path / "venv", cwd=tmp_path)
    python = tmp_path / "venv" / "bin" / "python"
    site = Path(
        run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=tmp_path).strip()
    )
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    run(sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", site, wheel, cwd=tmp_path)
    # Nothing is compiled before, and nothing is to be found: no compiler.
    alone = ("/usr/bin/env", "-i", f"OFFROAD_CACHE={tmp_path / 'cache'}", python, "-I", "-c")
    start = spent()
    files = run(*alone, FIRST_STEP, cwd=tmp_path).split()
    step = spent()
    picture = (
        "from agents.commands.cli import main; main('drive --scenario brake --duration 1 --out .'.split())"
    )
    run(*alone, picture, cwd=tmp_path)
    end = spent()
    print(f"first step {step - start:.1f} s, then first picture {end - step:.1f} s of processor time")
    assert end - start < LONGEST
    assert (tmp_path / "drive_brake_0.png").stat().st_size > 10_000
    assert all(Path(file).is_relative_to(site) for file in files)
    script = "import sys; from offroad_env.launch import main; sys.argv = ['offroad', '--help']; main()"
    text = run(python, "-I", "-c", script, cwd=tmp_path)
    assert "usage: offroad COMMAND" in text
