"""The online belief over whole soils: what the soil holds, when more than n is unknown."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from estimators.experiments.soil_belief import BeliefHistory, believe, stuck_at
from estimators.experiments.unknown_soils import SoilRun, draw_run, sloping
from estimators.filters.online import Thinned
from estimators.filters.online_soil_belief import (
    BELIEF_VECTOR,
    POPULATION_RANGE,
    OnlineSoilBelief,
    SoilBeliefSettings,
    population_n,
    population_of,
)
from estimators.filters.protocol import Estimate, Estimator, Pose
from estimators.filters.soil_belief_holds import LIMITS, share_of_slope, sharpen, transform_limits
from estimators.filters.soil_belief_points import BELIEF_NAMES, GRADE, SIZE, N
from offroad_env.errors import InvalidParameter
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.records import Soil
from offroad_env.simulation.drive import simulate_drive
from offroad_env.simulation.sensors import GnssConfig, ImuConfig, SensorSuite, WheelSpeedConfig
from offroad_env.simulation.simulator import Plant, make_plant
from offroad_env.simulation.soil_holds import SoilHolds, soils_hold, what_soil_holds
from offroad_env.world.soils import SOILS
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import VEHICLES

_CAR = VEHICLES["mrzr"]
_START = Pose(0.0, 0.0, 0.0, 5.0)
_RUNS = 8


def _plant(**options) -> Plant:
    return make_plant(_CAR, SOILS["dry_sand"], flat(), **options)


def _filter(**settings) -> OnlineSoilBelief:
    unit, receiver = ImuConfig(kind="specific_force"), GnssConfig(position_sd=1.5)
    chosen = SoilBeliefSettings(**settings)
    return OnlineSoilBelief(_plant(), POPULATION_RANGE, imu=unit, gnss=receiver, settings=chosen)


@cache
def _runs() -> tuple[SoilRun, ...]:
    """Drives of the tuning soils with all nuisances."""
    return tuple(draw_run("nuisances", seed, split="tuning", duration=8.0) for seed in range(_RUNS))


@cache
def _histories(**settings) -> tuple[BeliefHistory, ...]:
    return tuple(believe(run, Thinned(_filter(**settings), 2)) for run in _runs())


def _errors(histories: tuple[BeliefHistory, ...]) -> np.ndarray:
    """(runs, 6) errors of the limits at the end, in standard deviations."""
    found = []
    for run, history in zip(_runs(), histories, strict=True):
        truth = np.zeros(LIMITS)
        transform_limits(run.holds, _CAR.m * GRAVITY, truth)
        found.append((history.centre[-1] - truth) / history.sd[-1])
    return np.array(found)


def _tested(z: np.ndarray) -> np.ndarray:
    """All limits but the best slip, which is no smooth number."""
    return np.delete(z, SoilHolds._fields.index("pull_slip"), axis=1)


def test_it_is_an_estimator_of_n_too() -> None:
    belief = _filter()
    assert isinstance(belief, Estimator)
    mean, sd = population_n()
    found = belief.reset(mean, sd, _START)
    assert found.mean == pytest.approx(mean)
    assert found.sd == pytest.approx(sd)


def test_before_the_drive_the_belief_about_the_limits_is_that_of_the_population() -> None:
    """Against soils drawn from the same normal distribution, one by one, with what they hold."""
    belief = _filter()
    belief.reset(*population_n(), _START)
    mean, cov = population_of()
    rng, soils = np.random.default_rng(1), []
    for lp, n, lc, phi, lK, a_0, b_0 in rng.multivariate_normal(mean, cov, 400).tolist():
        if 0.15 < n < 1.9 and 0.05 < phi < 0.9 and 0.1 < a_0 < 0.6 and -0.3 < b_0 <= 0.0:
            K, modulus = math.exp(min(lK, -2.4)), math.exp(lp) / 0.05**n
            soils.append(
                Soil(0.0, modulus, n, math.exp(lc), phi, K, K, a_0, 0.32, b_0, 0.0, 0.0, 0.0, 0.0, 0.0)
            )
    rows = soils_hold(_plant(), soils)
    rows = rows[np.isfinite(rows).all(axis=1)]
    for name in ("lateral", "resistance", "sinkage", "stopping"):
        values, held = np.log(rows[:, SoilHolds._fields.index(name)]), belief.holds[name]
        assert abs(math.log(held.mean) - np.median(values)) < 0.7 * values.std()
        assert 0.5 < math.log(held.high / held.low) / 3.92 / values.std() < 1.7


def test_a_drive_narrows_the_limits_and_they_hold_the_truth() -> None:
    histories, z = _histories(), _tested(_errors(_histories()))
    assert (np.abs(z) < 1.96).mean() >= 0.85
    first, last = (np.median([h.sd[k] for h in histories], axis=0) for k in (0, -1))
    for name, share in (("lateral", 0.5), ("resistance", 0.25), ("sinkage", 0.4), ("stopping", 0.5)):
        i = SoilHolds._fields.index(name)
        assert last[i] < share * first[i]


def test_the_intervals_are_neither_half_nor_twice_as_wide_as_they_must_be() -> None:
    spread = float(np.sqrt(np.mean(_tested(_errors(_histories())) ** 2)))
    assert 0.5 < spread < 1.5  # 40 numbers of 8 drives: right to a fifth
    # Half the noise that is assumed, and the same intervals do not hold.
    s = SoilBeliefSettings()
    bold = _histories(error=tuple(0.25 * e for e in s.error), settle_time=0.25)
    assert float(np.sqrt(np.mean(_tested(_errors(bold)) ** 2))) > 1.5 * spread


def _fed(belief: OnlineSoilBelief, imu: tuple[float, ...], seconds: float, *, slip: float = 0.0) -> None:
    """Drive straight at 5 m/s by readings that are made up."""
    nothing = np.full(4, np.nan)
    for k in range(round(seconds / belief.dt)):
        fix = np.array([5.0 * k * belief.dt, 0.0, 5.0, 0.0]) if k % 5 == 0 else nothing
        rims = np.full(2, 5.0 * (1.0 + slip))
        belief.update((0.0, 900.0, 0.0), np.array(imu), rims, fix)


_STILL = (0.0, 0.0, 0.0, 0.0, 0.0)
#: A test of the flag with the other two out of the way.
_OFF = {"surprise": 1e9, "misfit": 1e9, "discrepancy": 1e9}


def _alone(test: str, factor: float) -> OnlineSoilBelief:
    """A belief that has passed its time of testing, with one of its tests at ``factor`` times its limit."""
    belief = _filter(**{**_OFF, test: factor * getattr(SoilBeliefSettings(), test)})
    belief.reset(*population_n(), _START)
    _fed(belief, _STILL, 3.5)
    return belief


def test_the_flag_goes_down_when_no_soil_explains_the_readings() -> None:
    """Rims at three times the speed and a turn without steering: no soil of the population does that."""
    belief = _filter(averaging_time=2.0)
    belief.reset(*population_n(), _START)
    _fed(belief, _STILL, 3.5)
    assert belief.is_valid
    assert belief._fresh(1) == pytest.approx(2.0 / 3.5, rel=0.02)
    before = belief.soil[1]
    _fed(belief, (0.0, 0.0, 0.0, 0.0, 0.6), 1.5, slip=2.0)
    assert not belief.is_valid
    assert belief.changes > 0
    # Part of the prior has come back, and what is learnt from now on counts in full.
    assert belief._fresh(1) == 1.0
    assert belief.soil[1][N, N] > 0.8 * before[N, N]


@pytest.mark.parametrize(("factor", "times"), [(0.5, (0.9, 1.1)), (1.0, (1.9, 2.1)), (2.0, (3.9, 4.1))])
def test_the_flag_is_up_after_two_seconds_of_driving_that_passes(
    factor: float, times: tuple[float, float]
) -> None:
    settings = {"test_time": factor * SoilBeliefSettings().test_time, "early_surprise": 1e-9}
    belief = _filter(**settings)
    belief.reset(*population_n(), _START)
    before, after = times
    _fed(belief, _STILL, before)
    assert not belief.is_valid
    _fed(belief, _STILL, after - before + 0.1)
    assert belief.is_valid


@pytest.mark.parametrize(
    ("factor", "valid"), [(0.5, (True, True)), (1.0, (False, True)), (2.0, (False, False))]
)
def test_small_innovations_put_the_flag_up_after_three_fifths_of_a_second(
    factor: float, valid: tuple[bool, bool]
) -> None:
    """Looked at after 0.45 and after 0.9 s."""
    belief = _filter(early_time=factor * SoilBeliefSettings().early_time, early_surprise=5.0)
    belief.reset(*population_n(), _START)
    _fed(belief, _STILL, 0.45)
    first = belief.is_valid
    _fed(belief, _STILL, 0.45)
    assert (first, belief.is_valid) == valid


def test_information_counts_once_for_a_prior_and_as_stated_beyond_it() -> None:
    sd, prior = np.array([2.0, 0.5, 0.5, 3.0]), np.array([2.0, 1.0, 1.0, 2.0])
    sharpen(sd, prior, np.array([3.0, 2.0, 1.0, 3.0]), np.zeros(4), 1.0)
    assert sd == pytest.approx([2.0, 1.0 / math.sqrt(7.0), 0.5, 3.0])


def test_what_a_slope_leaves_unknown_is_not_sharpened() -> None:
    """Of a variance of 0.25 a part of 0.2 is the slope's: the other 0.05 counts 100 times, this once."""
    sd = np.array([0.5])
    sharpen(sd, np.array([1.0]), np.array([100.0]), np.array([0.2]), 1.0)
    assert sd[0] ** 2 == pytest.approx(0.2 + 1.0 / (1.0 + 100.0 * 19.0))
    sd[0] = 0.5
    sharpen(sd, np.array([1.0]), np.array([100.0]), np.array([0.2]), 0.5)
    assert sd[0] ** 2 == pytest.approx(0.4 + 1.0 / (1.0 + 50.0 * 19.0))
    cov = np.zeros((SIZE, SIZE))
    assert share_of_slope(np.array([0.0, 0.0]), cov) == 0.0  # the ground is known
    slopes = np.array([[0.04, 0.01], [0.01, 0.09]])
    cov[GRADE:, GRADE:] = slopes
    shared = np.array([0.02, 0.03])
    assert share_of_slope(shared, cov) == pytest.approx(shared @ np.linalg.solve(slopes, shared))


