"""A Rao-Blackwellised particle filter: particles over the soil, a Kalman filter of the state in each.

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
tenths of a second speak for other soils than the first seconds, and what is lost never returns. A
narrow density needs fewer particles, down to ``least``.

The slopes of motion and reading are renewed every ``refresh`` samples, by the particles in turn:
the vehicle moves some decimetres meanwhile, the ground's shortest wave is 4 m long. What a particle
expects to read is never old.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from estimators.bounds import linear_step, motion_slopes, reading_slopes
from estimators.joint import (
    CHANNELS,
    ETA,
    SIZE,
    JointModel,
    JointSettings,
    advance_point,
    check_run,
    hypothesis,
    measured,
    read_point,
)
from estimators.transforms import from_range, to_range
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK

__all__ = ["ParticleRun", "ParticleSettings", "Particles", "particle_density", "run_particles"]

_CHANNELS = len(CHANNELS)
_LOG_2PI = math.log(2.0 * math.pi)
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
        low, high = self.joint.n_range
        if not low < self.n_fan[0] < self.n_fan[1] < high:
            raise InvalidParameter(f"n_fan must lie inside n_range = ({low}, {high}), got {self.n_fan}")
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

    means: np.ndarray  #: (K, 11) expected state, and eta
    covs: np.ndarray  #: (K, 11, 11) of the state given n: zeros in the row and column of eta
    warms: np.ndarray  #: (K, 2, 3)
    motions: np.ndarray  #: (K, 11, 11) last slopes of motion
    readings: np.ndarray  #: (K, channels, 11) last slopes of the reading
    log_weights: np.ndarray  #: (K,)


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
    particles, place = _free(settings.particles), tuple(float(p) for p in pose)
    for i, exponent in enumerate(n):
        eta = from_range(float(exponent), model.low, model.high)
        status, particles.means[i], _, particles.warms[i] = hypothesis(model, eta, 0.0, place, float(v_x))
        if status >= SUNK:
            raise SolverFailure(f"the soil with n = {exponent:.3f} does not carry the vehicle: narrow n_fan")
        particles.covs[i, np.arange(ETA), np.arange(ETA)] = np.square(settings.joint.start)
    # Cells of equal width in n: the prior's density is the weight.
    particles.log_weights[:] = -0.5 * ((n - settings.n_prior) / settings.n_prior_sd) ** 2
    _normalise(particles.log_weights)
    return particles


@kernel
def _normalise(log_weights):
    """Scale the weights to a sum of 1; false when there is none."""
    top = log_weights.max()
    if not top > -math.inf:
        return False
    log_weights -= top + math.log(np.exp(log_weights - top).sum())
    return True


@kernel
def _advance(particles, i, inputs, z, model, anew):
    """One sample for particle ``i``, in place; returns (log likelihood, nis, repairs, status)."""
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
        return -math.inf, math.nan, 0, SUNK
    columns, present, index = measured(predicted, z)
    A, S, repairs = linear_step(particles.covs[i], F, H[index].copy(), model.Q, model.R[index])
    if present.shape[0] == 0:
        return 0.0, math.nan, repairs, status
    e = np.linalg.solve(S, present - columns[0])
    point += A.T @ e
    nis = e @ e
    log_density = -0.5 * (present.shape[0] * _LOG_2PI + nis)
    for j in range(present.shape[0]):
        log_density -= math.log(S[j, j])
    return log_density, nis, repairs, status


@kernel
def particle_density(etas, log_weights):
    """The piecewise constant density of eta: (order, edges, cumulative weight at the edges).

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
    return order, edges, cumulative


@kernel
def _quantile(density, probability):
    """(eta, cell) of a quantile of the density."""
    _, edges, cumulative = density
    cell = min(max(np.searchsorted(cumulative, probability) - 1, 0), edges.shape[0] - 2)
    share = (probability - cumulative[cell]) / max(cumulative[cell + 1] - cumulative[cell], 1e-300)
    return edges[cell] + share * (edges[cell + 1] - edges[cell]), cell


@kernel
def _proposal(density, defence, drop):
    """(proposal: cumulative at the edges, width of the soils not ruled out, weights of a draw by cell)."""
    _, edges, cumulative = density
    widths, weights = np.diff(edges), np.diff(cumulative)
    kept = weights > drop
    support = (widths * kept).sum()
    share = (1.0 - defence) * weights + defence * widths * kept / support
    proposal = np.zeros(edges.shape[0])
    for a in range(widths.shape[0]):
        proposal[a + 1] = proposal[a] + share[a]
    return proposal / proposal[-1], support, np.where(share > 0.0, weights / share, 0.0)


@kernel
def _between(particles, j, beyond, eta):
    """State (11,) expected with ``eta``, on the line from particle ``j`` to its neighbour ``beyond``."""
    mean = particles.means[j].copy()
    apart = particles.means[beyond, ETA] - mean[ETA]
    if abs(apart) > 0.0 and particles.log_weights[beyond] > -math.inf:
        share = (eta - mean[ETA]) / apart
        mean += min(max(share, -1.0), 1.0) * (particles.means[beyond] - particles.means[j])
    mean[ETA] = eta
    return mean


