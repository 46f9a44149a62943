r"""The speed from which the car still stops in front of what is in its way.

Bounds on commands say nothing of the world. This barrier does: with a free path of g metres
(`free`), a reaction time τ (`delay`) and a deceleration b (`braking`), the car stops in time from

.. math:: v\,τ + \frac{v^2}{2b} \le g \iff v \le -bτ + \sqrt{(bτ)^2 + 2bg},

the braking distance of every driving school and of responsibility-sensitive safety
(arXiv 1708.06374, Definition 1 with a standing obstacle). The path is the arc of the steering that
is about to be executed. Obstacle points on it end it, and so does unknown space; a pedestrian
limits it at the first point they reach before the car has passed it.

It is a barrier on the best knowledge of one scanner, not a proof: what the scanner cannot see
is not in it, and cars count as standing where they are.
"""

import math
from dataclasses import dataclass

import numpy as np

from shield.errors import Array
from shield.estimation.clusters import Track
from shield.vehicle import VehicleGeometry
from shield.world.surroundings import Surroundings

__all__ = ["HORIZON", "StoppingBarrier"]

HORIZON = 30.0  # [m] length of path that is looked at: twice the braking distance from 12 m/s
STEP = 0.5  # [m] between two points of the path that pedestrians are tested against
MIN_CURVATURE = 1e-4  # [1/m] straighter arcs count as arcs of this curvature
BODY_MARGIN = 0.3  # [m] beside the body, for points
PEDESTRIAN_MARGIN = 1.0  # [m] beside the body, for pedestrians: they stumble and turn
PEDESTRIAN_STANDOFF = 3.5  # [m] from the scanner to a pedestrian
UNKNOWN_STANDOFF = 3.0  # [m] from the scanner to unknown space: more than it ever comes near
PASSING_MARGIN = 1.5  # [m] behind the car until it has passed a pedestrian's path
MIN_PASSING_SPEED = 3.0  # [m/s] a slower car counts as passing a pedestrian at this speed


class StoppingBarrier:
    """Bounds the speed by the free path ahead; the numbers are those of `BarrierConfig`."""

    def __init__(
        self,
        vehicle: VehicleGeometry,
        wheelbase: float,
        braking: float,
        delay: float,
        standoff: float,
    ) -> None:
        self._wheelbase = wheelbase
        self._braking, self._delay, self._standoff = braking, delay, standoff
        self._half_width = 0.5 * vehicle.width + BODY_MARGIN
        self._pedestrian_room = 0.5 * vehicle.width + PEDESTRIAN_MARGIN
        self._body = vehicle.length + PASSING_MARGIN
        self._along: Array = np.arange(0.0, HORIZON, STEP)

    def max_speed(self, around: Surroundings, steering: float) -> float:
        """Return the speed [m/s] from which the car stops on a steering's arc, infinite if free."""
        curvature = math.tan(steering) / self._wheelbase
        bend = math.copysign(max(abs(curvature), MIN_CURVATURE), curvature)
        arc = _Arc(1.0 / bend, around.scanner.mount)
        points = self._swept(arc, around.points)
        free = min(
            # One point alone may be rain, so the second counts.
            (float(np.partition(points, 1)[1]) if len(points) > 1 else math.inf) - self._standoff,
            self._free_of_pedestrians(arc, around) - PEDESTRIAN_STANDOFF,
            float(self._swept(arc, around.frontier).min(initial=math.inf)) - UNKNOWN_STANDOFF,
        )
        if math.isinf(free):
            return math.inf
        braking, room = self._braking, max(free, 0.0)
        lost = braking * self._delay
        return max(0.0, math.sqrt(lost**2 + 2.0 * braking * room) - lost)

    def _swept(self, arc: "_Arc", points: Array) -> Array:
        """Distances along the arc of the points (n, 2) that the car would sweep (m,) [m]."""
        along, aside = arc.locate(points)
        return along[(along > 0.0) & (np.abs(aside) < self._half_width)]

    def _free_of_pedestrians(self, arc: "_Arc", around: Surroundings) -> float:
        """Length of the arc up to where a pedestrian will be before the car has passed [m]."""
        if not around.pedestrians:
            return math.inf
        passed = (self._along + self._body) / max(around.speed, MIN_PASSING_SPEED)
        places = arc.places(self._along)
        blocked = np.zeros(len(places), np.bool_)
        for pedestrian in around.pedestrians:
            enters, leaves = _crossing_times(pedestrian, places, self._pedestrian_room)
            blocked |= (leaves > 0.0) & (enters < passed)
        return float(self._along[blocked].min(initial=math.inf))


@dataclass(frozen=True, slots=True)
class _Arc:
    """Path of the sensor, in its own frame: a circle around (-mount, radius) [m]."""

    radius: float
    mount: float

    @property
    def _sensor(self) -> tuple[float, float]:
        """Its distance from the middle [m] and its bearing from there [rad]."""
        return math.hypot(self.mount, self.radius), math.atan2(-self.radius, self.mount)

    def locate(self, points: Array) -> tuple[Array, Array]:
        """Distance along the arc and from it of points (n, 2): two times (n,) [m]."""
        reach, start = self._sensor
        x, y = points[:, 0] + self.mount, points[:, 1] - self.radius
        turned = math.copysign(1.0, self.radius) * (np.arctan2(y, x) - start)
        along = reach * ((turned + math.pi) % (2.0 * math.pi) - math.pi)
        return along, np.hypot(x, y) - reach

    def places(self, along: Array) -> Array:
        """Points (m, 2) of the arc at distances (m,) [m]."""
        reach, start = self._sensor
        angle = start + math.copysign(1.0, self.radius) * along / reach
        centre = np.array([-self.mount, self.radius])
        return np.asarray(centre + reach * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def _crossing_times(pedestrian: Track, places: Array, room: float) -> tuple[Array, Array]:
    """When a pedestrian comes within `room` of places (m, 2), and leaves [s]; -inf if never."""
    apart = pedestrian.position - places
    pace = float(pedestrian.velocity @ pedestrian.velocity)
    half = apart @ pedestrian.velocity
    inside = half**2 - pace * ((apart**2).sum(axis=1) - room**2)
    root = np.sqrt(np.where(inside > 0.0, inside, np.nan))
    times = (-half - root) / pace, (-half + root) / pace
    return np.nan_to_num(times[0], nan=-math.inf), np.nan_to_num(times[1], nan=-math.inf)
