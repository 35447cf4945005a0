"""Description of a run: everything that a simulation of it needs besides the measured channels."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from offroad_env.physics.records import FourWheel, Ground, Soil, Vehicle, Wheel
from offroad_env.world.terrain import flat, paper_terrain

__all__ = [
    "RIGID_KEYS",
    "SOIL_KEYS",
    "STATE_KEYS",
    "UNKNOWN",
    "GnssSpec",
    "ImuSpec",
    "LogConfig",
    "StartSpec",
    "TerrainSpec",
    "Wave",
]

#: What a description may state as unknown, although its record has to hold some value.
UNKNOWN = ("imu.position", "gnss.position", "suspension")

#: Keys of ``start: {state: {...}}``, in the order of `offroad_env.physics.state`.
STATE_KEYS = (
    "x", "y", "yaw", "z", "pitch", "v_x", "v_y", "v_z", "pitch_rate", "yaw_rate",
    "omega_f", "omega_r", "steer", "drive_torque", "brake_torque",
)  # fmt: skip

#: Keys of ``soil`` for deformable and for rigid ground.
SOIL_KEYS = ("k_c", "k_phi", "n", "c", "phi", "k_x", "k_y", "a_0", "a_1", "b_0", "b_1")
RIGID_KEYS = ("mu", "C_alpha", "C_kappa")

Wave = tuple[float, float, float, float]  #: a row of `records.Ground.waves`: amplitude, p, q, phase


@dataclass(frozen=True, kw_only=True)
class ImuSpec:
    """What the accelerometers feel, where the IMU sits, and its noise."""

    kinematic: bool  #: True: acceleration; False: specific force, which holds +g at rest
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: from the CG: forward, left, up [m]
    sd_a: float  #: standard deviation of an acceleration sample [m/s^2]
    sd_rate: float  #: standard deviation of a rate sample [rad/s]
    #: Rows: the vehicle's axes (forward, left, up) in the axes of the IMU as it was read; None: they agree.
    orientation: tuple[tuple[float, float, float], ...] | None = None
    rate: float | None = None  #: even rate to which the samples were brought [Hz]; None: as they are


@dataclass(frozen=True, kw_only=True)
class GnssSpec:
    """Noise of position and speed."""

    sd_position: float  #: each axis [m]
    sd_speed: float | None = None  #: [m/s]


@dataclass(frozen=True, kw_only=True)
class TerrainSpec:
    """The ground of the run."""

    kind: str  #: "flat", "paper", "unknown" or "waves"
    H_0: float = 0.0  #: greatest height of the paper's field [m]
    rms: float = 0.0  #: standard deviation of the height of an unknown ground [m]
    plane: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: height [m] and slopes [-] under the waves
    waves: tuple[tuple[float, float, float, float], ...] = ()  #: rows as in `records.Ground.waves`

    def ground(self) -> Ground:
        """The ground as far as it is known: level where it is not."""
        if self.kind == "paper":
            return paper_terrain(self.H_0)
        if self.kind == "waves":
            rows = np.ascontiguousarray(np.array(self.waves, dtype=np.float64).reshape(-1, 4))
            return Ground(*self.plane, rows)
        return flat()


@dataclass(frozen=True, kw_only=True)
class StartSpec:
    """How the run begins. Values in ``state`` replace those of the settled vehicle."""

    x: float = 0.0  #: [m]
    y: float = 0.0  #: [m]
    yaw: float = 0.0  #: [rad]
    v_x: float = 0.0  #: [m/s]
    state: tuple[tuple[str, float], ...] = ()  #: (name of `STATE_KEYS`, value) in SI


@dataclass(frozen=True, kw_only=True)
class LogConfig:
    """Content of the YAML, in SI.

    A wheel rig has ``wheel``; a vehicle log has ``vehicle``, ``imu``, ``terrain`` and ``start``.
    """

    soil: Soil  #: prior
    model: str = "full"  #: "full" or "paper"
    structure: str = "full"  #: laws of the wheels of the full model, see `world.structures.read_structure`
    drivetrain: str = "torque"  #: "force" or "torque"
    slip: float = 0.0  #: constant slip of the paper's model [-]
    vehicle: Vehicle | None = None
    four_wheel: FourWheel | None = None  #: what is stated of four wheels; None = the rules
    wheel: Wheel | None = None
    terrain: TerrainSpec = field(default_factory=lambda: TerrainSpec(kind="flat"))
    imu: ImuSpec | None = None
    gnss: GnssSpec | None = None
    hold: str = "zoh"  #: inputs hold from their stamp ("zoh") or run straight to the next ("linear")
    start: StartSpec = field(default_factory=StartSpec)
    unknown: tuple[str, ...] = ()  #: of `UNKNOWN`: what nobody has measured; a diagnosis does not judge it
    exact: bool = False  #: numbers of vehicle and soil are exact and the soil is even, as in a simulation
    units: tuple[tuple[str, str], ...] = ()  #: (column, unit) that the file was read with
    start_from_data: bool = False  #: whether the start is read off the first samples
    silences: tuple[tuple[float, float], ...] = ()  #: (where, true length [s]) of those that count for less
    notes: tuple[str, ...] = ()  #: what was taken in place of something else when the file was read
