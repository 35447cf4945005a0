"""Fisher information about the soil: does it add up, is it the right one, do estimates reach the bound?"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2

from estimators.experiments.fisher_information import PARAMETERS, Information, Noise, linearise
from estimators.experiments.manoeuvres import MANOEUVRES, manoeuvre, row_manoeuvre
from estimators.experiments.simulated_estimates import estimation_errors
from estimators.models.imu_prediction import step_full_copies, step_paper_copies
from offroad_env.errors import InvalidParameter
from offroad_env.physics.packing import pack
from offroad_env.simulation.sensors import ImuConfig
from offroad_env.simulation.simulator import make_plant, plant_model, settled_state
from offroad_env.world.soils import make_soil
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import VEHICLES

PLANT = make_plant(VEHICLES["mrzr"], make_soil("dry_sand", n=0.8), flat())
#: A start and a motion that are known: then the information is that of the readings alone.
CERTAIN = {"process": (1e-9,) * 7, "start": (1e-9,) * 12}


@pytest.fixture(scope="module")
def lines():
    """Three short drives, each with every partner of n."""
    return {
        (name, second): linearise(manoeuvre(name, PLANT, duration=3.0), ("n", second))
        for name in ("straight", "sine", "slalom")
        for second in ("phi", "k_phi", "c")
    }


def readings_of(drive, plant):
    """Noise-free readings (T, 5) of the same commands on another soil, settled at the start."""
    full = plant_model(plant) == "full"
    step, mount = (step_full_copies if full else step_paper_copies), ImuConfig(body_axes=full).mount()
    state, warm = settled_state(plant, v_x=drive.start[5])
    x, warm, out, n = state[None], warm[None], [], np.full(1, plant.soil.n)
    for command in drive.commands:
        row = np.empty((1, 5))
        step(x, warm, pack(plant), n, tuple(command.tolist()), drive.dt, mount, row)
        out.append(row[0])
    return np.array(out)


@pytest.mark.parametrize("model", ["full", "paper"])
def test_with_a_certain_motion_the_information_is_that_of_the_readings(model):
    """Differences of whole simulations, against the recursion over slopes of single steps."""
    full = model == "full"
    drive = manoeuvre("slalom", PLANT, duration=2.0) if full else row_manoeuvre(3, duration=2.0)
    names = ("n", "phi")
    columns = []
    for name in names:
        parameter = PARAMETERS[name]
        step = 1e-3 * parameter.sd
        high, low = (readings_of(drive, parameter.changed(drive.plant, sign * step)) for sign in (1.0, -1.0))
        columns.append((high - low) / (2.0 * step) / np.array([0.2, 0.2, 0.2, 0.0175, 0.0175]))
    slopes = np.stack([column.ravel() for column in columns], axis=1)
    found = linearise(drive, names, Noise(**CERTAIN)).information.matrix
    assert found == pytest.approx(slopes.T @ slopes, rel=2e-3)


def test_the_information_is_symmetric_and_nowhere_negative(lines):
    for line in lines.values():
        matrix = line.information.matrix
        assert np.array_equal(matrix, matrix.T)
        assert np.linalg.eigvalsh(matrix).min() > 0.0


def test_what_is_less_certain_tells_less(lines):
    sine = manoeuvre("sine", PLANT, duration=3.0)
    usual = lines["sine", "phi"].information.matrix
    for change in ({"accelerometer": 0.4}, {"process": (0.1,) * 7}, {"start": (0.5,) * 12}):
        matrix = linearise(sine, ("n", "phi"), Noise(**change)).information.matrix
        assert np.linalg.eigvalsh(usual - matrix).min() > 0.0
    fixed = linearise(sine, ("n", "phi"), Noise(fix=True)).information.matrix
    assert np.linalg.eigvalsh(fixed - usual).min() > 0.0


def test_independent_drives_add_up(lines):
    one, other = lines["straight", "k_phi"].information, lines["slalom", "k_phi"].information
    both = one + other
    assert np.array_equal(both.matrix, one.matrix + other.matrix)
    assert np.all(np.diag(both.bound) < np.minimum(np.diag(one.bound), np.diag(other.bound)))
    with pytest.raises(InvalidParameter, match="the same parameters"):
        one + lines["slalom", "phi"].information


def test_driving_on_tells_more():
    short, long = (
        linearise(manoeuvre("sine", PLANT, duration=duration), ("n", "c")).information.matrix
        for duration in (1.0, 2.0)
    )
    assert np.linalg.eigvalsh(long - short).min() > 0.0


def test_steering_and_pedal_reveal_what_a_straight_line_hides(lines):
    for second in ("phi", "k_phi", "c"):
        left = [lines[name, second].information.directions[0][-1] for name in ("straight", "sine", "slalom")]
        assert left == sorted(left, reverse=True)
        assert left[0] > 0.8  # a straight line leaves most of the prior


def test_a_straight_line_cannot_tell_n_from_firmness(lines):
    """Pressure is k_phi h^n: at one load a higher n is the same as a softer soil of lower n."""
    information = lines["straight", "k_phi"].information
    _, vectors = information.directions
    n, k_phi = vectors[:, -1] * information.prior_sd
    # k_phi h^n stays the same at the depth h of this vehicle, some centimetres: dn ln h = -d ln k_phi.
    depth = math.exp(-0.01 * k_phi / n)
    assert 0.01 < depth < 0.1
    assert "hidden: n" in information.in_words()


@pytest.mark.parametrize(("name", "second"), [("sine", "phi"), ("slalom", "k_phi")])
def test_estimates_over_noise_seeds_scatter_as_the_bound_says(lines, name, second):
    line = lines[name, second]
    errors = estimation_errors(line, range(24))
    assert np.isfinite(errors).all()
    spread = np.einsum("ij,jk,ik->", errors, np.linalg.inv(line.information.bound), errors)
    # 99.9 % band for 24 estimates of two numbers.
    low, high = chi2.ppf([0.0005, 0.9995], 48)
    assert low < spread < high


def test_without_noise_in_the_prior_and_the_sensors_the_estimate_is_the_truth():
    quiet = Noise(accelerometer=1e-5, gyro=1e-6, process=(1e-7,) * 7, start=(1e-7,) * 12)
    line = linearise(manoeuvre("slalom", PLANT, duration=1.0), ("n", "phi"), quiet)
    assert np.abs(estimation_errors(line, range(2))).max() < 1e-3


def test_words_say_when_a_drive_tells_both_or_little():
    strong = Information(parameters=("n", "phi"), matrix=np.diag([1e5, 1e3]))
    weak = Information(parameters=("n", "phi"), matrix=np.diag([1.0, 1e-3]))
    assert strong.in_words().endswith("this drive tells both")
    assert weak.in_words().endswith("this drive tells little")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: manoeuvre("loop", PLANT), "manoeuvre must be one of straight"),
        (lambda: row_manoeuvre(9), "row must be in 1 ... 8"),
        (
            lambda: linearise(manoeuvre("sine", PLANT, duration=0.1), ("n", "mu")),
            "parameters must be some of",
        ),
        (lambda: linearise(manoeuvre("sine", PLANT, duration=0.1), ("n", "n")), "parameters must be some of"),
    ],
)
def test_what_does_not_exist_is_refused(call, message):
    with pytest.raises(InvalidParameter, match=message):
        call()


def test_every_manoeuvre_of_the_menu_is_driven():
    for name in MANOEUVRES:
        assert manoeuvre(name, PLANT, duration=0.5).duration == pytest.approx(0.5)
