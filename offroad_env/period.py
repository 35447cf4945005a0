"""One control period of the truth, its sensors and the navigation, in one compiled call."""

from __future__ import annotations

from estimators.navigation import navigate
from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.contact import SUNK
from offroad_env.physics.full_model import full_advance
from offroad_env.physics.packing import unpack
from offroad_env.physics.paper_model import paper_advance
from offroad_env.physics.sensor_kernels import GNSS, IMU, WHEEL, sense

__all__ = ["drive_full", "drive_paper"]


@inline_kernel
def _watch(truth, command, sensors, navigation, period, i):
    """Sample ``i`` of every sensor, then navigation, which reads the sample and nothing of the truth."""
    state, _, _, readings = truth
    mount, errors, noise, due, rims, samples = sensors
    belief, axles, assumed = navigation
    sense(state, readings, mount, errors, noise[i], (due[i, 0], due[i, 1]), samples[i])
    if due[i, 0]:
        rims[:] = samples[i, WHEEL]
    measured = (samples[i, IMU], samples[i, WHEEL], samples[i, GNSS])
    navigate(belief, measured, command[0], axles, assumed, period)


@kernel
def drive_full(truth, command, sensors, navigation, timing):
    """Hold ``command`` for as many sensor samples as there are rows to fill, full model.

    Parameters
    ----------
    truth : (state, warm, packed plant, readings), advanced in place
    command : see `full_derivative`
    sensors : (mount, errors, noise (S, CHANNELS), due (S, 2), rims (2,), samples (S, CHANNELS));
        ``samples`` is filled with what the sensors say, ``rims`` holds the last rim speeds [m/s]
    navigation : (belief, axles, noise) of the navigation filter; the belief is updated in place
    timing : (dt of a plant step [s], plant steps per sample, sample period [s])

    Returns
    -------
    float
        Worst contact status; from SUNK on the period was broken off.
    """
    state, warm, packed, readings = truth
    dt, steps, period = timing
    plant = unpack(packed)
    worst = 0.0
    for i in range(sensors[5].shape[0]):
        worst = max(worst, full_advance(state, warm, command, plant, dt, steps, readings))
        if worst >= SUNK:
            return worst
        _watch(truth, command, sensors, navigation, period, i)
    return worst


@kernel
def drive_paper(truth, command, sensors, navigation, timing):
    """`drive_full` for the paper's model; ``command`` see `paper_derivative`."""
    state, warm, packed, readings = truth
    dt, steps, period = timing
    plant = unpack(packed)
    worst = 0.0
    for i in range(sensors[5].shape[0]):
        worst = max(worst, paper_advance(state, warm, command, plant, dt, steps, readings))
        if worst >= SUNK:
            return worst
        _watch(truth, command, sensors, navigation, period, i)
    return worst