def test_what_is_learnt_in_more_than_ten_seconds_counts_less_since_errors_last() -> None:
    """A third of a minute on: sqrt(1/2) of what the limits have learnt, about, and half of that of n."""
    own, patient = _filter(grade=0.0), _filter(grade=0.0, averaging_time=1e9)
    known: list[np.ndarray] = []
    for belief in (own, patient):
        before = belief.reset(*population_n(), _START).sd, belief.limits[1]
        _fed(belief, _STILL, 9.5)
        early = belief.limits[1]
        _fed(belief, _STILL, 11.0)
        after = belief.estimate.sd, belief.limits[1]
        gained = [after[0] ** -2 - before[0] ** -2, *(after[1] ** -2 - before[1] ** -2)]
        known += [early, np.array(gained)]
    np.testing.assert_allclose(known[0], known[2])
    shares = known[1] / known[3]
    assert shares[0] == pytest.approx(10.0 / 20.5, rel=0.05)
    assert shares[1:] == pytest.approx((10.0 / 20.5) ** 0.33, rel=0.05)


#: An error just below a limit and one just above it, with the limit halved and doubled.
_BOTH_SIDES = [("below", 0.5, False), ("below", 1.0, True), ("above", 1.0, False), ("above", 2.0, True)]


@pytest.mark.parametrize(("side", "factor", "valid"), _BOTH_SIDES)
def test_the_limit_of_a_turn_without_cause_stands_where_it_should(
    side: str, factor: float, valid: bool
) -> None:
    belief = _alone("surprise", factor)
    _fed(belief, (0.0, 0.0, 0.0, 0.0, {"below": 0.08, "above": 0.12}[side]), 2.0)
    assert belief.is_valid is valid


