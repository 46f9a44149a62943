r"""The speed from which the car still stops in front of what is in its way.

Bounds on commands say nothing of the world. This barrier does: with a free path of g metres, a
reaction time τ and a braking deceleration b, the car stops in time from

.. math:: v\,τ + \frac{v^2}{2b} \le g \iff v \le -bτ + \sqrt{(bτ)^2 + 2bg},

the braking distance of every driving school and of responsibility-sensitive safety
(arXiv 1708.06374, Definition 1 with a standing obstacle). The path is the arc of the steering that
is about to be executed. What stands on it ends it; somebody who walks ends it where he will be
on it before the car has passed.

=========  =============================================================
variable   symbol
=========  =============================================================
`free`     g
`delay`    τ
`braking`  b
=========  =============================================================

It is a barrier on the best knowledge of one scanner, not a proof: what the scanner does not see
and what moves faster than a pedestrian is not in it.
"""

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shield.errors import InvalidLimits
from shield.limits import ActuatorLimits
from shield.scan import ScanFilter
from shield.tracking import ClusterTracker, Track

__all__ = ["StoppingBarrier", "StoppingConfig"]

Array = NDArray[np.float64]

_STRAIGHTEST = 1e-4
"""Curvature below which an arc counts as one of this curvature [1/m]."""

_SLOWEST = 3.0
"""Least speed at which the car is taken to pass in front of a walker [m/s]."""


@dataclass(frozen=True, slots=True)
class StoppingConfig:
    """Numbers of the barrier, none of them in the paper.

    Attributes:
        enabled: Whether the shield has it.
        braking: Deceleration it counts on [m/s^2]: two thirds of the limit, so that the rest is in
            hand.
        delay: Time until the brakes hold [s].
        standoff: Distance from the sensor to what it stops for [m].
        width: Half width of what the sensor sweeps [m]: half a car and a margin.
        walker_width: The same for somebody who walks [m].
        walker_speed: Slowest and fastest speed of somebody who walks [m/s].
        walker_sightings: Scans that must have seen him.
        forward: From the rear axle to the sensor [m].
        body: From the sensor to behind the car [m].
        max_range: Reading of a beam that hit nothing [m].
        horizon: Length of the path that is looked at [m].

    Raises:
        InvalidLimits: A number is not positive and finite.
    """

    enabled: bool = True
    braking: float = 4.0
    delay: float = 0.2
    standoff: float = 1.5
    width: float = 1.3
    walker_width: float = 1.9
    walker_speed: tuple[float, float] = (0.5, 2.5)
    walker_sightings: int = 5
    forward: float = 3.6
    body: float = 6.0
    max_range: float = 40.0
    horizon: float = 30.0

    def __post_init__(self) -> None:
        """Refuse what cannot be, naming the field and the value received."""
        for entry in fields(self):
            value = getattr(self, entry.name)
            for number in value if isinstance(value, tuple) else (value,):
                if entry.name != "enabled" and not 0.0 < number < math.inf:
                    raise InvalidLimits(
                        f"`{entry.name}` must be positive and finite. Got {value!r}."
                    )


