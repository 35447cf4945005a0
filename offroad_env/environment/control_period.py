"""One control period of any number of episodes, in one compiled call.

An episode is one record (`episode_records`), and a memory an array of records, so one vehicle and a thousand
run through the same compiled code and give the same numbers to the last bit.

The period has three phases, in the order in which information flows; a phase reads the results of the
phases before it, and the second one nothing of the truth:

- DRIVE: the truth moves on, and the sensors sample it;
- BELIEVE: navigation and, where it runs online, the filter of n take in the samples;
- REPORT: the observation, made from beliefs, and the score, made from the truth.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import numba
import numpy as np

from estimators.filters.navigation import YAW, V, X, Y, navigate
from estimators.filters.online_parameter_step import learn_full, learn_paper, summary
from offroad_env.environment.episode_records import (
    CONTROL_PERIOD,
    CROSS_TRACK_ERROR,
    FILTER_REPAIRS,
    HEADING_ERROR,
    N_ESTIMATE,
    N_ESTIMATE_SD,
    N_FRONT,
    N_REAR,
    NIS,
    PAPER_FORCE,
    PROGRESS,
    REPORTED_TERMS,
    SAMPLES,
    SHAKE,
    SINKAGE_F,
    SINKAGE_R,
    SLIP_F,
    SLIP_R,
    SOIL_WAVES,
    SPEED,
    TIME,
    PeriodArguments,
    PeriodOptions,
)
from offroad_env.environment.observation import Measured, SeenPose, Window, write_observation
from offroad_env.environment.rewards import (
    ENDINGS,
    SHAKE_TIME,
    STANDING,
    Moment,
    Outcome,
    Rules,
    Scale,
    broken_rule,
    reached_goal,
    write_terms,
)
from offroad_env.physics import state as at
from offroad_env.physics._jit import cache_folder, inline_kernel, kernel
from offroad_env.physics._kernel_folder import say_once
from offroad_env.physics.axle import Plant
from offroad_env.physics.contact import NO_ROOT, SUNK
from offroad_env.physics.full_vehicle import WORK_ROWS, full_continue, full_derivative
from offroad_env.physics.imu import GNSS, IMU, WHEEL, WHEEL_F, ImuMount, sense
from offroad_env.physics.numerics import copy_into
from offroad_env.physics.packing import PackedPlant, unpack
from offroad_env.physics.paper_vehicle import paper_advance
from offroad_env.physics.path_geometry import PathTable, project
from offroad_env.physics.records import SoilField
from offroad_env.physics.sensor_errors import sense_with_memory

if TYPE_CHECKING:
    from offroad_env.simulation.drive import Command

__all__ = [
    "BELIEVE",
    "DRIVE",
    "REPORT",
    "announce_compilation",
    "period_full",
    "period_of",
    "period_paper",
]

DRIVE, BELIEVE, REPORT = 1, 2, 4

_GOAL, (_ROLLOVER, _IMMOBILISED, _DIVERGED) = 1, range(len(ENDINGS) - 3, len(ENDINGS))

_STUCK_TIME, _STUCK_DRIVE = 4.0, 0.3  # [s], [-]
_ROLLOVER_TIME = 0.2  # [s]


@cache
def announce_compilation() -> None:
    """Say once, on the log of the main process, that the first step takes a while if nothing is compiled."""
    compiled = not numba.config.DISABLE_JIT
    if compiled and not any(cache_folder(__name__).rglob("*.nbi")):
        say_once(
            "OffroadBekker compiles its physics, which takes half a minute: only once, the result is kept"
        )


@inline_kernel
def _own_field(field: SoilField | None, k: int) -> SoilField | None:
    """The natural soil of episode ``k``; ``field`` has the waves of all of them, one after the other."""
    if field is None:
        return field  # not None: numba's optional records lose count of their arrays
    return SoilField(field.edge, field.patches, field.waves[k * SOIL_WAVES : (k + 1) * SOIL_WAVES])


@inline_kernel
def _plant(e: np.record, table: np.ndarray, options: PeriodOptions, k: int) -> Plant:
    """The true plant of episode ``k``."""
    waves, patches = table[e.path_end : e.waves_end], table[e.waves_end : e.patches_end]
    field = _own_field(options.soil_field, k)
    four_wheel, structure = options.four_wheel, options.structure
    return unpack(PackedPlant(e.plant[:], waves, patches, None, four_wheel, structure, field))


@inline_kernel
def _sense(e: np.record, noise: np.ndarray, sensing: np.ndarray | None, place: tuple[int, int]) -> None:
    """Sample i of every sensor of episode k, ``place`` = (k, i)."""
    k, i = place
    mount = ImuMount(e.lever[:], e.rotation[:], e.body_axes, e.gravity)
    wheel_due = e.wheel_every > 0 and e.tick % max(e.wheel_every, 1) == 0
    gnss_due = e.gnss_every > 0 and e.tick % max(e.gnss_every, 1) == 0
    sample, rims = e.samples[:][i], e.rims[:]
    due, row = (wheel_due, gnss_due), noise[e.noise_row]
    if sensing is None:
        sense(e.state[:], e.readings[:], mount, e.errors[:], row, due, sample)
    elif sensing[k].active > 0.5:
        sense_with_memory(e.state[:], e.readings[:], mount, e.errors[:], row, due, sensing[k], sample)
        wheel_due = not math.isnan(sample[WHEEL_F])
    else:
        sense(e.state[:], e.readings[:], mount, e.errors[:], row, due, sample)
    e.tick += 1
    e.noise_row += 1
    if wheel_due:
        copy_into(rims, sample[WHEEL])


@inline_kernel
def _take_action(e: np.record, action: np.ndarray) -> None:
    """Clip to [-1, 1] and remember."""
    steer, drive = min(max(action[0], -1.0), 1.0), min(max(action[1], -1.0), 1.0)
    last = e.action[:]
    e.change = (steer - last[0]) ** 2 + (drive - last[1]) ** 2
    last[0], last[1] = steer, drive


@inline_kernel
def _full_command(rules: np.record, action: np.ndarray) -> Command:
    steer, drive = action[0], action[1]
    return steer * rules.steer_max, max(drive, 0.0) * rules.drive_max, max(-drive, 0.0) * rules.brake_max


@inline_kernel
def _paper_command(rules: np.record, action: np.ndarray) -> Command:
    return action[0] * rules.steer_max, action[1] * PAPER_FORCE * rules.mass, math.nan


@inline_kernel
def _keep_sound(e: np.record) -> None:
    """What is reported of a diverged episode is its last sound state, never a NaN."""
    if e.status >= NO_ROOT:
        copy_into(e.state[:], e.sound_state[:])
        copy_into(e.readings[:], e.sound_readings[:])
    else:
        copy_into(e.sound_state[:], e.state[:])
        copy_into(e.sound_readings[:], e.readings[:])


@inline_kernel
def _same(x: np.ndarray, y: np.ndarray) -> bool:
    apart = 0
    for i in range(x.shape[0]):
        apart += x[i] != y[i]
    return apart == 0


@kernel
def _drive_full(
    e: np.record, rules: np.record, table: np.ndarray, noise: np.ndarray, options: PeriodOptions, k: int
) -> None:
    """DRIVE: hold the command for as many samples as the period has; from SUNK on it is broken off."""
    plant, command = _plant(e, table, options, k), _full_command(rules, e.action[:])
    state, warm, readings = e.state[:], e.warm[:], e.readings[:]
    work = np.empty((WORK_ROWS, readings.shape[0]))
    slope, last = e.slope[:], work[0][: state.shape[0]]
    if e.steps > 0 and e.status < SUNK and _same(state, e.sound_state[:]):
        copy_into(last, slope)  # the last period has ended with it, and with these readings
    else:
        full_derivative(state, command, plant, warm, last, readings)
    e.samples[:][:] = 0.0
    worst = 0.0
    for i in range(e.count):
        status = full_continue(state, warm, command, plant, (rules.dt, e.steps), work, readings)
        worst = max(worst, status)
        if worst >= SUNK:
            break
        _sense(e, noise, options.sensing, (k, i))
    e.status = worst
    copy_into(slope, last)
    _keep_sound(e)


@kernel
def _drive_paper(
    e: np.record, rules: np.record, table: np.ndarray, noise: np.ndarray, options: PeriodOptions, k: int
) -> None:
    """`_drive_full` for the paper's model."""
    plant, command = _plant(e, table, options, k), _paper_command(rules, e.action[:])
    state, warm, readings = e.state[:], e.warm[:], e.readings[:]
    e.samples[:][:] = 0.0
    worst = 0.0
    for i in range(e.count):
        status = paper_advance(state, warm, command, plant, rules.dt, e.steps, readings)
        worst = max(worst, status)
        if worst >= SUNK:
            break
        _sense(e, noise, options.sensing, (k, i))
    e.status = worst
    _keep_sound(e)