@pytest.mark.parametrize(("side", "factor", "valid"), _BOTH_SIDES)
def test_a_model_that_errs_by_far_more_than_assumed_is_not_valid(
    side: str, factor: float, valid: bool
) -> None:
    """Accelerations that come and go every second without a cause: their mean is zero."""
    belief, size = _alone("discrepancy", factor), {"below": 0.7, "above": 1.1}[side]
    for k in range(8):
        _fed(belief, (size * (-1.0) ** k, 0.0, 0.0, 0.0, 0.0), 1.0)
    assert belief.is_valid is valid


@pytest.mark.parametrize(("side", "factor", "valid"), _BOTH_SIDES)
def test_sideways_motion_that_no_soil_explains_is_not_valid(side: str, factor: float, valid: bool) -> None:
    """Turns to and fro without steering, by two degrees a second and by three and a half."""
    belief, size = _alone("misfit", factor), {"below": 0.03, "above": 0.06}[side]
    for k in range(6):
        _fed(belief, (0.0, 0.0, 0.0, 0.0, size * (-1.0) ** k), 1.0)
    assert belief.is_valid is valid


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_the_flag_stays_down_for_ten_seconds(factor: float) -> None:
    """Seven and twelve seconds after the last rejection."""
    belief = _filter(rejected_time=factor * SoilBeliefSettings().rejected_time)
    belief.reset(*population_n(), _START)
    _fed(belief, _STILL, 3.5)
    for k in range(6):
        _fed(belief, (0.0, 0.0, 0.0, 0.0, 0.06 * (-1.0) ** k), 1.0)
    assert not belief.is_valid
    _fed(belief, _STILL, 9.0)
    assert belief.is_valid is (factor < 1.0)
    _fed(belief, _STILL, 5.0)
    assert belief.is_valid is (factor <= 1.0)


