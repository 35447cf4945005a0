"""Rao-Blackwellised particle filter: particles over the soil, a Kalman filter of the state in each.

Given n, the ten states of the paper's model are well described by an extended Kalman filter that
starts settled on that soil; only n itself has a belief with several peaks. Each particle is one n
with such a filter, weighted by the likelihood of what it predicted (A. Doucet, N. de Freitas, K.
Murphy & S. Russell, UAI 2000). A plain filter over all eleven states would need thousands.

The weights stand for a density that is constant between the midpoints of neighbouring particles.
Where few particles carry the weight, new ones are drawn from that density by systematic resampling:
this is the regularisation that keeps a soil that never changes from being left with one particle.
The state of a new particle lies on the line between its neighbours', since the expected state is a
smooth function of n. A share of the particles is drawn evenly over all soils that have not been ruled
out, and weighted accordingly (defensive sampling, T. Hesterberg, Technometrics 37(2), 1995): the first
tenths of a second are evidence for other soils than the first seconds, and a soil that is lost never
returns. A narrow density needs fewer particles, down to ``least``.

The slopes of motion and reading are renewed every ``refresh`` samples, by the particles in turn:
the vehicle moves some decimetres meanwhile, the ground's shortest wave is 4 m long. The reading that
a particle predicts is never old.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from estimators.filters.belief_history import BeliefHistory
from estimators.filters.gaussian_sum import check_fan, normalise
from estimators.filters.joint_ukf import JointUpdate
from estimators.filters.linearised import condition_mean, linear_step, motion_slopes, reading_slopes
from estimators.models.half_car_on_map import (
    CHANNELS,
    ETA,
    SIZE,
    JointModel,
    JointSettings,
    advance_point,
    check_run,
    present_channels,
    read_point,
    settled_start,
)
from estimators.numerics.bounded import from_range, to_range
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK
from offroad_env.physics.records import FloatArray

__all__ = ["ParticleHistory", "ParticleSettings", "Particles", "particle_density", "run_particles"]

_CHANNELS = len(CHANNELS)
#: Columns of what the filter reports per sample.
(MEAN, SD, LOW, HIGH, NIS, WIDTH, COUNT) = range(7)
_REPORT = 7
#: With a soil that drifts, particles are moved at least this often [s].
_LONGEST_REST = 0.5


@dataclass(frozen=True, kw_only=True)
class ParticleSettings:
    """The particles and when they are drawn anew; prior and noise are those of the bank."""

    joint: JointSettings = field(default_factory=JointSettings)
    n_prior: float = 1.0  #: prior of n: the paper's first guess [-]
    n_prior_sd: float = 0.3  #: its standard deviation [-]
    n_fan: tuple[float, float] = (0.3, 1.3)  #: where the particles stand at the start [-]
    particles: int = 60  #: at the start, and while the belief is wide
    least: int = 16  #: once it is narrow
    scarce: float = 0.4  #: share of effective particles below which new ones are drawn
    defence: float = 0.3  #: share of new particles spread evenly over the soils that are not ruled out
    drop: float = 1e-8  #: weight of a particle below which its soil is ruled out
    refresh: int = 5  #: samples between two linearisations of a particle

    def __post_init__(self) -> None:
        check_fan(self.n_fan, self.joint.n_range)
        if not 4 <= self.least <= self.particles <= 2000:
            raise InvalidParameter(
                f"particles must be 4 <= least <= particles <= 2000, got {self.least} and {self.particles}"
            )
        for name in ("scarce", "defence", "drop"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise InvalidParameter(f"{name} must be in (0, 1), got {getattr(self, name)}")
        if not 1 <= self.refresh <= 20:
            raise InvalidParameter(f"refresh must be in [1, 20], got {self.refresh}")
        if not self.n_prior_sd > 0.0:
            raise InvalidParameter(f"n_prior_sd must be > 0, got {self.n_prior_sd}")


class Particles(NamedTuple):
    """The particles; a weight of 0 (log weight -inf) marks one whose soil does not carry the vehicle."""

    means: FloatArray  #: (K, 11) expected state, and eta
    covs: FloatArray  #: (K, 11, 11) of the state given n: zeros in the row and column of eta
    warms: FloatArray  #: (K, 2, 3)
    motions: FloatArray  #: (K, 11, 11) last slopes of motion
    readings: FloatArray  #: (K, channels, 11) last slopes of the reading
    log_weights: FloatArray  #: (K,)


class _Resampling(NamedTuple):
    """How new particles are drawn."""

    most: int  #: particles while the belief is wide
    least: int  #: once it is narrow
    full: float  #: width of eta over which ``most`` are spread
    defence: float  #: share spread evenly over the soils that are not ruled out
    drop: float  #: weight below which a soil is ruled out


class _Rules(NamedTuple):
    """The settings as the kernels need them."""

    scarce: float
    refresh: int
    drift: float  #: random walk of eta [1/sqrt(s)]
    resampling: _Resampling


class _Draws(NamedTuple):
    """Random numbers of a run."""

    uniform: FloatArray  #: (T,)
    normal: FloatArray  #: (T, K)


class _Density(NamedTuple):
    """A piecewise constant density of eta."""

    order: np.ndarray  #: (K,) particles by eta
    edges: FloatArray  #: (K + 1,) of their cells
    cumulative: FloatArray  #: (K + 1,) weight below each edge


class _Counts(NamedTuple):
    """What happened in a run."""

    repairs: int
    failed: int
    resampled: int
    reached: int  #: sample at which no particle was left, or the number of samples


def _free(count: int) -> Particles:
    return Particles(
        np.empty((count, SIZE)),
        np.zeros((count, SIZE, SIZE)),
        np.zeros((count, 2, 3)),
        np.zeros((count, SIZE, SIZE)),
        np.zeros((count, _CHANNELS, SIZE)),
        np.zeros(count),
    )


def _start(
    model: JointModel, settings: ParticleSettings, pose: tuple[float, float, float], v_x: float
) -> Particles:
    """Particles in equal steps of n, weighted by the prior, each settled on its own soil."""
    low, high = settings.n_fan
    n = low + (np.arange(settings.particles) + 0.5) * (high - low) / settings.particles
    particles, (X, Y, yaw) = _free(settings.particles), pose
    place = (float(X), float(Y), float(yaw))
    for i, exponent in enumerate(n):
        eta = from_range(float(exponent), model.low, model.high)
        start = settled_start(model, eta, 0.0, place, float(v_x))
        particles.means[i], particles.warms[i] = start.mean, start.warm
        if start.status >= SUNK:
            raise SolverFailure(f"the soil with n = {exponent:.3f} does not carry the vehicle: narrow n_fan")
        particles.covs[i, np.arange(ETA), np.arange(ETA)] = np.square(settings.joint.start)
    # Cells of equal width in n: the prior's density is the weight.
    particles.log_weights[:] = -0.5 * ((n - settings.n_prior) / settings.n_prior_sd) ** 2
    normalise(particles.log_weights)
    return particles


@kernel
def _advance(
    particles: Particles, i: int, inputs: FloatArray, z: FloatArray, model: JointModel, anew: bool
) -> JointUpdate:
    """One sample for particle ``i``, in place; ``anew``: with new slopes."""
    point, predicted = particles.means[i], np.empty((1, _CHANNELS))
    warm, F, H = particles.warms[i], particles.motions[i], particles.readings[i]
    if anew:
        status = motion_slopes(point, warm, inputs, model, F)
        status = max(status, reading_slopes(point, warm, inputs[2], model, H, predicted[0]))
    else:
        work, seen = np.empty((3, ETA)), np.empty(at.READINGS_SIZE)
        status = advance_point(point, warm, inputs, model, work, seen)
        status = max(status, read_point(point, warm, inputs[2], model, work, seen, predicted[0]))
    if not (status < SUNK and np.isfinite(F).all() and np.isfinite(H).all() and np.isfinite(predicted).all()):
        return JointUpdate(-math.inf, math.nan, 0, SUNK)
    columns, present, index = present_channels(predicted, z)
    step = linear_step(particles.covs[i], F, H[index].copy(), model.Q, model.R[index])
    if present.shape[0] == 0:
        return JointUpdate(0.0, math.nan, step.repairs, status)
    evidence = condition_mean(point, step, present - columns[0])
    return JointUpdate(evidence.log_likelihood, evidence.nis, step.repairs, status)


@kernel
def particle_density(etas: FloatArray, log_weights: FloatArray) -> _Density:
    """The piecewise constant density of eta that the particles stand for.

    Particles without weight, and whose soil carries no vehicle, keep their cells.
    """
    K = etas.shape[0]
    order = np.argsort(etas)
    edges, cumulative = np.empty(K + 1), np.zeros(K + 1)
    for a in range(1, K):
        edges[a] = 0.5 * (etas[order[a - 1]] + etas[order[a]])
    edges[0] = 2.0 * etas[order[0]] - edges[1]
    edges[K] = 2.0 * etas[order[K - 1]] - edges[K - 1]
    for a in range(K):
        cumulative[a + 1] = cumulative[a] + math.exp(log_weights[order[a]])
    cumulative /= cumulative[K]
    return _Density(order, edges, cumulative)


@kernel
def _quantile(density: _Density, probability: float) -> tuple[float, int]:
    """(eta, cell) of a quantile of the density."""
    edges, cumulative = density.edges, density.cumulative
    cell = min(max(np.searchsorted(cumulative, probability) - 1, 0), edges.shape[0] - 2)
    share = (probability - cumulative[cell]) / max(cumulative[cell + 1] - cumulative[cell], 1e-300)
    return edges[cell] + share * (edges[cell + 1] - edges[cell]), cell


@kernel
def _proposal(density: _Density, defence: float, drop: float) -> tuple[_Density, float, FloatArray]:
    """(proposal density, width of the soils not ruled out, weights of a draw by cell)."""
    edges = density.edges
    widths, weights = np.diff(edges), np.diff(density.cumulative)
    kept = weights > drop
    support = (widths * kept).sum()
    share = (1.0 - defence) * weights + defence * widths * kept / support
    proposal = np.zeros(edges.shape[0])
    for a in range(widths.shape[0]):
        proposal[a + 1] = proposal[a] + share[a]
    gains = np.where(share > 0.0, weights / share, 0.0)
    return _Density(density.order, edges, proposal / proposal[-1]), support, gains


@kernel
def _between(particles: Particles, j: int, beyond: int, eta: float) -> FloatArray:
    """State (11,) expected with ``eta``, on the line from particle ``j`` to its neighbour ``beyond``."""
    mean: FloatArray = particles.means[j].copy()
    apart = particles.means[beyond, ETA] - mean[ETA]
    if abs(apart) > 0.0 and particles.log_weights[beyond] > -math.inf:
        share = (eta - mean[ETA]) / apart
        mean += min(max(share, -1.0), 1.0) * (particles.means[beyond] - particles.means[j])
    mean[ETA] = eta
    return mean


@kernel
def _resample(
    particles: Particles, rules: _Resampling, jitter: float, noise: FloatArray, offset: float
) -> Particles:
    """New particles from the density; ``jitter`` [-] moves them by ``noise`` (K,)."""
    density = particle_density(particles.means[:, ETA], particles.log_weights)
    order, K = density.order, particles.log_weights.shape[0]
    proposal, support, gains = _proposal(density, rules.defence, rules.drop)
    count = min(max(rules.least, math.ceil(rules.most * support / rules.full)), rules.most)
    means, covs, warms = np.empty((count, SIZE)), np.empty((count, SIZE, SIZE)), np.empty((count, 2, 3))
    motions, readings = np.empty((count, SIZE, SIZE)), np.empty((count, _CHANNELS, SIZE))
    log_weights = np.empty(count)
    for i in range(count):
        eta, cell = _quantile(proposal, (i + offset) / count)
        eta += jitter * noise[i]
        j = order[cell]
        beyond = cell + 1 if eta >= particles.means[j, ETA] else cell - 1
        means[i] = _between(particles, j, order[min(max(beyond, 0), K - 1)], eta)
        covs[i], warms[i] = particles.covs[j], particles.warms[j]
        motions[i], readings[i] = particles.motions[j], particles.readings[j]
        log_weights[i] = math.log(max(gains[cell], 1e-300))
    normalise(log_weights)
    return Particles(means, covs, warms, motions, readings, log_weights)


@kernel
def _quantile_of_n(density: _Density, probability: float, model: JointModel) -> float:
    eta, _ = _quantile(density, probability)
    return to_range(eta, model.low, model.high)


@kernel
def _report(particles: Particles, nis: FloatArray, model: JointModel, out: FloatArray) -> None:
    """Mean, sd, 95 % interval, NIS, width of the 99 % interval and number of particles into ``out``."""
    density = particle_density(particles.means[:, ETA], particles.log_weights)
    order, edges, cumulative = density.order, density.edges, density.cumulative
    mean = square = mean_nis = 0.0
    K = order.shape[0]
    for a in range(K):
        w, i = cumulative[a + 1] - cumulative[a], order[a]
        if w > 0.0:
            low = to_range(edges[a], model.low, model.high)
            high = to_range(edges[a + 1], model.low, model.high)
            mean += w * 0.5 * (low + high)
            square += w * (low * low + low * high + high * high) / 3.0  # of a uniform number
            mean_nis += w * nis[i]
    out[MEAN], out[SD] = mean, math.sqrt(max(square - mean * mean, 0.0))
    out[LOW] = _quantile_of_n(density, 0.025, model)
    out[HIGH] = _quantile_of_n(density, 0.975, model)
    out[WIDTH] = _quantile_of_n(density, 0.995, model)
    out[WIDTH] -= _quantile_of_n(density, 0.005, model)
    out[NIS], out[COUNT] = mean_nis, K


@kernel
def _step(
    particles: Particles, k: int, inputs: FloatArray, z: FloatArray, model: JointModel, refresh: int
) -> tuple[FloatArray, int, int]:
    """Sample ``k`` for every particle, in place; returns (nis (K,), repairs, failed)."""
    K = particles.log_weights.shape[0]
    nis, repairs, failed = np.full(K, math.nan), 0, 0
    for i in range(K):
        if particles.log_weights[i] > -math.inf:
            anew = k == 1 or (k + i) % refresh == 0 or particles.motions[i, 0, 0] == 0.0
            step = inputs[2 * k - 2 : 2 * k + 1]
            update = _advance(particles, i, step, z[k], model, anew)
            nis[i] = update.nis
            repairs += update.repairs
            failed += 1 if update.status >= SUNK else 0
            particles.log_weights[i] += update.log_likelihood
    return nis, repairs, failed


@kernel
def _run(
    particles: Particles,
    inputs: FloatArray,
    z: FloatArray,
    model: JointModel,
    rules: _Rules,
    draws: _Draws,
    report: FloatArray,
) -> _Counts:
    """The loop behind `run_particles`."""
    repairs = failed = resampled = rested = 0
    _report(particles, np.full(particles.log_weights.shape[0], math.nan), model, report[0])
    for k in range(1, z.shape[0]):
        nis, repaired, lost = _step(particles, k, inputs, z, model, rules.refresh)
        repairs, failed = repairs + repaired, failed + lost
        if not normalise(particles.log_weights):
            return _Counts(repairs, failed, resampled, k)
        _report(particles, nis, model, report[k])
        rested += 1
        effective = 1.0 / np.exp(2.0 * particles.log_weights).sum()
        moved = rules.drift > 0.0 and rested * model.dt >= _LONGEST_REST
        if effective < rules.scarce * particles.log_weights.shape[0] or moved:
            jitter = rules.drift * math.sqrt(rested * model.dt)
            particles = _resample(particles, rules.resampling, jitter, draws.normal[k], draws.uniform[k])
            resampled, rested = resampled + 1, 0
    return _Counts(repairs, failed, resampled, z.shape[0])


@dataclass(frozen=True, kw_only=True)
class ParticleHistory:
    """Beliefs of a particle filter over a run. Row k belongs to the k-th sample; row 0 is the prior."""

    belief: BeliefHistory  #: about n; the NIS is weighted over the particles
    width: FloatArray  #: (T,) width of the 99 % interval of n: several peaks show here [-]
    count: FloatArray  #: (T,) particles
    resampled: int  #: times that new particles were drawn


def run_particles(
    model: JointModel,
    settings: ParticleSettings,
    inputs: FloatArray,
    z: FloatArray,
    *,
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
    v_x: float,
    seed: int = 0,
) -> ParticleHistory:
    """Filter a whole run with particles that start settled.

    Parameters
    ----------
    model : JointModel
        Of `estimators.models.half_car_on_map.joint_model`, made with ``settings.joint``.
    inputs, z
        As in `estimators.filters.joint_ukf.run_joint_filter`.
    pose : (X, Y, yaw)
        At the start [m, m, rad].
    v_x : float
        Speed at the start [m/s].
    seed : int
        Of the resampling.

    Raises
    ------
    SolverFailure
        When no particle is left that carries the vehicle.
    """
    inputs, z = check_run(inputs, z)
    T, K = len(z), settings.particles
    particles = _start(model, settings, pose, v_x)
    rng = np.random.default_rng(seed)
    draws = _Draws(rng.random(T), rng.normal(size=(T, K)))
    # A particle's n is a number: the drift of the soil is in the resampling.
    Q = model.Q.copy()
    Q[ETA] = 0.0
    etas = np.sort(particles.means[:, ETA])
    full = float((etas[-1] - etas[0]) * K / max(K - 1, 1))
    resampling = _Resampling(K, settings.least, full, float(settings.defence), float(settings.drop))
    rules = _Rules(float(settings.scarce), settings.refresh, float(settings.joint.drift), resampling)
    report = np.empty((T, _REPORT))
    counts = _run(particles, inputs, z, model._replace(Q=Q), rules, draws, report)
    if counts.reached < T:
        raise SolverFailure(f"no particle carries the vehicle at t = {counts.reached * model.dt:.2f} s")
    belief = BeliefHistory(
        t=model.dt * np.arange(T),
        n=report[:, MEAN],
        sd=report[:, SD],
        low=report[:, LOW],
        high=report[:, HIGH],
        nis=report[:, NIS],
        repairs=int(counts.repairs),
        lost=int(counts.failed),
    )
    return ParticleHistory(
        belief=belief,
        width=report[:, WIDTH],
        count=report[:, COUNT].astype(np.int64),
        resampled=int(counts.resampled),
    )
