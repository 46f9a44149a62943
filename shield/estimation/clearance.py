r"""Free distance to the nearest obstacle in view, tracked from scan to scan.

A filterpy Kalman filter gates measurements that do not fit, coasts through missing ones
(`update(None)`, never NaN) and reports the age of the last accepted measurement.
"""

import math
from dataclasses import dataclass

import numpy as np
from filterpy.kalman import KalmanFilter
from numpy.typing import ArrayLike

from shield.errors import InvalidProblem, check_positive
from shield.estimation.scan import DEFAULT_SCANNER, CleanScan, ScanFilter

__all__ = ["ClearanceEstimate", "ClearanceTracker"]

GATE = 10.83  # 99.9 % quantile of chi² with 1 degree of freedom
CONFIRMATIONS = 3  # scans in a row that must agree before the clearance jumps up
RANGE_STD = 0.05  # [m] of the measured minimum: a laser scanner's
ACCELERATION_STD = 4.0  # [m/s²] of the relative acceleration: ordinary braking
RELATIVE_SPEED_STD = 10.0  # [m/s] of an obstacle at its first sighting: ordinary in city traffic


@dataclass(frozen=True, slots=True)
class ClearanceEstimate:
    """Tracked free distance.

    Attributes:
        clearance: Distance to the nearest obstacle in view [m].
        closing_speed: Rate at which it shrinks [m/s], positive when approaching.
        std: Standard deviation of `clearance` [m].
        age: Time since the last accepted scan [s]; infinite before the first.
        valid: True while `age` is within the tracker's `max_age`.
    """

    clearance: float
    closing_speed: float
    std: float
    age: float
    valid: bool


class ClearanceTracker:
    r"""Tracks the clearance and its rate, a constant-velocity Kalman filter on scan minima.

    The measurement is the smallest range that a cluster of neighbouring beams supports (see
    `scan`), so one spurious or stuck beam does not move it. What the cluster supports is
    believed at once when it is *nearer* than predicted: the filter restarts there within the same
    step. When it is much *further* than predicted it has to be confirmed by the next scans first,
    since dropouts can hide an obstacle but not invent one.

    Args:
        dt: Period of the scans [s].
        max_range: Largest range of the sensor, reported where nothing returns [m].
        max_age: Age from which the estimate is invalid [s].

    Raises:
        InvalidProblem: An argument is not positive and finite.
    """

    def __init__(
        self, dt: float, max_range: float = DEFAULT_SCANNER.max_range, *, max_age: float = 0.3
    ) -> None:
        check_positive(InvalidProblem, dt=dt, max_range=max_range, max_age=max_age)
        self._dt, self._max_range, self._max_age = dt, max_range, max_age
        self._scan_filter = ScanFilter(max_range)
        self._filter = KalmanFilter(dim_x=2, dim_z=1)
        self._filter.F = np.array([[1.0, dt], [0.0, 1.0]])
        self._filter.H = np.array([[1.0, 0.0]])
        self._filter.R = np.array([[RANGE_STD**2]])
        self._filter.Q = ACCELERATION_STD**2 * np.array(
            [[dt**4 / 4.0, dt**3 / 2.0], [dt**3 / 2.0, dt**2]]
        )
        self.reset()

    def reset(self) -> None:
        """Forget everything; the estimate is invalid until the first scan."""
        self._scan_filter.reset()
        self._age = math.inf
        self._restart(self._max_range)

    @np.errstate(all="ignore")
    def update(
        self, scan: ArrayLike | CleanScan | None, speed: float | None = None
    ) -> ClearanceEstimate:
        """Advance by one period.

        Args:
            scan: Ranges [m], shape (n,), as in `ScanFilter.examine`, or what that has made of them;
                None when there is no scan.
            speed: Own speed [m/s], if known: a scan that repeats itself bit by bit while driving
                comes from a dead sensor.

        Raises:
            InvalidProblem: `scan` is not one-dimensional or is empty.
        """
        if scan is not None and not isinstance(scan, CleanScan):
            scan = self._scan_filter.examine(scan, speed)
        measured = None if scan is None else scan.nearest
        kalman = self._filter
        kalman.predict()
        self._age += self._dt
        if measured is None:
            kalman.update(None)
        elif self._accept(measured):
            self._age = 0.0
        # The clearance stays in the range of the sensor; at its end nothing approaches.
        clearance, rate = kalman.x.tolist()
        if clearance >= self._max_range:
            kalman.x = np.array([self._max_range, min(rate, 0.0)])
        elif clearance < 0.0:
            kalman.x = np.array([0.0, rate])
        return ClearanceEstimate(
            clearance=float(kalman.x[0]),
            closing_speed=-float(kalman.x[1]),
            std=math.sqrt(float(kalman.P[0, 0])),
            age=self._age,
            valid=self._age <= self._max_age,
        )

    def _accept(self, measured: float) -> bool:
        """Fuse a measurement, restart at it, or hold it back until confirmed."""
        if math.isinf(self._age):
            self._restart(measured)
            return True
        kalman = self._filter
        innovation = measured - float(kalman.x[0])
        variance = float(kalman.P[0, 0]) + RANGE_STD**2
        if innovation * innovation <= GATE * variance:
            kalman.update(np.array([measured]))
            self._jumps = 0
            return True
        if innovation > 0.0:
            self._jumps += 1
            if self._jumps < CONFIRMATIONS:
                kalman.update(None)
                return False
        self._restart(measured)
        return True

    def _restart(self, clearance: float) -> None:
        """Put the state at a clearance with an unknown rate."""
        self._jumps = 0
        self._filter.x = np.array([clearance, 0.0])
        self._filter.P = np.diag([RANGE_STD**2, RELATIVE_SPEED_STD**2])