def test_laws_of_another_structure_are_noticed_and_another_soil_is_not() -> None:
    """The filter has the laws "full"; soils of section "one thing differs" lie inside its prior."""
    up = {}
    for case in ("grid", "K_low", "phi_2"):
        drives = [draw_run(case, seed, split="tuning", duration=8.0) for seed in range(3)]
        flags = [believe(run, Thinned(OnlineSoilBelief(_plant(), POPULATION_RANGE), 2)) for run in drives]
        up[case] = np.mean([history.valid[history.t > 4.0].mean() for history in flags])
    assert up["grid"] < 0.1
    assert min(up["K_low"], up["phi_2"]) > 0.9


def test_an_error_that_lasts_is_learnt_and_its_channel_counts_less() -> None:
    plain, deaf = _filter(grade=0.0), _filter(grade=0.0, memory_time=1e6)
    for belief in (plain, deaf):
        belief.reset(*population_n(), _START)
        for k in range(8):
            _fed(belief, (1.2 * (-1.0) ** k, 0.0, 0.0, 0.0, 0.0), 1.0)
    bias = BELIEF_NAMES.index("bias a_x")
    assert plain.soil[1][bias, bias] > 2.0 * deaf.soil[1][bias, bias]


def test_at_rest_the_belief_holds_and_widens_slowly() -> None:
    belief = _filter()
    belief.reset(*population_n(), _START)
    _fed(belief, (0.0, 0.0, 0.0, 0.0, 0.0), 3.0)
    mean, cov = belief.soil
    belief.navigation.x[3] = 0.0
    for _ in range(50):
        belief.update((0.0, 0.0, 0.0), np.zeros(5), np.zeros(2), np.full(4, np.nan))
    assert belief.held
    later, wider = belief.soil
    np.testing.assert_allclose(later, mean)
    grown = np.diag(wider) / np.diag(cov)
    assert (grown >= 1.0).all()
    assert (grown < 1.2).all()