@kernel
def _resample(particles, rules, jitter, noise, offset):
    """New particles from the density; ``jitter`` [-] moves them by ``noise`` (K,)."""
    most, least, full, defence, drop = rules
    density = particle_density(particles.means[:, ETA], particles.log_weights)
    order, K = density[0], particles.log_weights.shape[0]
    proposal, support, gains = _proposal(density, defence, drop)
    count = min(max(least, math.ceil(most * support / full)), most)
    drawn = (density[0], density[1], proposal)
    means, covs, warms = np.empty((count, SIZE)), np.empty((count, SIZE, SIZE)), np.empty((count, 2, 3))
    motions, readings = np.empty((count, SIZE, SIZE)), np.empty((count, _CHANNELS, SIZE))
    log_weights = np.empty(count)
    for i in range(count):
        eta, cell = _quantile(drawn, (i + offset) / count)
        eta += jitter * noise[i]
        j = order[cell]
        beyond = cell + 1 if eta >= particles.means[j, ETA] else cell - 1
        means[i] = _between(particles, j, order[min(max(beyond, 0), K - 1)], eta)
        covs[i], warms[i] = particles.covs[j], particles.warms[j]
        motions[i], readings[i] = particles.motions[j], particles.readings[j]
        log_weights[i] = math.log(max(gains[cell], 1e-300))
    _normalise(log_weights)
    return means, covs, warms, motions, readings, log_weights


@kernel
def _report(particles, nis, model, out):
    """Mean, sd, 95 % interval, NIS, width of the 99 % interval and number of particles into ``out``."""
    density = particle_density(particles.means[:, ETA], particles.log_weights)
    order, edges, cumulative = density
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
    out[LOW] = to_range(_quantile(density, 0.025)[0], model.low, model.high)
    out[HIGH] = to_range(_quantile(density, 0.975)[0], model.low, model.high)
    out[WIDTH] = to_range(_quantile(density, 0.995)[0], model.low, model.high)
    out[WIDTH] -= to_range(_quantile(density, 0.005)[0], model.low, model.high)
    out[NIS], out[COUNT] = mean_nis, K


@kernel
def _run(particles, inputs, z, model, rules, draws, report):
    """The loop behind `run_particles`; returns (repairs, failed, resampled).

    ``rules`` = (scarce, refresh, drift, those of `_resample`); ``draws`` = (uniform (T,), normal (T, K)).
    """
    scarce, refresh, drift, drawing = rules
    uniform, normal = draws
    repairs = failed = resampled = rested = 0
    _report(particles, np.full(particles.log_weights.shape[0], math.nan), model, report[0])
    for k in range(1, z.shape[0]):
        K = particles.log_weights.shape[0]
        nis, before = np.full(K, math.nan), particles.log_weights.copy()
        for i in range(K):
            if before[i] > -math.inf:
                anew = k == 1 or (k + i) % refresh == 0 or particles.motions[i, 0, 0] == 0.0
                step = inputs[2 * k - 2 : 2 * k + 1]
                log_likelihood, nis[i], repaired, status = _advance(particles, i, step, z[k], model, anew)
                repairs += repaired
                failed += 1 if status >= SUNK else 0
                particles.log_weights[i] += log_likelihood
        if not _normalise(particles.log_weights):
            particles.log_weights[:] = before
            return repairs, failed, resampled, k
        _report(particles, nis, model, report[k])
        rested += 1
        effective = 1.0 / np.exp(2.0 * particles.log_weights).sum()
        moved = drift > 0.0 and rested * model.dt >= _LONGEST_REST
        if effective < scarce * K or moved:
            jitter = drift * math.sqrt(rested * model.dt)
            particles = Particles(*_resample(particles, drawing, jitter, normal[k], uniform[k]))
            resampled, rested = resampled + 1, 0
    return repairs, failed, resampled, z.shape[0]


@dataclass(frozen=True, kw_only=True)
class ParticleRun:
    """What the particles believed. Row k belongs to the k-th sample; row 0 is the prior."""

    n: np.ndarray  #: (T,) mean of n [-]
    sd: np.ndarray  #: (T,) standard deviation of n [-]
    low: np.ndarray  #: (T,) lower end of the 95 % interval of n [-]
    high: np.ndarray  #: (T,) its upper end [-]
    width: np.ndarray  #: (T,) width of the 99 % interval of n: several peaks show here [-]
    nis: np.ndarray  #: (T,) normalised innovation squared, weighted over the particles
    count: np.ndarray  #: (T,) particles
    repairs: int  #: repaired factorisations
    failed: int  #: particles lost because their soil had no contact solution
    resampled: int  #: times that new particles were drawn


def run_particles(
    model: JointModel,
    settings: ParticleSettings,
    inputs: np.ndarray,
    z: np.ndarray,
    *,
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
    v_x: float,
    seed: int = 0,
) -> ParticleRun:
    """Filter a whole run with particles that start settled.

    Parameters
    ----------
    model : JointModel
        Of `joint.joint_model`, made with ``settings.joint``.
    inputs, z
        As in `joint.run_joint_filter`.
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
    draws = (rng.random(T), rng.normal(size=(T, K)))
    # A particle's n is a number: what the soil drifts by is in the resampling.
    Q = model.Q.copy()
    Q[ETA] = 0.0
    etas = np.sort(particles.means[:, ETA])
    full = float((etas[-1] - etas[0]) * K / max(K - 1, 1))
    drawing = (K, settings.least, full, float(settings.defence), float(settings.drop))
    rules = (float(settings.scarce), settings.refresh, float(settings.joint.drift), drawing)
    report = np.empty((T, _REPORT))
    repairs, failed, resampled, reached = _run(
        particles, inputs, z, model._replace(Q=Q), rules, draws, report
    )
    if reached < T:
        raise SolverFailure(f"no particle carries the vehicle at t = {reached * model.dt:.2f} s")
    return ParticleRun(
        n=report[:, MEAN],
        sd=report[:, SD],
        low=report[:, LOW],
        high=report[:, HIGH],
        width=report[:, WIDTH],
        nis=report[:, NIS],
        count=report[:, COUNT].astype(np.int64),
        repairs=int(repairs),
        failed=int(failed),
        resampled=int(resampled),
    )