@inline_kernel
def _navigate(e: np.record, rules: np.record, steer: float, i: int) -> None:
    """Sample ``i`` for the navigation filter; the first sample of an episode is taken at the start itself."""
    sample = e.samples[:][i]
    period = CONTROL_PERIOD / SAMPLES if e.steps > 0 else 0.0
    belief = (e.navigation[:], e.covariance[:])
    measured = (sample[IMU], sample[WHEEL], sample[GNSS])
    navigate(belief, measured, steer, rules.axles[:], rules.navigation[:], period)


@inline_kernel
def _note_estimate(e: np.record, assumed: np.record) -> None:
    found, estimate = summary(e.filter, assumed), e.estimate
    estimate.mean, estimate.sd, estimate.nis = found.mean, found.sd, found.nis
    estimate.valid, estimate.repairs = 1.0 if found.valid else 0.0, found.repairs


@kernel
def _believe_full(e: np.record, rules: np.record, table: np.ndarray, assumptions: np.ndarray | None) -> None:
    """BELIEVE: update the filters. Of the ground they have what a map shows."""
    command, known = _full_command(rules, e.action[:]), (table[e.patches_end : e.known_end], table[:0])
    if e.status >= SUNK:
        return
    for i in range(e.count):
        _navigate(e, rules, command[0], i)
        if assumptions is not None:
            sample = e.samples[:][i]
            measured = (sample[IMU], sample[WHEEL])
            learn_full(e.filter, assumptions[0], known, e.navigation[:], measured, command)
    if assumptions is not None:
        _note_estimate(e, assumptions[0])