@pytest.mark.parametrize("gravity", [True, False])
def test_a_slope_without_a_map_is_no_rolling_resistance_where_the_vehicle_turns(gravity: bool) -> None:
    """Round and round on a slope of 6 %: a belief that the ground is level errs, one that is told nothing
    finds the slope. The accelerometer may measure gravity or not."""
    run = _round_drive(gravity)
    found, z = {}, {}
    i = SoilHolds._fields.index("resistance")
    truth = np.zeros(LIMITS)
    transform_limits(run.holds, _CAR.m * GRAVITY, truth)
    for grade in (0.0, SoilBeliefSettings().grade):
        belief = OnlineSoilBelief(
            _plant(),
            POPULATION_RANGE,
            imu=ImuConfig(kind="specific_force" if gravity else "kinematic"),
            settings=SoilBeliefSettings(grade=grade),
        )
        history = believe(run, Thinned(belief, 2))
        found[grade], z[grade] = belief.soil, (history.centre[-1, i] - truth[i]) / history.sd[-1, i]
    slopes = found[SoilBeliefSettings().grade][0][GRADE:]
    np.testing.assert_allclose(slopes, run.slopes, atol=0.025)
    assert abs(z[SoilBeliefSettings().grade]) < 2.6
    np.testing.assert_array_equal(found[0.0][0][GRADE:], 0.0)


def _round_drive(gravity: bool) -> SoilRun:
    """In circles on a slope of 6 % towards X."""
    plant = make_plant(_CAR, SOILS["clay"], sloping((0.06, 0.0)))
    unit = ImuConfig(kind="specific_force" if gravity else "kinematic")
    suite = SensorSuite(imu=unit, wheel=WheelSpeedConfig(), gnss=GnssConfig())

    def turn(t: float, v: float) -> tuple[float, float, float]:
        push = _CAR.m * _CAR.r * (1.5 * (5.0 - v) + 0.9)
        return 0.3, min(max(push, 0.0), _CAR.drive_torque_max), 0.0

    rng = np.random.default_rng(3)
    record = simulate_drive(plant, turn, suite, rng, duration=12.0, speed=5.0)
    held = what_soil_holds(plant)
    return SoilRun("matched", record, held, _START, _plant(), (0.06, 0.0))


def test_straight_ahead_the_resistance_is_known_no_better_than_the_slope() -> None:
    """What is not known of it is gravity along a slope of the stated size."""
    sds = []
    for factor in (0.0, 0.5, 1.0, 2.0):
        belief = _filter(grade=factor * SoilBeliefSettings().grade)
        belief.reset(*population_n(), _START)
        _fed(belief, _STILL, 8.0)
        sds.append(belief.holds["resistance"].sd / (_CAR.m * GRAVITY))
    assert sds[0] < 0.5 * sds[2]
    assert 0.5 * 0.03 < sds[2] < 0.03
    assert sds[1] < 0.75 * sds[2] < 0.7 * sds[3]


def test_a_prior_of_n_takes_the_other_numbers_along_as_in_the_population() -> None:
    mean, cov = population_of()
    other, narrow = population_of(1.2, 0.05)
    assert other[N] == pytest.approx(1.2)
    assert narrow[N, N] == pytest.approx(0.05**2)
    assert other[2] < mean[2]  # cohesion falls with n
    assert np.linalg.eigvalsh(narrow).min() > 0.0
    assert (np.diag(narrow) <= np.diag(cov) + 1e-12).all()
    same, as_wide = population_of(*population_n())
    np.testing.assert_allclose(same, mean)
    np.testing.assert_allclose(as_wide, cov)


def test_the_vector_has_a_name_for_every_number() -> None:
    belief = _filter()
    belief.reset(*population_n(), _START)
    numbers = dict(zip(BELIEF_VECTOR, belief.vector, strict=True))
    assert numbers["lateral"] == belief.holds["lateral"].mean
    assert numbers["stopping_sd"] == belief.holds["stopping"].sd
    assert numbers["n"] == belief.estimate.mean
    assert numbers["valid"] == 0.0  # not tested yet
    assert len(belief.soil[0]) == SIZE


class _Watched(Thinned):
    """Keeps time to a stop and certainty at every sample."""

    risks: list[tuple[float, float, bool]]

    def update(self, *sample) -> Estimate:
        found = super().update(*sample)
        risk = self.inner.immobilisation
        self.risks.append((risk.stop_in, self.inner._certainty(), risk.announced))
        return found


@cache
def _soft() -> tuple[tuple[float, np.ndarray], ...]:
    """Drives on soft soils, the ground known: when they are stuck [s]; time to a stop and certainty."""
    found, belief = [], _Watched(_filter(grade=0.0), 2)
    for seed in range(14):
        run = draw_run("soft_level", seed, split="tuning", duration=12.0)
        belief.risks = []
        believe(run, belief)
        found.append((stuck_at(run), np.array(belief.risks)))
    return tuple(found)


