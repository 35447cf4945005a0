"""One control period of any number of episodes, in one compiled call.

An episode is one record: truth, sensors, beliefs, counters, and what is reported of it. A memory is an
array of such records, so one vehicle and a thousand run through the same compiled code, and give the
same numbers to the last bit. What does not fit a record of fixed size (path, waves, patches of soil)
lies in tables beside it.

The period has three phases, in the order in which information flows; a phase reads what the phases
before it left, and the second one nothing of the truth:

- DRIVE: the truth moves on, and the sensors sample it;
- BELIEVE: navigation and, where it runs on board, the filter of n take in the samples;
- REPORT: the observation, made from beliefs, and the score, made from the truth.
"""

from __future__ import annotations

import logging
import math
from functools import cache

import numba
import numpy as np

from estimators.embedded import ASSUMPTIONS, MEMORY, learn_full, learn_paper, summary
from estimators.navigation import SIZE as NAVIGATION
from estimators.navigation import YAW, V, X, Y, navigate
from offroad_env.observation import PREVIEW, SHOWN, write_observation
from offroad_env.physics import state as at
from offroad_env.physics._jit import cache_folder, inline_kernel, kernel
from offroad_env.physics.contact import NO_ROOT, SUNK
from offroad_env.physics.full_model import WORK_ROWS, full_continue, full_derivative
from offroad_env.physics.numerics import copy_into
from offroad_env.physics.packing import PackedPlant, unpack
from offroad_env.physics.paper_model import paper_advance
from offroad_env.physics.path_kernels import PathTable, project
from offroad_env.physics.sensor_kernels import CHANNELS, GNSS, IMU, WHEEL, ImuMount, sense
from offroad_env.rewards import (
    ENDINGS,
    SHAKE_TIME,
    STANDING,
    TERMS,
    Rules,
    broken_rule,
    reached_goal,
    write_terms,
)

__all__ = [
    "BELIEVE",
    "CONTROL_PERIOD",
    "DRIVE",
    "EPISODE",
    "FIRST_TERM",
    "NOISE_PERIODS",
    "PAPER_FORCE",
    "REPORT",
    "REPORTED",
    "RULES",
    "SAMPLES",
    "announce_compilation",
    "period_full",
    "period_paper",
]

CONTROL_PERIOD = 0.02  #: time between actions [s]
SAMPLES = 2  #: samples of the sensors in a period

DRIVE, BELIEVE, REPORT = 1, 2, 4
#: Periods for which sensor noise is drawn at a time.
NOISE_PERIODS = 32

_GOAL, (_ROLLOVER, _IMMOBILISED, _DIVERGED) = 1, range(len(ENDINGS) - 3, len(ENDINGS))

_STUCK_TIME, _STUCK_DRIVE = 4.0, 0.3  # [s], [-]
_ROLLOVER_TIME = 0.2  # [s]
#: Body force at full drive, per unit of mass [m/s^2]: above the paper's largest, 2.4.
PAPER_FORCE = 3.0

#: What `info` says besides the reward terms: name -> columns of the report.
REPORTED = {
    "n_front": 0,
    "n_rear": 1,
    "sinkage": slice(2, 4),
    "slip": slice(4, 6),
    "cross_track_error": 6,
    "heading_error": 7,
    "progress": 8,
    "speed": 9,
    "time": 10,
    "n_estimate": 11,
    "n_estimate_sd": 12,
    "nis": 13,
    "filter_repairs": 14,
    "shake": 15,
}
#: Column of the first of them; the rest follow in the order of `TERMS`.
FIRST_TERM = 16
_REPORT_SIZE = FIRST_TERM + len(TERMS)

