r"""Lane geometry, and the pose in the lane tracked from sighting to sighting.

A filterpy Kalman filter gates measurements that do not fit, coasts through missing ones
(`update(None)`, never NaN) and reports the age of the last accepted measurement. State and
covariance are x, P; transition and process noise F, Q; measurement matrix and noise H, R; the
innovation and its covariance y, S.
"""

import math
from dataclasses import astuple, dataclass

import numpy as np
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray

from shield.errors import (
    Array,
    InvalidLimits,
    InvalidProblem,
    as_array,
    check_numbers,
    check_positive,
)

__all__ = ["LaneEstimate", "LaneGeometry", "LaneMeasurement", "LaneTracker"]

GATE = 13.82  # 99.9 % quantile of chi² with 2 degrees of freedom
MAX_REJECTED = 5  # sightings rejected in a row after which the filter, not the sensor, is lost
CURVATURE_STD = np.array([0.005, 0.0005])  # [1/m], [1/m²] of a sighting's curvature and its rate
MAX_SIZE = 1e6  # no lane has such numbers; they would overflow the covariance
AT_REST = 0.3  # share of the process noise that is left at rest
MIN_STRETCH = 0.2  # least 1 - κ e: beyond the centre of a bend there is no lane
MAX_MOTION = 1e3  # [m/s], [rad/s] beyond this a reading is a defect of the sensor, not motion


@dataclass(frozen=True, slots=True)
class LaneGeometry:
    """The lanes of the own direction: the home lane, and the passing lane to its left.

    Attributes:
        width: Width of a lane [m]. Default: an urban main road's.

    Raises:
        InvalidLimits: `width` is not positive and finite.
    """

    width: float = 3.5

    def __post_init__(self) -> None:
        """Check the field."""
        check_positive(InvalidLimits, width=self.width)

    @property
    def centres(self) -> tuple[float, ...]:
        """Lane centres, measured left of the home lane's [m]."""
        return (0.0, self.width)


@dataclass(frozen=True, slots=True)
class LaneMeasurement:
    """One sighting of the home lane; a value that is not finite is a missing one.

    Attributes:
        lateral_offset: Position left of the lane centre [m].
        heading_error: Yaw relative to the lane [rad].
        curvature: Curvature of the lane here [1/m], positive to the left.
        curvature_rate: Its derivative along the lane [1/m²].
        offset_std: Standard deviation of `lateral_offset` [m].
        heading_std: Standard deviation of `heading_error` [rad].
    """

    lateral_offset: float
    heading_error: float
    curvature: float
    curvature_rate: float
    offset_std: float = 0.1
    heading_std: float = 0.02


@dataclass(frozen=True, slots=True)
class LaneEstimate:
    """Tracked pose in the lane.

    Attributes:
        lateral_offset, heading_error, curvature, curvature_rate, offset_std: As in
            `LaneMeasurement`.
        age: Time since the last accepted sighting [s]; infinite before the first.
        valid: True while `age` is within the tracker's `max_age`.
    """

    lateral_offset: float
    heading_error: float
    curvature: float
    curvature_rate: float
    offset_std: float
    age: float
    valid: bool


