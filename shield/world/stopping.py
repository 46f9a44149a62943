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

It is a barrier on the best knowledge of one scanner, not a proof: what the scanner does not see is
not in it, and cars count as standing where they are.
"""

import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from shield.arguments import check_positive
from shield.errors import InvalidLimits
from shield.estimation.clusters import Track
from shield.world.surroundings import Surroundings

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
        braking: Deceleration it counts on [m/s^2], at most the limit's: the last resort of somebody
            who should have braked before.
        delay: Time until the brakes hold [s].
        standoff: Distance from the scanner to what it stops for [m]; from nearer than 2.5 m a car
            cannot steer free.
        walker_standoff: The same for somebody who walks [m].
        width: Half width of what the sensor sweeps [m]: half a car and a margin.
        walker_width: The same for somebody who walks [m].
        body: From the sensor to behind the car [m].
        horizon: Length of the path that is looked at [m].

    Raises:
        InvalidLimits: A number is not positive and finite.
    """

    braking: float = 6.0
    delay: float = 0.2
    standoff: float = 3.0
    walker_standoff: float = 3.5
    width: float = 1.2
    walker_width: float = 1.9
    body: float = 6.0
    horizon: float = 30.0

    def __post_init__(self) -> None:
        """Refuse what cannot be, naming the field and the value received."""
        check_positive(InvalidLimits, **asdict(self))


class StoppingBarrier:
    """Bounds the speed by the free path ahead.

    Args:
        config: Its numbers.
        wheelbase: Distance between the axles [m].
    """

    _STEP = 0.5

    def __init__(self, config: StoppingConfig, wheelbase: float) -> None:
        self.config = config
        self._wheelbase = wheelbase
        self._along: Array = np.arange(0.0, config.horizon, self._STEP)

    def max_speed(self, around: Surroundings, steering: float) -> float:
        """The speed from which the car stops in time on the arc of a steering angle [m/s].

        Infinite on a free path.

        Args:
            around: What is there.
            steering: That is about to be executed [rad].
        """
        arc = _Arc.of(math.tan(steering) / self._wheelbase, around.forward)
        free = min(
            self._free_of_points(arc, around.points) - self.config.standoff,
            self._free_of_walkers(arc, around) - self.config.walker_standoff,
        )
        if math.isinf(free):
            return math.inf
        braking, room = self.config.braking, max(free, 0.0)
        lost = braking * self.config.delay
        return max(0.0, math.sqrt(lost**2 + 2.0 * braking * room) - lost)

    def _free_of_points(self, arc: "_Arc", points: Array) -> float:
        """Length of the arc up to the second point that is swept: one alone may be rain [m]."""
        along, aside = arc.locate(points)
        swept = along[(along > 0.0) & (np.abs(aside) < self.config.width)]
        return float(np.partition(swept, 1)[1]) if len(swept) > 1 else math.inf

    def _free_of_walkers(self, arc: "_Arc", around: Surroundings) -> float:
        """Length of the arc up to where a walker will be before the car has passed [m]."""
        if not around.walkers:
            return math.inf
        passed = (self._along + self.config.body) / max(around.speed, _SLOWEST)
        places = arc.places(self._along)
        blocked = np.zeros(len(places), np.bool_)
        for walker in around.walkers:
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