#: One episode.
EPISODE = np.dtype(
    [
        # the truth
        ("state", "f8", at.STATE_SIZE),
        ("warm", "f8", (2, at.CONTACT_SIZE)),
        ("readings", "f8", at.READINGS_SIZE),
        ("sound_state", "f8", at.STATE_SIZE),  # before a step that diverged
        ("sound_readings", "f8", at.READINGS_SIZE),
        ("slope", "f8", at.STATE_SIZE),  # time derivative of the sound state, full model
        ("plant", "f8", ASSUMPTIONS["plant"].shape[0]),
        ("n", "f8"),  # of the base soil
        ("status", "f8"),  # worst contact status of the period
        # where its path, waves, patches and the waves that a map shows end in its table
        ("ds", "f8"),
        ("path_end", "i8"),
        ("waves_end", "i8"),
        ("patches_end", "i8"),
        ("known_end", "i8"),
        # the sensors
        ("errors", "f8", (3, CHANNELS)),
        ("lever", "f8", 3),
        ("rotation", "f8", (3, 3)),
        ("mount", "f8", 2),
        ("every", "i8", 2),  # IMU samples from one sample of wheel speed and GNSS to the next
        ("tick", "i8"),
        ("noise_row", "i8"),
        ("samples", "f8", (SAMPLES, CHANNELS)),
        ("rims", "f8", 2),
        # beliefs
        ("navigation", "f8", NAVIGATION),
        ("covariance", "f8", (NAVIGATION, NAVIGATION)),
        ("filter", MEMORY),
        ("estimate", "f8", 5),  # mean, sd, nis, valid, repairs
        # the episode
        ("phases", "i8"),  # what the next call shall do; 0: nothing
        ("count", "i8"),  # samples of the period, 1 at the start
        ("steps", "i8"),  # steps of the plant per sample, 0 at the start
        ("time", "f8"),
        ("action", "f8", 2),  # the last one
        ("change", "f8"),  # what it differs by from the one before, squared and summed
        ("true_index", "i8"),
        ("seen_index", "i8"),
        ("where", "f8", 3),  # distance along the path, from it, heading error of the true vehicle
        ("tilting_for", "f8"),
        ("stuck_for", "f8"),
        ("mean_square", "f8"),  # running, of the vertical acceleration [m^2/s^4]
        ("report", "f8", _REPORT_SIZE),
        ("ending", "i8"),
    ]
)

#: What holds for every episode of a memory.
RULES = np.dtype(
    [
        ("dt", "f8"),  # step of the plant [s]
        ("limits", "f8", 3),  # steering [rad], drive, brake torque [N m] at full action
        ("mass", "f8"),
        ("tilt", "f8"),  # lateral acceleration that lifts the inner wheels [m/s^2]
        ("axles", "f8", 2),
        ("navigation", "f8", 11),  # `NavigationNoise`
        ("rules", "f8", len(Rules._fields)),
        ("target_speed", "f8"),
        ("weights", "f8", len(TERMS)),
        ("distances", "f8", len(PREVIEW)),
        ("bounds", "f4", (2, SHOWN)),
        ("truth_shown", "i8"),
    ]
)


@cache
def announce_compilation() -> None:
    """Say once, on the log, that the first step will take a while, where nothing is compiled yet."""
    if not numba.config.DISABLE_JIT and not any(cache_folder(__name__).rglob("*.nbi")):
        logging.getLogger("offroad_env").warning(
            "OffroadBekker compiles its physics, which takes half a minute: only once, the result is kept"
        )


@inline_kernel
def _plant(e, table):
    """The true plant of an episode."""
    waves, patches = table[e.path_end : e.waves_end], table[e.waves_end : e.patches_end]
    return unpack(PackedPlant(e.plant[:], waves, patches, None))


@inline_kernel
def _sense(e, noise, i):
    """Sample ``i`` of every sensor."""
    mount = ImuMount(e.lever[:], e.rotation[:], e.mount[0], e.mount[1])
    due = (
        e.every[0] > 0 and e.tick % max(e.every[0], 1) == 0,
        e.every[1] > 0 and e.tick % max(e.every[1], 1) == 0,
    )
    sample, rims = e.samples[:][i], e.rims[:]
    sense(e.state[:], e.readings[:], mount, e.errors[:], noise[e.noise_row], due, sample)
    e.tick += 1
    e.noise_row += 1
    if due[0]:
        copy_into(rims, sample[WHEEL])


@inline_kernel
def _take_action(e, action):
    """Clip to [-1, 1] and remember."""
    steer, drive = min(max(action[0], -1.0), 1.0), min(max(action[1], -1.0), 1.0)
    last = e.action[:]
    e.change = (steer - last[0]) ** 2 + (drive - last[1]) ** 2
    last[0], last[1] = steer, drive


@inline_kernel
def _full_command(rules, action):
    steer, drive = action[0], action[1]
    limits = rules.limits[:]
    return steer * limits[0], max(drive, 0.0) * limits[1], max(-drive, 0.0) * limits[2]


@inline_kernel
def _paper_command(rules, action):
    return action[0] * rules.limits[0], action[1] * PAPER_FORCE * rules.mass, math.nan


@inline_kernel
def _keep_sound(e):
    """What is reported of a diverged episode is its last sound state, never a NaN."""
    if e.status >= NO_ROOT:
        copy_into(e.state[:], e.sound_state[:])
        copy_into(e.readings[:], e.sound_readings[:])
    else:
        copy_into(e.sound_state[:], e.state[:])
        copy_into(e.sound_readings[:], e.readings[:])


@inline_kernel
def _same(x, y):
    apart = 0
    for i in range(x.shape[0]):
        apart += x[i] != y[i]
    return apart == 0


