"""Setting up on a fresh machine: which Python is taken, and which build of torch."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess

import pytest

from helpers import REPOSITORY

NEEDS_MAKE = pytest.mark.skipif(shutil.which("make") is None, reason="this machine has no make")
GPU_REQUIREMENTS = ["filelock", 'nvidia-cudnn-cu13==9.20.0; platform_system == "Linux"']


@pytest.fixture(scope="module")
def install_torch():
    path = REPOSITORY / ".ci" / "install_torch.py"
    spec = importlib.util.spec_from_file_location("install_torch", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def report(version, requires=("filelock", "sympy>=1.13"), platform="linux", machine="x86_64"):
    """The part of pip's installation report that says which torch it would take, and where."""
    return {
        "install": [{"metadata": {"name": "torch", "version": version, "requires_dist": list(requires)}}],
        "environment": {"sys_platform": platform, "platform_machine": machine},
    }


@pytest.mark.parametrize(
    "found",
    [
        pytest.param(report("2.13.0+cpu"), id="labelled-cpu"),
        pytest.param(report("2.13.0", GPU_REQUIREMENTS, "darwin", "arm64"), id="macos"),
        pytest.param(report("2.13.0", GPU_REQUIREMENTS, "win32", "AMD64"), id="windows"),
        pytest.param(report("2.13.0", machine="aarch64"), id="linux-aarch64"),
        pytest.param(
            report("2.13.0", ['nvidia-nccl-cu13; platform_machine == "x86_64"'], machine="aarch64"),
            id="gpu-libraries-of-another-machine",
        ),
        pytest.param(report("2.13.0"), id="rebuilt-without-gpu"),
    ],
)
def test_a_cpu_build_is_taken_from_where_pip_is_configured(install_torch, found):
    assert install_torch.install_command(found) == ["install", "torch==2.13.0"]


@pytest.mark.parametrize(
    "found",
    [
        pytest.param(report("2.13.0", GPU_REQUIREMENTS), id="plain-index-on-linux"),
        pytest.param(report("2.13.0", GPU_REQUIREMENTS, machine="aarch64"), id="gpu-on-aarch64"),
        pytest.param(report("2.13.0", ["cuda-toolkit[cublas]==13.0.3"]), id="cuda-toolkit"),
        pytest.param(report("2.13.0+cu130"), id="labelled-cuda"),
        pytest.param(report("2.13.0+rocm7.1", platform="win32"), id="labelled-rocm"),
        pytest.param({"install": [], "environment": {}}, id="empty-report"),
        pytest.param(None, id="pip-found-nothing"),
    ],
)
def test_anything_else_comes_from_the_cpu_index_of_pytorch(install_torch, found):
    command = install_torch.install_command(found)
    assert command == ["install", "--index-url", "https://download.pytorch.org/whl/cpu", "torch==2.13.0"]


def test_a_failed_installation_of_torch_ends_in_one_sentence(install_torch, monkeypatch, capsys):
    monkeypatch.setattr(install_torch, "is_installed", lambda: False)
    monkeypatch.setattr(install_torch, "ask_pip", lambda: None)
    failure = subprocess.CompletedProcess([], returncode=1)
    monkeypatch.setattr(install_torch.subprocess, "run", lambda *_, **__: failure)
    assert install_torch.main() == 1
    sentence = capsys.readouterr().err
    assert sentence.startswith("OffroadBekker could not install the CPU build of torch 2.13.0")
    assert sentence.count("\n") == 1


def test_no_requirement_names_a_build_of_torch():
    assert "+cpu" not in (REPOSITORY / "pyproject.toml").read_text(encoding="utf-8")


def write_fake_python(folder, name, version, can_make_environments=True):
    """An executable that answers the questions of the Makefile like a Python of that version."""
    program = folder / name
    program.write_text(
        '#!/bin/sh\ncase "$2" in\n'
        f"    *ensurepip*) exit {0 if can_make_environments else 1} ;;\n"
        f"    *version_info*) echo {version} ;;\n"
        "    pip) exit 0 ;;\n"
        "    *) exit 9 ;;\nesac\n"
    )
    program.chmod(0o755)
    return program