class StoppingBarrier:
    """Bounds the speed by the free path ahead.

    Args:
        config: Its numbers.
        limits: Limits of the vehicle.
    """

    _STEP = 0.5

    def __init__(self, config: StoppingConfig, limits: ActuatorLimits) -> None:
        self.config = config
        self._wheelbase = limits.wheelbase
        self._tracker = ClusterTracker(limits.dt, config.forward)
        self._scan_filter = ScanFilter(config.max_range)
        self._along: Array = np.arange(0.0, config.horizon, self._STEP)
        self.reset()

    def reset(self) -> None:
        """Forget the episode."""
        self._tracker.reset()
        self._scan_filter.reset()
        self._points: Array = np.zeros((0, 2))
        self._walkers: list[Track] = []
        self._speed = 0.0
        self._blind = False

    def update(self, scan: ArrayLike, speed: float, yaw_rate: float) -> None:
        """Take a scan.

        Args:
            scan: Ranges [m], shape (n,), over 180 degrees, counter-clockwise from the right.
            speed: Own speed [m/s].
            yaw_rate: Own yaw rate [rad/s].

        Raises:
            InvalidProblem: `scan` is not of numbers, not one-dimensional or empty.
        """
        config = self.config
        ranges = self._scan_filter.clean(scan, speed)
        self._blind = ranges is None
        if ranges is None:
            return
        self._speed = speed if math.isfinite(speed) else self._speed
        hit = ranges < min(config.max_range - 0.5, config.horizon)
        bearing = np.linspace(-0.5 * math.pi, 0.5 * math.pi, len(ranges))[hit]
        self._points = ranges[hit, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
        slowest, fastest = config.walker_speed
        self._walkers = [
            track
            for track in self._tracker.update(self._points, self._speed, yaw_rate)
            if track.sightings >= config.walker_sightings
            and slowest < math.hypot(*track.velocity.tolist()) < fastest
        ]

    def max_speed(self, steering: float) -> float:
        """The speed from which the car stops in time on the arc of a steering angle [m/s].

        Infinite on a free path, and without a usable scan: not seeing is the trigger's business.

        Args:
            steering: That is about to be executed [rad].
        """
        if self._blind or not math.isfinite(steering):
            return math.inf
        curvature = math.tan(steering) / self._wheelbase
        arc = _Arc.of(curvature, self.config.forward)
        free = min(self._free_of_points(arc), self._free_of_walkers(arc)) - self.config.standoff
        if math.isinf(free):
            return math.inf
        lost = self.config.braking * self.config.delay
        return max(0.0, math.sqrt(lost**2 + 2.0 * self.config.braking * max(free, 0.0)) - lost)

    def _free_of_points(self, arc: "_Arc") -> float:
        """Length of the arc up to the second point that is swept: one alone may be rain [m]."""
        along, aside = arc.locate(self._points)
        swept = along[(along > 0.0) & (np.abs(aside) < self.config.width)]
        return float(np.partition(swept, 1)[1]) if len(swept) > 1 else math.inf

    def _free_of_walkers(self, arc: "_Arc") -> float:
        """Length of the arc up to where a walker will be before the car has passed [m]."""
        if not self._walkers:
            return math.inf
        passed = (self._along + self.config.body) / max(self._speed, _SLOWEST)
        places = arc.places(self._along)
        blocked = np.zeros(len(places), np.bool_)
        for walker in self._walkers:
            comes, goes = _crossing_times(walker, places, self.config.walker_width)
            blocked |= (goes > 0.0) & (comes < passed)
        return float(self._along[blocked].min(initial=math.inf))


@dataclass(frozen=True, slots=True)
class _Arc:
    """The way of the sensor, in its own frame: a circle around (-forward, radius)."""

    radius: float
    forward: float

    @classmethod
    def of(cls, curvature: float, forward: float) -> "_Arc":
        bend = math.copysign(max(abs(curvature), _STRAIGHTEST), curvature)
        return cls(1.0 / bend, forward)

    @property
    def _sensor(self) -> tuple[float, float]:
        """Its distance from the middle [m] and its bearing from there [rad]."""
        return math.hypot(self.forward, self.radius), math.atan2(-self.radius, self.forward)

    def locate(self, points: Array) -> tuple[Array, Array]:
        """Distance along the arc and from it of points (n, 2): two times (n,) [m]."""
        reach, start = self._sensor
        x, y = points[:, 0] + self.forward, points[:, 1] - self.radius
        turned = math.copysign(1.0, self.radius) * (np.arctan2(y, x) - start)
        along = reach * ((turned + math.pi) % (2.0 * math.pi) - math.pi)
        return along, np.hypot(x, y) - reach

    def places(self, along: Array) -> Array:
        """Points (m, 2) of the arc at distances (m,) [m]."""
        reach, start = self._sensor
        angle = start + math.copysign(1.0, self.radius) * along / reach
        centre = np.array([-self.forward, self.radius])
        return np.asarray(centre + reach * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def _crossing_times(walker: Track, places: Array, room: float) -> tuple[Array, Array]:
    """When a walker comes within `room` of places (m, 2), and leaves it: two times (m,) [s].

    Both are minus infinity where he never does.
    """
    apart = walker.position - places
    pace = float(walker.velocity @ walker.velocity)
    half = apart @ walker.velocity
    inside = half**2 - pace * ((apart**2).sum(axis=1) - room**2)
    root = np.sqrt(np.where(inside > 0.0, inside, np.nan))
    times = (-half - root) / pace, (-half + root) / pace
    return np.nan_to_num(times[0], nan=-math.inf), np.nan_to_num(times[1], nan=-math.inf)