@kernel
def _drive_full(e, rules, table, noise):
    """DRIVE: hold the command for as many samples as the period has; from SUNK on it is broken off."""
    plant, command = _plant(e, table), _full_command(rules, e.action[:])
    state, warm, readings = e.state[:], e.warm[:], e.readings[:]
    work = np.empty((WORK_ROWS, at.READINGS_SIZE))
    slope, last = e.slope[:], work[0][: at.STATE_SIZE]
    if e.steps > 0 and e.status < SUNK and _same(state, e.sound_state[:]):
        copy_into(last, slope)  # the last period has ended with it, and with these readings
    else:
        full_derivative(state, command, plant, warm, last, readings)
    e.samples[:][:] = 0.0
    e.status = 0.0
    for i in range(e.count):
        status = full_continue(state, warm, command, plant, (rules.dt, e.steps), work, readings)
        e.status = max(e.status, status)
        if e.status >= SUNK:
            break
        _sense(e, noise, i)
    copy_into(slope, last)
    _keep_sound(e)


@kernel
def _drive_paper(e, rules, table, noise):
    """`_drive_full` for the paper's model."""
    plant, command = _plant(e, table), _paper_command(rules, e.action[:])
    state, warm, readings = e.state[:], e.warm[:], e.readings[:]
    e.samples[:][:] = 0.0
    e.status = 0.0
    for i in range(e.count):
        status = paper_advance(state, warm, command, plant, rules.dt, e.steps, readings)
        e.status = max(e.status, status)
        if e.status >= SUNK:
            break
        _sense(e, noise, i)
    _keep_sound(e)


@inline_kernel
def _navigate(e, rules, command, i):
    """Sample ``i`` for the navigation filter; the first sample of an episode is taken at the start itself."""
    sample = e.samples[:][i]
    period = CONTROL_PERIOD / SAMPLES if e.steps > 0 else 0.0
    belief = (e.navigation[:], e.covariance[:])
    measured = (sample[IMU], sample[WHEEL], sample[GNSS])
    navigate(belief, measured, command[0], rules.axles[:], rules.navigation[:], period)


@inline_kernel
def _note_estimate(e, assumed):
    mean, sd, nis, valid, repairs = summary(e.filter, assumed)
    estimate = e.estimate[:]
    estimate[0], estimate[1], estimate[2], estimate[3], estimate[4] = mean, sd, nis, valid, repairs


@kernel
def _believe_full(e, rules, table, assumptions):
    """BELIEVE: what the samples and the command tell. The filter knows of the ground what a map shows."""
    command, known = _full_command(rules, e.action[:]), (table[e.patches_end : e.known_end], table[:0])
    if e.status >= SUNK:
        return
    for i in range(e.count):
        _navigate(e, rules, command, i)
        if assumptions is not None:
            sample = e.samples[:][i]
            measured = (sample[IMU], sample[WHEEL])
            learn_full(e.filter, assumptions[0], known, e.navigation[:], measured, command)
    if assumptions is not None:
        _note_estimate(e, assumptions[0])


@kernel
def _believe_paper(e, rules, table, assumptions):
    """`_believe_full` for the paper's model."""
    command, known = _paper_command(rules, e.action[:]), (table[e.patches_end : e.known_end], table[:0])
    if e.status >= SUNK:
        return
    for i in range(e.count):
        _navigate(e, rules, command, i)
        if assumptions is not None:
            sample = e.samples[:][i]
            measured = (sample[IMU], sample[WHEEL])
            learn_paper(e.filter, assumptions[0], known, e.navigation[:], measured, command)
    if assumptions is not None:
        _note_estimate(e, assumptions[0])


@inline_kernel
def _wrapped(angle):
    turns = angle / (2.0 * math.pi)
    return 2.0 * math.pi * (turns - round(turns))


@inline_kernel
def _locate(e, path):
    """Where the true vehicle is on its path."""
    state, where = e.state[:], e.where[:]
    s, error, yaw, _, index = project(path, state[at.X], state[at.Y], e.true_index)
    e.true_index = index
    where[0], where[1], where[2] = s, error, _wrapped(state[at.YAW] - yaw)


@inline_kernel
def _judge(e, rules, speed):
    """How the episode stands, as a number of `ENDINGS`."""
    if e.status >= NO_ROOT:
        return _DIVERGED
    if e.status >= SUNK:
        return _IMMOBILISED
    where = e.where[:]
    moment = (where[0], e.ds * (e.path_end - 1), where[1], speed, math.sqrt(e.mean_square))
    broken = broken_rule(rules.rules[:], moment)
    if broken > 0:
        return broken
    tilting = abs(e.readings[at.A_Y]) > rules.tilt
    e.tilting_for = e.tilting_for + CONTROL_PERIOD if tilting else 0.0
    if e.tilting_for > _ROLLOVER_TIME:
        return _ROLLOVER
    pushing = e.action[1] > _STUCK_DRIVE or rules.rules[4] > 0.5
    stuck = pushing and speed < STANDING
    e.stuck_for = e.stuck_for + CONTROL_PERIOD if stuck else 0.0
    if e.stuck_for > _STUCK_TIME:
        return _IMMOBILISED
    return _GOAL if reached_goal(rules.rules[:], moment) else 0


