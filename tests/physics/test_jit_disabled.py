"""The kernels are plain Python underneath: without the compiler they give the same answers.

That keeps them open to a debugger and to coverage, and shows that no result rests on what a
compiler assumed. A reduced set of the physics tests runs again in a process without it.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys

import numba
import pytest

from helpers import REPOSITORY

#: Every kernel is reached by these; the rest repeats the same code with more inputs or more steps.
CHOSEN = (
    "test_wheel_forces_agree_with_adaptive_quadrature_and_brent",
    "test_asking_by_load_and_by_sinkage_is_the_same_question",
    "test_a_reversing_wheel_is_the_mirror_image_of_a_forward_one",
    "test_soil_and_suspension_press_equally_on_any_slope",
    "test_the_past_leaves_no_trace",
    "test_an_input_that_is_no_number_is_a_status",
    "test_hard_ground_gives_at_most_its_friction",
    "test_half_angle_loses_no_digits_at_small_angles",
    "test_inputs_are_taken_at_the_half_steps_too",
    "test_coasting_on_a_hard_grade_trades_speed_for_height",
    "test_a_swamp_stops_the_run_with_a_status_and_leaves_finite_numbers",
)
FILES = ("test_wheel_soil", "test_contact", "test_numerics", "test_paper_vehicle", "test_full_vehicle")


@pytest.mark.check
@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled in this process either")
def test_the_physics_is_the_same_without_the_compiler():
    files = [f"tests/physics/{name}.py" for name in FILES]
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "-k",
        " or ".join(CHOSEN),
        *files,
    ]
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=REPOSITORY, env=environment
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
    passed = re.search(r"(\d+) passed", done.stdout)
    assert passed is not None
    assert int(passed.group(1)) >= len(CHOSEN)
