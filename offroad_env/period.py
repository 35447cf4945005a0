"""One control period of the truth, its sensors and the navigation, in one compiled call."""

from __future__ import annotations

from estimators.navigation import navigate
from offroad_env.physics._jit import kernel
from offroad_env.physics.advance import advance
from offroad_env.physics.contact import SUNK
from offroad_env.physics.sensor_kernels import GNSS, IMU, WHEEL, sense

__all__ = ["drive_period"]


@kernel
def drive_period(truth, command, sensors, navigation, timing, rims, samples):
    """Hold ``command`` for as many sensor samples as ``samples`` has rows.

    Parameters
    ----------
    truth : (state, warm, packed plant, full, readings), advanced in place
    command : see `full_derivative` or `paper_derivative`
    sensors : (mount, errors, noise (S, CHANNELS), due (S, 2))
    navigation : (belief, axles, noise) of the navigation filter; the belief is updated in place
    timing : (dt of a plant step [s], plant steps per sample, sample period [s])
    rims : (2,) last rim speeds, held where the wheel sensor is silent; updated [m/s]
    samples : (S, CHANNELS), filled with what the sensors say

    Returns
    -------
    float
        Worst contact status; from SUNK on the period was broken off.

    Notes
    -----
    Navigation reads ``samples`` and nothing of the truth.
    """
    state, warm, packed, full, readings = truth
    mount, errors, noise, due = sensors
    belief, axles, assumed = navigation
    dt, steps, period = timing
    worst = 0.0
    for i in range(samples.shape[0]):
        worst = max(worst, advance(state, warm, command, packed, full, dt, steps, readings))
        if worst >= SUNK:
            return worst
        sense(state, readings, mount, errors, noise[i], (due[i, 0], due[i, 1]), samples[i])
        if due[i, 0]:
            rims[:] = samples[i, WHEEL]
        measured = (samples[i, IMU], samples[i, WHEEL], samples[i, GNSS])
        navigate(belief, measured, command[0], axles, assumed, period)
    return worst
