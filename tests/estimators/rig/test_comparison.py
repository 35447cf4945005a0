"""Wheel rig: signs and units of the published file, the model on it, honest intervals."""

from __future__ import annotations

import csv
import json
import math

import numpy as np
import pytest
from scipy.io import savemat

from agents.reports.figures.rig_structures import rig_structures_figure
from agents.reports.figures.wheel_rig import wheel_rig_figure
from estimators.rig.cmu_soil_bin import CMU_WHEEL, load_cmu_single_wheel
from estimators.rig.comparison import CHANNELS, compare, predict
from estimators.rig.structures import compare_structures, structure_names
from estimators.rig.trials import RigTrials, longitudinal_slip
from offroad_env.errors import DataError, InvalidParameter
from offroad_env.simulation.wheel import wheel_forces
from offroad_env.world.soils import SOILS, make_soil

SAND = SOILS["cmu_sand"]


def _trials(slip, slip_angle, load=20.0, condition=None, **measured) -> RigTrials:
    slip, slip_angle, load = np.broadcast_arrays(np.asarray(slip, float), slip_angle, load)
    zero = np.zeros(slip.shape)
    names = ("drawbar", "side_force", "sinkage", "load_sd", "drawbar_sd", "side_force_sd", "sinkage_sd")
    values = {name: measured.get(name, zero) for name in names}
    return RigTrials(
        slip=slip.astype(float),
        slip_angle=slip_angle.astype(float),
        load=load.astype(float),
        travel_speed=zero + 0.01,
        rim_speed=zero + 0.01,
        condition=np.arange(slip.size) if condition is None else np.asarray(condition),
        **values,
    )


def _perfect_trials(soil=SAND) -> RigTrials:
    """What a rig without noise would measure if the model were true."""
    slip, angle = (a.ravel() for a in np.meshgrid([-1.0, -0.4, 0.0, 0.5, 0.9], [0.0, -0.4, -1.0]))
    forces = wheel_forces(soil, CMU_WHEEL, load=20.0, slip=slip, slip_angle=angle)
    return _trials(slip, angle, drawbar=forces.F_x, side_force=forces.F_y, sinkage=forces.sinkage)


def _cmu_records(lacking: str = "") -> np.ndarray:
    """Four records as the published file has them: forces on the sensor, mm, mm/s, degrees."""
    values = {"avg_Fx": 8.0, "std_Fx": 0.5, "avg_Fy": 4.0, "std_Fy": 0.6, "avg_Fz": -21.0, "std_Fz": 0.7}
    values |= {"avg_Vx": 10.0, "avg_Vry": 20.0, "avg_Z": -25.0, "std_Z": 0.01, "beta": 0.0, "Vry": 20.0}
    values.pop(lacking, None)
    records = np.zeros(4, dtype=[(name, "O") for name in values])
    for i in range(4):
        records[i] = tuple((values | {"beta": 30.0 * (i % 2)}).values())
    return records


def _write(path, records, name="all_results"):
    savemat(path, {name: records})
    return path


# --- slip -------------------------------------------------------------------------------------------


def test_slip_uses_the_speed_along_the_wheel():
    # At 60 degrees half of the travel is along the wheel: 10 mm/s of rim against 5 mm/s is slip 0.5.
    assert longitudinal_slip(0.01, 0.01, math.radians(60.0)) == pytest.approx(0.5, abs=1e-12)
    assert longitudinal_slip(0.0, 0.01, 0.0) == -1.0
    assert longitudinal_slip(0.005, 0.01, 0.0) == pytest.approx(-0.5)


def test_slip_does_not_exist_sideways():
    slip = longitudinal_slip(np.array([0.0, 0.01, 0.1]), 0.01, np.full(3, -0.5 * np.pi))
    assert np.isnan(slip).all()


# --- reading ------------------------------------------------------------------------------------------


def test_signs_and_units_of_the_published_records(tmp_path):
    trials = load_cmu_single_wheel(_write(tmp_path / "a.mat", _cmu_records()), published=False)
    assert len(trials) == 4
    assert trials.side_force[0] == 8.0
    assert trials.drawbar[0] == -4.0
    assert trials.load[0] == 21.0
    assert trials.sinkage[0] == pytest.approx(0.025)
    assert (trials.travel_speed[0], trials.rim_speed[0]) == (0.010, 0.020)
    assert trials.slip[0] == pytest.approx(0.5)
    assert trials.slip_angle[1] == pytest.approx(-math.radians(30.0))
    assert trials.slip[1] == pytest.approx(1.0 - 0.5 * math.cos(math.radians(30.0)))
    assert list(trials.condition) == [0, 1, 0, 1]


