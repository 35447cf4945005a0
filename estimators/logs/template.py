"""A commented YAML for the log of a vehicle, to be filled in."""

from __future__ import annotations

from estimators.logs.checking.mends import yaml_text
from offroad_env.world.descriptions import read_soil, read_vehicle

__all__ = ["log_template"]


def log_template(vehicle: str, soil: str) -> str:
    """The text of a YAML; `read_log` takes it as it is.

    Parameters
    ----------
    vehicle, soil
        Names of the catalogues, or YAML files.

    Raises
    ------
    InvalidParameter, DataError
        For a vehicle or soil that there is not.
    """
    known, ground = read_vehicle(vehicle).record, read_soil(soil).record
    rigid = ground.rigid > 0.5
    return f"""\
# Description of a log: put it beside the data, run.yaml for run.csv (or .parquet, .bag, .mcap).
# offroad log check run.csv lists everything that is missing or wrong, with the lines to add at the end of
# this file.

model: full                # full, or paper (the planar half-car of Buzhardt and Tallapragada)
drivetrain: torque         # what the inputs are: torque at the wheels, or force on the body (model: paper)

vehicle:
  base: {yaml_text(vehicle)}
  # What differs from it; offroad keys vehicle and offroad keys log list all keys.
  # m: {known.m:g}              # mass [kg]
  # l_f: {known.l_f:g}             # from the centre of gravity to the front axle [m]
  # l_r: {known.l_r:g}             # to the rear axle [m]
  # r: {known.r:g}               # radius of the wheels [m]
  # b: {known.b:g}               # width of a wheel [m]
  steer_lag: 0.0           # from steer to the angle of the wheels [s]: 0 if measured there, not commanded
  torque_lag: 0.0          # from the torques to the wheels [s]; likewise

soil:                      # what is believed before the drive{" (hard ground has no n)" if rigid else ""}
  base: {yaml_text(soil)}
{"  # mu: 0.8" if rigid else f"  # n: {ground.n:g}               # sinkage exponent [-]: the prior"}

terrain: {{kind: flat}}      # flat; {{kind: unknown, rms: 0.02}}; {{kind: paper, H0: 0.05}}

imu:
  kinematic: false         # false: a_z reads 9.81 at rest; true: gravity is taken out
  position: [0.0, 0.0, 0.0]  # from the centre of gravity: forward, left, up [m]
  sd: {{a: 0.2, rate: 0.01}}  # noise of a sample [m/s^2, rad/s]; offroad log check measures it
  # orientation: {{yaw: 90 deg}}      # how it is turned on the vehicle, or {{forward: -y, left: x}}
  # rate: 100 Hz                    # brings uneven samples to an even rate

# gnss: {{sd: {{position: 0.05, speed: 0.05}}}}   # noise of x, y [m] and speed [m/s], if there is a receiver
# unknown: [imu.position, gnss.position, suspension]   # what nobody has measured: a diagnosis fits it

inputs: {{hold: zoh}}        # a command holds from its stamp (zoh), or runs straight to the next (linear)
start: log                 # position, heading and speed of the first samples; or {{x, y, yaw, v_x}}

# ---- the file; offroad log check proposes these
# columns: {{a_y: imu/linear_acceleration.y, omega_f: [wheel_fl, wheel_fr], ignore: [battery]}}
# units: {{yaw_rate: deg/s, a_x: g, speed: km/h, omega_r: rpm, steer: 0.0625 deg}}   # 0.0625: a ratio of 16
# signs: {{steer: -1}}
# csv: {{separator: ";", decimal: ","}}
# time: {{repeated: merge, order: sort, missing: drop}}
# blank: {{omega_r: [[12.3, 15.1]]}}    # samples that are none, from and to [s]
"""