class LaneTracker:
    r"""Tracks the pose relative to the lane through gaps and outliers.

    The state is (e, ψ, κ, κ'): lateral offset, heading error, curvature and its rate along the
    lane. Between sightings it moves with the car,

    .. math:: \dot e = v\sin\psi,\quad \dot\psi = \omega - \kappa\dot s,\quad
              \dot\kappa = \kappa'\dot s,\quad \dot s = \frac{v\cos\psi}{1 - \kappa e}.

    A sighting whose (e, ψ) is improbable (normalised innovation squared beyond the 99.9 % quantile)
    is treated as missing; after `MAX_REJECTED` in a row the filter restarts at the next, because
    then it is the filter that is lost.

    Args:
        dt: Period of the updates [s].
        max_age: Age from which the estimate is invalid [s].

    Raises:
        InvalidProblem: An argument is not positive and finite.
    """

    def __init__(self, dt: float, *, max_age: float = 0.5) -> None:
        check_positive(InvalidProblem, dt=dt, max_age=max_age)
        self._dt, self._max_age = dt, max_age
        self._filter = KalmanFilter(dim_x=4, dim_z=4)
        self.reset()

    def reset(self) -> None:
        """Forget everything; the estimate is invalid until the first sighting."""
        self._age = math.inf
        self._rejected = 0
        self._speed = 0.0
        self._filter.x = np.zeros(4)
        self._filter.P = np.diag([2.0**2, 0.3**2, 0.02**2, 0.002**2])

    @np.errstate(all="ignore")
    def update(
        self, measurement: LaneMeasurement | None, speed: float, yaw_rate: float
    ) -> LaneEstimate:
        """Advance by one period.

        Args:
            measurement: Sighting of the lane, None when there is none.
            speed: Own speed during the period [m/s]; the last known one if not finite or beyond
                any vehicle.
            yaw_rate: Own yaw rate ω [rad/s]; if not finite or beyond any vehicle, that of following
                the lane.

        Raises:
            InvalidProblem: An argument is not of its type.
        """
        check_numbers(speed=speed, yaw_rate=yaw_rate)
        if measurement is not None and not isinstance(measurement, LaneMeasurement):
            raise InvalidProblem(f"`measurement` must be a LaneMeasurement. Got {measurement!r}.")
        self._predict(speed, yaw_rate)
        self._age += self._dt
        if self._fuse(measurement):
            self._age, self._rejected = 0.0, 0
        offset, heading, curvature, rate = self._filter.x.tolist()
        std, valid = math.sqrt(float(self._filter.P[0, 0])), self._age <= self._max_age
        return LaneEstimate(offset, heading, curvature, rate, std, self._age, valid)

    def _predict(self, speed: float, yaw_rate: float) -> None:
        """Move the state with the car."""
        dt = self._dt
        self._speed = v = float(speed) if abs(speed) <= MAX_MOTION else self._speed
        known = abs(yaw_rate) <= MAX_MOTION
        omega = float(yaw_rate) if known else v * float(self._filter.x[2])
        kalman = self._filter
        offset, heading, curvature, rate = kalman.x.tolist()
        sin, cos = math.sin(heading), math.cos(heading)
        stretch = cos / max(1.0 - curvature * offset, MIN_STRETCH)
        transition = np.eye(4)
        transition[0, 1] = v * dt * cos
        transition[1, 1] += v * dt * curvature * sin
        transition[1, 2], transition[2, 3] = -v * dt * stretch, v * dt * stretch
        # Slip and yaw-rate error, heading noise, bends that change along the way; a car at rest
        # stays where it is.
        moves, turns = min(abs(v), 1.0) + AT_REST, 0.05 if known else 0.5
        deviation = dt * np.array(
            [0.2 * moves + 0.02 * abs(v), turns * moves, 0.002 * abs(v), 0.001 * abs(v)]
        )
        kalman.predict(F=transition, Q=np.diag(deviation**2 + 1e-12))
        turn = omega - v * curvature * stretch
        kalman.x = np.array(
            [
                offset + v * dt * math.sin(heading + 0.5 * dt * turn),
                heading + dt * turn,
                curvature + v * dt * stretch * rate,
                rate,
            ]
        )

    def _fuse(self, measurement: LaneMeasurement | None) -> bool:
        """Fuse a sighting; False when it is missing, malformed or rejected."""
        kalman = self._filter
        rows = None if measurement is None else _usable_rows(measurement)
        if rows is None:
            kalman.update(None)
            return False
        z, present, noise = rows
        H = np.eye(4)[present]
        R = np.diag(noise[present] ** 2)
        y = z[:2] - kalman.x[:2]
        S = kalman.P[:2, :2] + R[:2, :2]
        if float(y @ np.linalg.solve(S, y)) > GATE and math.isfinite(self._age):
            self._rejected += 1
            if self._rejected < MAX_REJECTED:
                kalman.update(None)
                return False
            speed = self._speed
            self.reset()
            self._speed = speed
        kalman.update(z[present], R=R, H=H)
        return True


def _usable_rows(measurement: LaneMeasurement) -> tuple[Array, NDArray[np.bool_], Array] | None:
    """Return values (4,), which are present (4,) and their deviations (4,); None when unusable."""
    values = as_array("measurement", astuple(measurement))
    z, noise = values[:4], np.concatenate([values[4:], CURVATURE_STD])
    present = np.isfinite(z)
    usable = present[:2].all() and ((noise > 0.0) & (noise <= MAX_SIZE)).all()
    return (z, present, noise) if usable and np.abs(z[present]).max() <= MAX_SIZE else None