def _alarms(risks: np.ndarray, factor: float) -> np.ndarray:
    """The alarm with ``factor`` times its times."""
    soon, latest = SoilBeliefSettings().stuck
    time = np.minimum(factor * soon * np.exp(np.minimum(risks[:, 1], 5.0)), factor * latest)
    return np.maximum(risks[:, 0], 0.5) < time


@pytest.mark.parametrize(
    ("factor", "most_ahead", "quiet"), [(1.0, True, True), (2.0, True, False), (0.5, False, True)]
)
def test_getting_stuck_is_announced_two_seconds_ahead_and_nothing_else_is(
    factor: float, most_ahead: bool, quiet: bool
) -> None:
    """With twice or half of the times it warns without a cause or too late."""
    ahead, false = [], 0
    for stuck, risks in _soft():
        rows = np.flatnonzero(_alarms(risks, factor))
        warned = 0.01 * (rows[0] + 1) if rows.size else math.inf
        if 3.0 < stuck < math.inf:
            ahead.append(stuck - warned >= 2.0)
        elif stuck == math.inf:
            false += warned < math.inf
        np.testing.assert_array_equal(_alarms(risks, 1.0), risks[:, 2])
    assert len(ahead) >= 3
    assert (np.mean(ahead) > 0.8) == most_ahead
    assert (false == 0) == quiet


def test_wheels_that_slip_beyond_the_best_have_no_pull_in_reserve() -> None:
    """The same loss of speed on the same soil, with wheels that hardly slip and wheels that spin."""
    belief, found = _filter(), []
    belief.reset(*population_n(), _START)
    for rims in (4.1, 12.0):
        belief._note_slip(4.0, rims)
        certain, slow = np.linspace(-8.0, 1.0, 91), []
        for gain in certain:
            belief._speed, belief._gain = 4.0, float(gain)
            slow.append(belief.immobilisation.announced)
        found.append(float(certain[np.flatnonzero(slow)[-1]]) if any(slow) else -math.inf)
    assert found[0] < found[1] < 0.0
    belief._note_slip(4.0, math.nan)  # no sample: what was measured last
    assert belief._slip == pytest.approx(1.0 - 4.0 / 12.0)


def test_who_brakes_is_not_about_to_get_stuck() -> None:
    """The same loss of speed, with brakes that explain it and without them."""
    found = []
    for brake in (0.0, 2.0 * _CAR.m * _CAR.r):
        belief = _filter()
        belief.reset(*population_n(), _START)
        for k in range(60):
            belief._note_loss_of_speed(4.0 - 2.0 * belief.dt * k, brake)
        found.append(belief.immobilisation.stop_in)
    assert found[0] < 5.0
    assert found[1] > 50.0


def test_nobody_is_warned_on_firm_soil_or_while_the_speed_holds() -> None:
    for run, history in zip(_runs(), _histories(), strict=True):
        if run.holds.pull > 0.15 * _CAR.m * GRAVITY:
            assert not history.announced.any()
    belief = _filter()
    belief.reset(*population_n(), _START)
    _fed(belief, (0.0, 0.0, 0.0, 0.0, 0.0), 1.0)
    risk = belief.immobilisation
    assert risk.stop_in > 50.0
    assert not risk.announced


def test_plants_that_it_cannot_work_with_are_refused() -> None:
    for plant in (_plant(model="paper"), _plant(vehicle_model="four_wheel")):
        with pytest.raises(InvalidParameter, match="half-car or bicycle of the full model"):
            OnlineSoilBelief(plant, POPULATION_RANGE)


def test_it_survives_a_mean_soil_that_does_not_carry_the_vehicle() -> None:
    """A prior of soft soils: the vehicle stands all the same."""
    heavy = _plant()._replace(vehicle=_CAR._replace(m=12.0 * _CAR.m))
    belief = OnlineSoilBelief(heavy, POPULATION_RANGE)
    belief.reset(*population_n(), _START)
    _fed(belief, (0.0, 0.0, 0.0, 0.0, 0.0), 0.5)
    assert np.isfinite(belief.vector).all()