def test_publishers_file_agrees_with_the_printed_table(offroad_data):
    folder = offroad_data("cmu_single_wheel")
    trials = load_cmu_single_wheel(folder / "original" / "all_grouser_data.mat")
    with (folder / "wheel_forces.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(trials) == 189
    pairs = {
        "Fx_drawbar_N": trials.drawbar,
        "Fx_std_N": trials.drawbar_sd,
        "Fy_side_N": trials.side_force,
        "Fy_std_N": trials.side_force_sd,
        "Fz_load_N": trials.load,
        "sinkage_m": trials.sinkage,
        "sinkage_std_m": trials.sinkage_sd,
        "travel_speed_m_s": trials.travel_speed,
        "rim_speed_m_s": trials.rim_speed,
        "slip_longitudinal": trials.slip,
    }
    for name, ours in pairs.items():
        printed = np.array([float(row[name]) if row[name] else np.nan for row in rows])
        # Printed to six significant digits.
        np.testing.assert_allclose(ours, printed, rtol=6e-6, atol=1e-12, err_msg=name)
    commanded = np.radians([-float(row["slip_angle_cmd_deg"]) for row in rows])
    np.testing.assert_allclose(trials.slip_angle, commanded, atol=1e-12)
    _, repeats = np.unique(trials.condition, return_counts=True)
    assert (len(repeats), set(repeats)) == (63, {3})


def test_missing_file_says_how_to_get_it(tmp_path):
    with pytest.raises(DataError, match="offroad data get"):
        load_cmu_single_wheel(tmp_path / "none.mat")


def test_wrong_content_is_named(tmp_path):
    with pytest.raises(DataError, match="no records named all_results"):
        load_cmu_single_wheel(_write(tmp_path / "a.mat", _cmu_records(), name="other"), published=False)
    with pytest.raises(DataError, match="no records"):
        load_cmu_single_wheel(_write(tmp_path / "b.mat", np.arange(3.0)), published=False)
    records = _cmu_records(lacking="std_Fx")
    with pytest.raises(DataError, match="lack the fields std_Fx"):
        load_cmu_single_wheel(_write(tmp_path / "c.mat", records), published=False)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("avg_Fz", np.nan, "avg_Fz of record 3 is nan"),
        ("avg_Fz", 21.0, "avg_Fz of record 3 is 21"),
        ("avg_Vx", 0.01, "another unit"),
        ("avg_Z", -2500.0, "another unit"),
        ("beta", "thirty", "not a number"),
        ("std_Fx", np.array([1.0, 2.0]), "not a number"),
    ],
)
def test_bad_value_is_named_with_field_and_record(tmp_path, field, value, message):
    records = _cmu_records()
    records[field][2] = value
    with pytest.raises(DataError, match=message):
        load_cmu_single_wheel(_write(tmp_path / "a.mat", records), published=False)


def test_only_the_published_bytes_reach_the_reader(tmp_path):
    """SciPy's reader can crash on damaged bytes: they are refused before it sees them."""
    other = _write(tmp_path / "a.mat", _cmu_records())
    with pytest.raises(DataError, match=r"not the published all_grouser_data\.mat"):
        load_cmu_single_wheel(other)


def test_one_damaged_byte_is_refused(offroad_data, tmp_path):
    data = bytearray((offroad_data("cmu_single_wheel") / "original" / "all_grouser_data.mat").read_bytes())
    data[20000] ^= 1
    (tmp_path / "damaged.mat").write_bytes(data)
    with pytest.raises(DataError, match="damaged, or another version"):
        load_cmu_single_wheel(tmp_path / "damaged.mat")
    (tmp_path / "short.mat").write_bytes(data[:30000])
    with pytest.raises(DataError, match="30000 bytes, expected 35014"):
        load_cmu_single_wheel(tmp_path / "short.mat")