@kernel
def _believe_paper(e: np.record, rules: np.record, table: np.ndarray, assumptions: np.ndarray | None) -> None:
    """`_believe_full` for the paper's model."""
    command, known = _paper_command(rules, e.action[:]), (table[e.patches_end : e.known_end], table[:0])
    if e.status >= SUNK:
        return
    for i in range(e.count):
        _navigate(e, rules, command[0], i)
        if assumptions is not None:
            sample = e.samples[:][i]
            measured = (sample[IMU], sample[WHEEL])
            learn_paper(e.filter, assumptions[0], known, e.navigation[:], measured, command)
    if assumptions is not None:
        _note_estimate(e, assumptions[0])


@inline_kernel
def _wrapped(angle: float) -> float:
    turns = angle / (2.0 * math.pi)
    return 2.0 * math.pi * (turns - round(turns))


@inline_kernel
def _locate(e: np.record, path: PathTable) -> None:
    """Where the true vehicle is on its path."""
    state = e.state[:]
    s, error, yaw, _, index = project(path, state[at.X], state[at.Y], e.true_index)
    e.true_index = index
    e.progress, e.cross_track_error, e.heading_error = s, error, _wrapped(state[at.YAW] - yaw)


@inline_kernel
def _path_length(e: np.record) -> float:
    length: float = e.ds * (e.path_end - 1)
    return length


