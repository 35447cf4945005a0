"""The paper's parameter filter over whole runs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from estimators.experiments.buzhardt_tallapragada import ROWS, noisy_imu, row_truth, run_row
from estimators.filters.parameter_ukf import ParameterSettings, run_parameter_filter
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at

#: What a filter may assume that knows the state: the sensors' noise and nothing else.
MATCHED = ParameterSettings(noise=(0.2, 0.2, 0.2, 0.0175, 0.0175), drift=1e-3)


@pytest.fixture(scope="module")
def steered():
    return row_truth(ROWS[6], duration=20.0)


def test_with_a_known_state_the_innovations_are_chi_square(steered):
    run = run_row(ROWS[6], truth=steered, source="known", settings=MATCHED, seed=3)
    nis = run.filter.belief.nis[1:]
    low, high = chi2.ppf([0.001, 0.999], 5 * len(nis))
    assert low < nis.sum() < high


def test_with_a_known_state_the_error_is_what_the_filter_says(steered):
    late = slice(500, None, 100)
    runs = [run_row(ROWS[6], truth=steered, source="known", settings=MATCHED, seed=seed) for seed in range(4)]
    z = np.concatenate([(run.filter.belief.n[late] - steered.n) / run.filter.belief.sd[late] for run in runs])
    # The samples within a run are correlated over about a second: a wide band around 1.
    assert 0.5 < np.sqrt(np.mean(z**2)) < 1.5


def test_the_propagated_position_drifts_away_from_the_truth():
    truth = row_truth(ROWS[0], duration=60.0)
    run = run_row(ROWS[0], truth=truth)
    apart = np.hypot(*(run.filter.states[:, [at.X, at.Y]] - truth.run.states[:, [at.X, at.Y]]).T)
    assert apart[0] == 0.0
    # Half the wavelength of the terrain along X, 2 pi m: by then its phase is lost.
    assert apart.max() > np.pi


def test_the_prior_for_height_follows_the_prior_for_n():
    truth = row_truth(ROWS[0], duration=0.1)
    run = run_row(ROWS[0], truth=truth)
    # At n = 1 clay carries the wheels centimetres deeper than at its own n = 0.5.
    assert truth.run.states[0, at.Z] - run.filter.states[0, at.Z] > 0.02


def test_an_impossible_sample_is_skipped_and_counted(steered):
    imu = noisy_imu(steered, 0)[:50]
    inputs = steered.inputs[:99].copy()
    inputs[41:44] = np.nan
    start = (steered.run.states[0], np.zeros((2, 3)))
    plant = _plant_of(steered)
    run = run_parameter_filter(plant, start, inputs, imu, 0.01, MATCHED, known=steered.run.states[:50])
    assert run.belief.lost == 2
    assert np.isnan(run.belief.nis[[21, 22]]).all()
    assert np.isfinite(run.belief.n).all()


def test_arrays_that_do_not_belong_together_are_refused(steered):
    start = (steered.run.states[0], np.zeros((2, 3)))
    with pytest.raises(InvalidParameter, match="inputs must have 19"):
        run_parameter_filter(_plant_of(steered), start, steered.inputs[:10], steered.imu[:10], 0.01, MATCHED)


@pytest.mark.parametrize("wrong", [{"n_prior": 2.0}, {"n_prior_sd": 0.0}, {"drift": -1.0}, {"alpha": 0.01}])
def test_settings_out_of_range_are_refused(wrong):
    with pytest.raises(InvalidParameter, match=next(iter(wrong))):
        ParameterSettings(**wrong)


def _plant_of(truth):
    from offroad_env.simulation.simulator import make_plant
    from offroad_env.world.soils import SOILS
    from offroad_env.world.terrain import paper_terrain
    from offroad_env.world.vehicles import VEHICLES

    ground = paper_terrain(truth.row.H0)
    return make_plant(VEHICLES["paper"], SOILS[truth.row.soil], ground, model="paper", slip=truth.slip)