def test_what_is_no_matlab_file_is_told(tmp_path):
    for name, content in (("text.mat", b"slip,sinkage\n0.1,0.2\n" * 20), ("empty.mat", b"")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(DataError, match="not a readable MATLAB file"):
            load_cmu_single_wheel(tmp_path / name, published=False)


# --- prediction and scores --------------------------------------------------------------------------


def test_model_reproduces_its_own_trials():
    comparison = compare(_perfect_trials(), SAND, CMU_WHEEL, resamples=100)
    assert comparison.inside == comparison.trials == 15
    for channel in CHANNELS:
        # One solve against the same solve: only rounding.
        assert comparison.scores[channel.name].rmse < 1e-9
    np.testing.assert_allclose(comparison.conditions.residual, 0.0, atol=1e-9)


def test_a_wrong_soil_shows_with_the_right_sign():
    softer = make_soil("cmu_sand", k_phi=4e6)
    comparison = compare(_perfect_trials(softer), SAND, CMU_WHEEL, resamples=100)
    assert comparison.scores["sinkage"].bias > 0.001  # measured deeper than predicted
    low, high = comparison.scores["sinkage"].bias_interval
    assert 0.0 < low <= comparison.scores["sinkage"].bias <= high


def test_side_force_opposes_the_slip_angle_as_the_rig_measures_it(tmp_path):
    trials = load_cmu_single_wheel(_write(tmp_path / "a.mat", _cmu_records()), published=False)
    predicted = predict(trials, SAND, CMU_WHEEL)
    assert predicted.side_force[1] > 0.0
    assert predicted.side_force[0] == pytest.approx(0.0, abs=1e-12)


def test_trials_outside_the_model_are_counted_with_their_reason():
    trials = _trials([0.2, np.nan, 0.3, -1.0], [0.0, -0.5 * np.pi, 0.0, -0.3], load=[20.0, 20.0, 5e4, 20.0])
    prediction = predict(trials, SAND, CMU_WHEEL)
    assert [bool(reason) for reason in prediction.outside] == [False, True, True, False]
    assert np.isnan(prediction.sinkage[[1, 2]]).all()
    assert np.isfinite(prediction.sinkage[[0, 3]]).all()
    comparison = compare(trials, SAND, CMU_WHEEL, resamples=100)
    assert (comparison.trials, comparison.inside) == (4, 2)
    assert sorted(comparison.outside.values()) == [1, 1]
    assert any("90 deg" in reason for reason in comparison.outside)
    with pytest.raises(DataError, match="no trial is inside"):
        compare(trials.subset(np.array([1, 2])), SAND, CMU_WHEEL)


def test_interval_resamples_conditions_not_trials():
    """Repeats that share one error carry no new information: ten of each must not narrow it."""
    rng = np.random.default_rng(0)
    error = rng.normal(0.0, 0.004, 12)
    base = np.full(12, 0.02) + error
    once = _trials(np.linspace(-0.5, 0.9, 12), 0.0, sinkage=base)
    many = _trials(
        np.repeat(once.slip, 10), 0.0, sinkage=np.repeat(base, 10), condition=np.repeat(np.arange(12), 10)
    )
    width = {}
    for name, trials in (("once", once), ("many", many)):
        low, high = compare(trials, SAND, CMU_WHEEL, resamples=4000).scores["sinkage"].bias_interval
        width[name] = high - low
    # Same distribution, other random draws: 4000 resamples leave about 2 % of noise in a width.
    assert width["many"] == pytest.approx(width["once"], rel=0.1)


def test_repeat_scatter_is_the_pooled_standard_deviation():
    sinkage = np.array([0.010, 0.012, 0.030, 0.034])
    trials = _trials([0.1, 0.1, 0.5, 0.5], 0.0, sinkage=sinkage, condition=[7, 7, 9, 9])
    comparison = compare(trials, SAND, CMU_WHEEL, resamples=100)
    expected = math.sqrt((0.001**2 * 2 + 0.002**2 * 2) / 2)
    assert comparison.scores["sinkage"].repeat_sd == pytest.approx(expected, rel=1e-9)
    np.testing.assert_allclose(comparison.conditions.measured[:, 0], [0.011, 0.032])
    assert list(comparison.conditions.condition) == [7, 9]


def test_order_of_trials_and_labels_change_nothing():
    trials = _perfect_trials(make_soil("cmu_sand", n=1.2))
    shuffled = trials.subset(np.random.default_rng(1).permutation(len(trials)))
    first, second = (compare(t, SAND, CMU_WHEEL).to_json() for t in (trials, shuffled))
    assert first["scores"]["sinkage"]["rmse"] == pytest.approx(second["scores"]["sinkage"]["rmse"], rel=1e-12)
    assert first["scores"]["drawbar"]["rmse_interval"] == pytest.approx(
        second["scores"]["drawbar"]["rmse_interval"], rel=1e-9
    )


def test_comparison_is_plain_json_and_repeats_for_one_seed():
    trials = _trials([0.2, np.nan], [0.0, -0.5 * np.pi])
    text = json.dumps(compare(trials, SAND, CMU_WHEEL).to_json(), allow_nan=False)
    assert text == json.dumps(compare(trials, SAND, CMU_WHEEL).to_json(), allow_nan=False)
    content = json.loads(text)
    assert content["conditions"]["measured_sd"][0][0] is None  # one repeat has no scatter
    assert content["soil"]["n"] == SAND.n


def test_wrong_arguments_are_refused():
    trials = _perfect_trials()
    with pytest.raises(InvalidParameter, match="resamples"):
        compare(trials, SAND, CMU_WHEEL, resamples=3)
    with pytest.raises(InvalidParameter, match="shear"):
        compare(trials, SAND, CMU_WHEEL, shear="both")
    with pytest.raises(InvalidParameter, match="degrees"):
        compare(trials, SAND, CMU_WHEEL).span("sinkage", 30.0)
    with pytest.raises(InvalidParameter, match="one shape"):
        RigTrials(**{**vars(trials), "load": np.zeros(3)})


# --- the measured gap -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def measured(offroad_data):
    path = offroad_data("cmu_single_wheel") / "original" / "all_grouser_data.mat"
    return compare(load_cmu_single_wheel(path), SAND, CMU_WHEEL)


def test_measured_sinkage_rises_with_slip_where_the_models_is_flat(measured):
    span = measured.span("sinkage")
    assert span["measured"][1] - span["measured"][0] > 0.030
    assert span["predicted"][1] - span["predicted"][0] < 0.006


def test_unslipped_wheel_is_predicted_from_the_plates_alone(measured):
    """Straight and nearly without slip the plate-measured soil gives the measured sinkage."""
    table = measured.conditions
    row = np.flatnonzero((np.abs(table.slip_angle) < 1e-9) & (np.abs(table.slip) < 0.05))
    assert len(row) == 1
    # The zero of the sinkage sensor is known to a few mm.
    assert abs(table.residual[row[0], 0]) < 0.003


def test_what_the_model_cannot_speak_of_is_reported(measured):
    assert (measured.trials, measured.inside) == (189, 162)
    assert list(measured.outside.values()) == [27]
    assert measured.deeper_than_radius == 3
    for channel in CHANNELS:
        score = measured.scores[channel.name]
        assert score.rmse_interval[0] < score.rmse < score.rmse_interval[1]
        assert score.rmse > 5.0 * score.repeat_sd, "the gap is no measurement noise"


# --- figure ---------------------------------------------------------------------------------------------


def test_figure_shows_three_channels_with_units_and_their_residuals(tmp_path):
    figure = wheel_rig_figure(compare(_perfect_trials(), SAND, CMU_WHEEL, resamples=100))
    top = [axes.get_ylabel() for axes in figure.axes[:3]]
    assert top == ["sinkage [mm]", "drawbar pull [N]", "side force [N]"]
    assert all("RMSE" in axes.get_title(loc="left") for axes in figure.axes[3:])
    # Sinkage is drawn in mm: three model lines at the model's own depth.
    drawn = figure.axes[0].get_lines()[0].get_ydata()
    assert 10.0 < np.nanmedian(drawn) < 30.0
    figure.savefig(tmp_path / "rig.png", dpi=40)
    assert (tmp_path / "rig.png").stat().st_size > 5000


# --- structures ---------------------------------------------------------------------------------------


def test_the_ladder_of_structures_explains_the_straight_wheel_in_the_soil_bin_with_nothing_fitted(
    offroad_data,
):
    """Lyasko's slip sinkage, own sinkage and grousers take four fifths of the pull's error straight ahead."""
    path = offroad_data("cmu_single_wheel") / "original" / "all_grouser_data.mat"
    names = ("full", "full,slip_sinkage=lyasko,grouser_height=0.005,pressure_from=own_sinkage", "field")
    assert set(names) <= set(structure_names(["ladder", "field"]))
    found = compare_structures(load_cmu_single_wheel(path), SAND, CMU_WHEEL, names, resamples=100)
    assert len({comparison.inside for comparison in found.values()}) == 1
    plain, best, field = found.values()
    assert best.rmse_at("drawbar", 0.0) < 0.3 * plain.rmse_at("drawbar", 0.0)
    assert best.rmse_at("sinkage", 0.0) < 0.3 * plain.rmse_at("sinkage", 0.0)
    assert field.rmse_at("drawbar", 0.0) > plain.rmse_at("drawbar", 0.0)
    assert len(rig_structures_figure(found).axes) == 6


def test_structures_that_there_are_not_are_refused_by_name():
    with pytest.raises(InvalidParameter, match="at least one"):
        structure_names([])
    with pytest.raises(InvalidParameter, match="gird"):
        structure_names(["full", "gird"])