@inline_kernel
def _judge(e: np.record, rules: np.record, speed: float) -> int:
    """How the episode stands, as a number of `ENDINGS`."""
    if e.status >= NO_ROOT:
        return _DIVERGED
    if e.status >= SUNK:
        return _IMMOBILISED
    task = Rules(rules.corridor, rules.time_limit, rules.stop_zone, rules.shake_limit, rules.stalling)
    moment = Moment(e.progress, _path_length(e), e.cross_track_error, speed, math.sqrt(e.mean_square))
    broken = broken_rule(task, moment)
    if broken > 0:
        return broken
    tilting = abs(e.readings[at.A_Y]) > rules.tilt
    e.tilting_for = e.tilting_for + CONTROL_PERIOD if tilting else 0.0
    if e.tilting_for > _ROLLOVER_TIME:
        return _ROLLOVER
    pushing = e.action[1] > _STUCK_DRIVE or rules.stalling > 0.5
    stuck = pushing and speed < STANDING
    e.stuck_for = e.stuck_for + CONTROL_PERIOD if stuck else 0.0
    if e.stuck_for > _STUCK_TIME:
        return _IMMOBILISED
    return _GOAL if reached_goal(task, moment) else 0


@inline_kernel
def _observe(e: np.record, rules: np.record, path: PathTable, shown: np.ndarray) -> None:
    estimate, nav, action, rims = e.estimate, e.navigation[:], e.action[:], e.rims[:]
    n, n_sd, valid = estimate.mean, estimate.sd, estimate.valid
    if rules.truth_shown > 0:
        n, n_sd, valid = e.readings[at.EXPONENT], 0.0, 1.0
    steer = action[0] * rules.steer_stated
    e.seen_index = write_observation(
        path,
        SeenPose(nav[X], nav[Y], nav[YAW], nav[V], e.seen_index),
        e.samples[:][: e.count],
        Measured(rims[0], rims[1], steer, action[1], rules.target_speed, n, n_sd, valid),
        Window(rules.distances[:], rules.bounds[:], _path_length(e)),
        shown,
    )


@inline_kernel
def _score(e: np.record, rules: np.record, before: float, speed: float, terms: np.ndarray) -> None:
    """How the episode stands at the end of a period, and the reward ``terms`` of the period."""
    e.time += CONTROL_PERIOD
    e.mean_square += CONTROL_PERIOD / SHAKE_TIME * (e.readings[at.A_Z] ** 2 - e.mean_square)
    e.ending = _judge(e, rules, speed)
    failed = e.ending > _GOAL and not (e.ending == _IMMOBILISED and rules.stalling > 0.5)
    outcome = Outcome(e.progress - before, e.cross_track_error, speed, e.change, e.ending == _GOAL, failed)
    scale = Scale(rules.corridor, rules.target_speed, CONTROL_PERIOD)
    write_terms(outcome, scale, rules.weights[:], terms)


