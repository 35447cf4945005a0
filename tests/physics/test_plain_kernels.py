"""Where numba's inner parts are others than those known, kernels are plain ones with the same numbers."""

from __future__ import annotations

import os
import subprocess
import sys

import numba
import pytest

from helpers import REPOSITORY, run_fresh
from offroad_env.physics import _jit

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")

PROGRAM = """
from offroad_env.physics.numerics import sin_cos
print(type(sin_cos).__name__, *map(repr, sin_cos(0.7)))
"""


@pytest.mark.parametrize(
    ("version", "known"), [("0.60.0", False), ("0.68.1", True), ("0.69.0", False), ("1.0", False)]
)
def test_only_known_versions_of_numba_have_kernels_in_two_editions(monkeypatch, version, known):
    monkeypatch.setattr(numba, "__version__", version)
    assert (_jit._staged.__wrapped__() is not None) is known


def test_plain_kernels_give_the_same_numbers(tmp_path):
    environment = {**os.environ, "OFFROAD_KERNELS": "plain", "OFFROAD_CACHE": str(tmp_path)}
    command = [sys.executable, "-c", PROGRAM]
    plain = subprocess.run(
        command, cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=True
    ).stdout.split()
    usual = run_fresh(PROGRAM).split()
    assert (plain[0], usual[0]) == ("CPUDispatcher", "Kernel")
    assert plain[1:] == usual[1:]