@inline_kernel
def _observe(e, rules, path, shown):
    estimate, nav, action, rims = e.estimate[:], e.navigation[:], e.action[:], e.rims[:]
    terrain = (estimate[0], estimate[1], estimate[3])
    if rules.truth_shown > 0:
        terrain = (e.readings[at.EXPONENT], 0.0, 1.0)
    measured = (
        rims[0],
        rims[1],
        action[0] * rules.limits[0],
        action[1],
        rules.target_speed,
        terrain[0],
        terrain[1],
        terrain[2],
    )
    e.seen_index = write_observation(
        path,
        (nav[X], nav[Y], nav[YAW], nav[V], e.seen_index),
        e.samples[:][: e.count],
        measured,
        (rules.distances[:], rules.bounds[:], e.ds * (e.path_end - 1)),
        shown,
    )


@kernel
def _report(e, rules, table, shown):
    """REPORT: observation into ``shown``, score and readings into the record."""
    path = PathTable(e.ds, table[: e.path_end])
    readings, report, state = e.readings[:], e.report[:], e.state[:]
    before, started = e.where[0], e.steps > 0
    if e.status < NO_ROOT:
        _locate(e, path)
    speed = math.hypot(state[at.V_X], state[at.V_Y])
    terms = report[FIRST_TERM:]
    terms[:] = 0.0
    if started:
        e.time += CONTROL_PERIOD
        e.mean_square += CONTROL_PERIOD / SHAKE_TIME * (readings[at.A_Z] ** 2 - e.mean_square)
        e.ending = _judge(e, rules, speed)
        failed = e.ending > _GOAL and not (e.ending == _IMMOBILISED and rules.rules[4] > 0.5)
        outcome = (e.where[0] - before, e.where[1], speed, e.change, e.ending == _GOAL, failed)
        scale = (rules.rules[0], rules.target_speed, CONTROL_PERIOD)
        write_terms(outcome, scale, rules.weights[:], terms)
    if e.status < SUNK:
        _observe(e, rules, path, shown)
    front, rear = readings[: at.AXLE], readings[at.AXLE : at.MOTION]
    estimate = e.estimate[:]
    report[0], report[1] = front[at.EXPONENT], rear[at.EXPONENT]
    report[2], report[3] = front[at.SINKAGE], rear[at.SINKAGE]
    report[4], report[5] = front[at.SLIP], rear[at.SLIP]
    report[6], report[7], report[8] = e.where[1], e.where[2], e.where[0]
    report[9], report[10] = speed, e.time
    report[11], report[12] = estimate[0], estimate[1]
    report[13] = estimate[2] if math.isfinite(estimate[2]) else 0.0
    report[14], report[15] = estimate[4], math.sqrt(e.mean_square)


@kernel
def period_full(episodes, rules, tables, noise, actions, shown, assumptions):
    """Move every episode on as its ``phases`` say, full model.

    Parameters
    ----------
    episodes (N,) : of the type `EPISODE`
    rules (1,) : of the type `RULES`
    tables (N, rows, 4) : nodes of the path, waves of the ground, patches of the soil, waves of the ground
        that a map shows, one after the other
    noise (N, NOISE_PERIODS SAMPLES, CHANNELS) : standard normal numbers; a sample takes the next row
    actions (N, 2) : finite; what lies outside [-1, 1] is clipped
    shown (N, SHOWN) float32 : the observations, written
    assumptions (1,) : of the type `ASSUMPTIONS`; None where no filter runs in this call: an edition of its
        own, which is compiled in two thirds of the time
    """
    for i in range(episodes.shape[0]):
        e, r = episodes[i], rules[0]
        if e.phases & DRIVE:
            _take_action(e, actions[i])
            _drive_full(e, r, tables[i], noise[i])
        if e.phases & BELIEVE:
            _believe_full(e, r, tables[i], assumptions)
        if e.phases & REPORT:
            _report(e, r, tables[i], shown[i])


@kernel
def period_paper(episodes, rules, tables, noise, actions, shown, assumptions):
    """`period_full` for the paper's model."""
    for i in range(episodes.shape[0]):
        e, r = episodes[i], rules[0]
        if e.phases & DRIVE:
            _take_action(e, actions[i])
            _drive_paper(e, r, tables[i], noise[i])
        if e.phases & BELIEVE:
            _believe_paper(e, r, tables[i], assumptions)
        if e.phases & REPORT:
            _report(e, r, tables[i], shown[i])