def make_environment(venv, *settings, path=None):
    """Run ``make venv`` for an environment in another place, apart from a make that runs these tests."""
    inherited = {
        k: v for k, v in os.environ.items() if not k.startswith(("MAKE", "MFLAGS")) and k != "PYTHON"
    }
    command = ["make", "venv", f"VENV={venv}", *settings]
    return subprocess.run(
        command,
        cwd=REPOSITORY,
        env=inherited | ({"PATH": path} if path else {}),
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


@NEEDS_MAKE
@pytest.mark.parametrize("version", ["2.7", "3.9", "3.10"])
def test_a_python_that_is_too_old_is_refused_with_its_version(tmp_path, version):
    python = write_fake_python(tmp_path, "python", version)
    done = make_environment(tmp_path / "venv", f"PYTHON={python}")
    assert done.returncode != 0
    assert f"OffroadBekker needs Python 3.11 or newer, but found {python} is {version}" in done.stderr
    assert not (tmp_path / "venv").exists()


@NEEDS_MAKE
def test_every_python_on_the_path_is_tried_before_giving_up(tmp_path):
    for name in ("python3.13", "python3.12", "python3.11"):
        (tmp_path / name).write_text("#!/bin/sh\nexit 127\n")
        (tmp_path / name).chmod(0o755)
    write_fake_python(tmp_path, "python3", "3.8")
    done = make_environment(tmp_path / "venv", path=f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    assert done.returncode != 0
    assert "OffroadBekker needs Python 3.11 or newer, but found python3 is 3.8: install" in done.stderr


@NEEDS_MAKE
def test_a_machine_without_python_is_told_what_was_tried(tmp_path):
    done = make_environment(tmp_path / "venv", f"PYTHON={tmp_path / 'absent'}")
    assert done.returncode != 0
    assert f"but found none (tried {tmp_path / 'absent'})" in done.stderr


@NEEDS_MAKE
def test_a_python_without_its_venv_package_is_told_apart_from_an_old_one(tmp_path):
    python = write_fake_python(tmp_path, "python", "3.12", can_make_environments=False)
    done = make_environment(tmp_path / "venv", f"PYTHON={python}")
    assert done.returncode != 0
    assert (
        f"cannot create a virtual environment with {python} (3.12): install its venv package" in done.stderr
    )


@NEEDS_MAKE
def test_a_folder_that_is_no_environment_is_left_alone(tmp_path):
    precious = tmp_path / "venv" / "precious.txt"
    precious.parent.mkdir()
    precious.write_text("keep me")
    done = make_environment(precious.parent)
    assert done.returncode != 0
    assert "will not overwrite" in done.stderr
    assert precious.read_text() == "keep me"


@NEEDS_MAKE
def test_an_environment_that_works_is_kept(tmp_path):
    programs = tmp_path / "venv" / "bin"
    programs.mkdir(parents=True)
    (tmp_path / "venv" / "pyvenv.cfg").touch()
    inside = write_fake_python(programs, "python", "3.12")
    outside = write_fake_python(tmp_path, "python3.13", "3.13")
    done = make_environment(tmp_path / "venv", f"PYTHON={outside}")
    assert done.returncode == 0, done.stderr
    assert f"keeping {tmp_path / 'venv'} (Python 3.12)" in done.stdout
    assert inside.exists()


@NEEDS_MAKE
def test_python_may_keep_its_bytecode_whatever_the_surroundings_say(tmp_path, monkeypatch):
    """Pip leaves that to Python here: else each process of the tests would translate torch anew."""
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    python, seen = tmp_path / "python", tmp_path / "seen"
    python.write_text(f'#!/bin/sh\necho "${{PYTHONDONTWRITEBYTECODE-nothing}}" > "{seen}"\nexit 127\n')
    python.chmod(0o755)
    make_environment(tmp_path / "venv", f"PYTHON={python}")
    assert seen.read_text() == "nothing\n"
