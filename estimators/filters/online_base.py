"""What online filters share: checks of their inputs, their range of n, navigation, actuators, validity flag.

An online filter runs while the vehicle drives, on commands and sensors alone. The range of its n, the
actuators while it rests and the report of its estimate are kernels; `OnlineFilter` is the class around them.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

from estimators.filters.navigation import NavigationFilter, NavigationNoise
from estimators.filters.protocol import Estimate, Pose
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.records import FloatArray
from offroad_env.simulation.simulator import Plant

__all__ = [
    "CHANGE_FIELDS",
    "MEAN_TIME",
    "WIDEST",
    "OnlineFilter",
    "check_positive",
    "checked_range",
    "filter_range",
    "follow_command",
    "report_estimate",
    "require_plain_plant",
]

#: Time over which the innovation test for the validity flag averages [s].
MEAN_TIME = 2.0
#: Variance of eta up to which a change of the soil widens the belief: a fifth of the range of n, as wide as a
#: prior.
WIDEST = 1.0
#: The filter's range is wider than the user's by this share on both sides: a bound is infinitely far
#: away on the scale of eta, so a soil close to one would be approached too slowly.
_MARGIN = 0.15
#: Settings of the test for a change.
CHANGE_FIELDS = ("change_time", "change_level", "change_settle")


def checked_range(plant: Plant, n_range: tuple[float, float], dt: float) -> tuple[float, float]:
    """Bounds of n for an online filter.

    Raises
    ------
    InvalidParameter
        For a range, plant or step that such a filter cannot work with.
    """
    low, high = n_range
    if not 0.05 < low < high <= 2.5:
        raise InvalidParameter(f"n_range must be 0.05 < low < high <= 2.5, got {n_range}")
    if plant.soil.rigid > 0.5:
        raise InvalidParameter("the plant must stand on deformable soil: hard ground has no n")
    if not 0.001 <= dt <= 0.02:
        raise InvalidParameter(f"dt must be in [0.001, 0.02] s, got {dt} - in ms?")
    return float(low), float(high)


def require_plain_plant(plant: Plant) -> None:
    """Refuse a plant with anything that filters of n alone would leave out.

    Raises
    ------
    InvalidParameter
    """
    for name in ("structure", "four_wheel", "soil_field", "effects"):
        if getattr(plant, name) is not None:
            raise InvalidParameter(
                f"plant.{name} must be None: a filter of n alone has a half-car or bicycle with rigid rims "
                "on uniform soil - for other wheels take online_soil_belief"
            )


def check_positive(settings: object, names: tuple[str, ...]) -> None:
    """Refuse settings that are not positive.

    Raises
    ------
    InvalidParameter
    """
    for name in names:
        if not getattr(settings, name) > 0.0:
            raise InvalidParameter(f"{name} must be > 0, got {getattr(settings, name)}")


def filter_range(n_range: tuple[float, float]) -> tuple[float, float]:
    """Range of n inside the filter, wider than the reported one."""
    low, high = n_range
    margin = _MARGIN * (high - low)
    return max(low - margin, 0.5 * low), high + margin


@kernel
def follow_command(
    x: FloatArray, command: tuple[float, float, float], lags: tuple[float, float], dt: float
) -> None:
    """Let the actuators of a vehicle's state (15,) follow the command over ``dt`` [s], in place.

    ``lags`` are those of steering and torque [s]. The brake stays where the command has none (NaN), as in the
    paper's model.
    """
    steer, drive, brake = command
    turn, share = dt / max(lags[0], dt), dt / max(lags[1], dt)
    x[at.STEER] += turn * (steer - x[at.STEER])
    x[at.DRIVE] += share * (drive - x[at.DRIVE])
    if math.isfinite(brake):
        x[at.BRAKE] += share * (brake - x[at.BRAKE])


@kernel
def report_estimate(
    moments: tuple[float, float],
    n_range: tuple[float, float],
    nis: float,
    repairs: float,
    calm: bool,
) -> Estimate:
    """Estimate from mean and standard deviation of n; ``calm``: no test rejects its validity."""
    mean, sd = moments
    inside = min(max(mean, n_range[0]), n_range[1])
    return Estimate(inside, sd, nis, calm and math.isfinite(sd), int(repairs))


class OnlineFilter(ABC):
    """An estimate of the sinkage exponent from commands and sensors.

    Two filters are of this kind, `estimators.filters.online_parameter_ukf` and `online_joint_ukf`; to their
    users they are `estimators.filters.protocol.Estimator`.

    Parameters
    ----------
    plant : Plant
        The vehicle's model of itself and the ground.
    n_range : (float, float)
        Bounds of n [-]; the reported mean stays inside.
    dt : float
        Time between samples [s].
    navigation : NavigationFilter, optional
        Default: one of its own.
    noise : NavigationNoise, optional
        Of its own one: of the sensors that it gets.
    navigates : bool
        Whether the navigation filter is reset and updated here.

    Raises
    ------
    InvalidParameter
        For a range, step or plant that the filter cannot work with.
    """

    def __init__(
        self,
        plant: Plant,
        n_range: tuple[float, float],
        *,
        dt: float,
        navigation: NavigationFilter | None,
        navigates: bool,
        noise: NavigationNoise | None = None,
    ) -> None:
        self.n_range = checked_range(plant, n_range, dt)
        self.plant, self.dt = plant, float(dt)
        self.navigation = navigation or NavigationFilter(plant.vehicle, noise)
        self._navigates = navigates

    def _start(self) -> None:
        """The belief before the first reset: all of the range, standing at the origin."""
        low, high = self.n_range
        self._restart(0.5 * (low + high), 0.25 * (high - low))
        if self._navigates:
            self.navigation.reset(0.0, 0.0, 0.0, 0.0)

    @abstractmethod
    def _restart(self, n_prior: float, sd: float) -> None:
        """Forget everything; the prior of n has this mean and standard deviation."""

    @abstractmethod
    def _update(
        self,
        command: tuple[float, float, float],
        imu: FloatArray,
        rim_speeds: FloatArray,
        gnss: FloatArray,
    ) -> None:
        """Take in one sample that the navigation filter has taken in already."""

    def reset(self, n_prior: float, sd: float, pose: Pose) -> Estimate:
        """Start at a known pose.

        Parameters
        ----------
        n_prior, sd : float
            Mean and standard deviation of the prior for n [-]; the mean lies inside ``n_range``.
        pose : Pose
            Position, heading and speed; not used where the navigation filter is somebody else's.

        Returns
        -------
        Estimate
            The prior.

        Raises
        ------
        InvalidParameter
            For a mean outside ``n_range``, or a standard deviation too wide for it.
        """
        low, high = self.n_range
        if not low <= n_prior <= high:
            raise InvalidParameter(f"n_prior must be in n_range = [{low}, {high}], got {n_prior}")
        self._restart(n_prior, sd)
        if self._navigates:
            self.navigation.reset(*pose)
        return self.estimate

    def update(
        self,
        command: tuple[float, float, float],
        imu: FloatArray,
        rim_speeds: FloatArray,
        gnss: FloatArray,
    ) -> Estimate:
        """Take in one sample of every sensor; call once per ``dt``.

        Parameters
        ----------
        command : (float, float, float)
            What was commanded since the last sample: steering [rad], drive and brake torque [N m];
            with the paper's model steering and body force [N] (the third number is not used).
        imu : array (5,)
            a_x, a_y, a_z [m/s^2], pitch_rate, yaw_rate [rad/s].
        rim_speeds : array (2,)
            r omega front, rear [m/s]; NaN when not measured.
        gnss : array (4,)
            X, Y [m], speed [m/s], course [rad]; NaN when not measured.

        Returns
        -------
        Estimate
        """
        if self._navigates:
            steer, _, _ = command
            self.navigation.update(imu, rim_speeds, steer, gnss, self.dt)
        self._update(command, imu, rim_speeds, gnss)
        return self.estimate

    @property
    @abstractmethod
    def estimate(self) -> Estimate:
        """The present estimate."""

    @property
    def pose(self) -> Pose:
        """Of the navigation filter."""
        return self.navigation.pose

    @property
    @abstractmethod
    def held(self) -> bool:
        """Whether the last sample left n as it was."""

    @property
    @abstractmethod
    def changes(self) -> int:
        """How many changes of n it has detected since the reset."""