@kernel
def _report(e: np.record, rules: np.record, table: np.ndarray, shown: np.ndarray) -> None:
    """REPORT: observation into ``shown``, score and readings into the record."""
    path = PathTable(e.ds, table[: e.path_end])
    readings, report, state = e.readings[:], e.report[:], e.state[:]
    before = e.progress
    if e.status < NO_ROOT:
        _locate(e, path)
    speed = math.hypot(state[at.V_X], state[at.V_Y])
    terms = report[REPORTED_TERMS]
    terms[:] = 0.0
    if e.steps > 0:
        _score(e, rules, before, speed, terms)
    if e.status < SUNK:
        _observe(e, rules, path, shown)
    front, rear, estimate = readings[: at.AXLE], readings[at.AXLE : at.MOTION], e.estimate
    report[N_FRONT], report[N_REAR] = front[at.EXPONENT], rear[at.EXPONENT]
    report[SINKAGE_F], report[SINKAGE_R] = front[at.SINKAGE], rear[at.SINKAGE]
    report[SLIP_F], report[SLIP_R] = front[at.SLIP], rear[at.SLIP]
    report[CROSS_TRACK_ERROR], report[HEADING_ERROR] = e.cross_track_error, e.heading_error
    report[PROGRESS], report[SPEED], report[TIME] = e.progress, speed, e.time
    report[N_ESTIMATE], report[N_ESTIMATE_SD] = estimate.mean, estimate.sd
    report[NIS] = estimate.nis if math.isfinite(estimate.nis) else 0.0
    report[FILTER_REPAIRS], report[SHAKE] = estimate.repairs, math.sqrt(e.mean_square)


@kernel
def period_full(
    episodes: np.ndarray,
    rules: np.ndarray,
    tables: np.ndarray,
    noise: np.ndarray,
    actions: np.ndarray,
    shown: np.ndarray,
    assumptions: np.ndarray | None,
    options: PeriodOptions,
) -> None:
    """Move every episode on by what its ``phases`` ask for, full model.

    Parameters
    ----------
    episodes (N,) : of an `episode_type`
    rules (N,) : of the type `RULES`
    tables (N, rows, 4) : nodes of the path, waves of the ground, patches of the soil, waves of the ground
        that a map shows, one after the other
    noise (N, NOISE_ROWS, NOISE_COLUMNS) : standard normal numbers; a sample takes the next row
    actions (N, 2) : finite; what lies outside [-1, 1] is clipped
    shown (N, SHOWN) float32 : the observations, written
    assumptions (1,) : of the type `ASSUMPTIONS`; None where no filter runs in this call: an edition of its
        own, which is compiled in two thirds of the time
    options : sensors and laws beyond the default; what is None is compiled away
    """
    for i in range(episodes.shape[0]):
        e, r = episodes[i], rules[i]
        if e.phases & DRIVE:
            _take_action(e, actions[i])
            _drive_full(e, r, tables[i], noise[i], options, i)
        if e.phases & BELIEVE:
            _believe_full(e, r, tables[i], assumptions)
        if e.phases & REPORT:
            _report(e, r, tables[i], shown[i])


@kernel
def period_paper(
    episodes: np.ndarray,
    rules: np.ndarray,
    tables: np.ndarray,
    noise: np.ndarray,
    actions: np.ndarray,
    shown: np.ndarray,
    assumptions: np.ndarray | None,
    options: PeriodOptions,
) -> None:
    """`period_full` for the paper's model."""
    for i in range(episodes.shape[0]):
        e, r = episodes[i], rules[i]
        if e.phases & DRIVE:
            _take_action(e, actions[i])
            _drive_paper(e, r, tables[i], noise[i], options, i)
        if e.phases & BELIEVE:
            _believe_paper(e, r, tables[i], assumptions)
        if e.phases & REPORT:
            _report(e, r, tables[i], shown[i])


_COMPILED: dict[tuple[object, ...], Callable[..., None]] = {}


def period_of(model: str, arguments: PeriodArguments) -> Callable[[], None]:
    """The compiled period of ``model`` for ``arguments``.

    Numba finds the edition for its arguments anew at every call, one microsecond of the twenty that a
    period takes. An episode's arrays keep their types, so for the plain half-car it is found once.
    """
    period: Any = period_full if model == "full" else period_paper
    if numba.config.DISABLE_JIT or any(part is not None for part in arguments.options):
        return partial(period, *arguments)
    key = (model, arguments.episodes.dtype, arguments.assumptions is None)
    if key not in _COMPILED:
        _COMPILED[key] = period.compile(tuple(map(numba.typeof, arguments)))
    return partial(_COMPILED[key], *arguments)
