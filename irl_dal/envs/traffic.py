"""Everything else on the road.

Standing and slow cars and barrels are in the ego's own lane, oncoming cars in the others.
There is always an admissible way: nothing stands or drives in the passing lane, and obstacles in
the home lane keep a distance in which the car can go back to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from irl_dal.envs.road import HOME_LANE, LANE_WIDTH, PASSING_LANE, Road, RoadPoint
from irl_dal.envs.vehicle import REAR_OVERHANG
from irl_dal.envs.world import Colour, World


@dataclass(slots=True)
class Obstacle:
    """One body on the road.

    Attributes:
        kind: "car" or "barrel".
        size: Length, width, height [m].
        s: Arc length of its centre along the centre line [m].
        d: Offset of its centre to the left of the centre line [m].
        cruise: Speed it would like along the road [m/s]; negative for oncoming traffic.
        speed: Speed it has [m/s].
        bodies: Its bodies in the world.
    """

    kind: str
    size: tuple[float, float, float]
    s: float
    d: float
    cruise: float = 0.0
    speed: float = 0.0
    bodies: tuple[int, ...] = ()

    @property
    def colour(self) -> Colour:
        """Barrels are orange; cars have the colour of their size and place."""
        if self.kind == "barrel":
            return (0.90, 0.40, 0.08)
        shades: Sequence[Colour] = (
            (0.16, 0.24, 0.52),
            (0.78, 0.78, 0.80),
            (0.10, 0.10, 0.11),
            (0.20, 0.42, 0.30),
        )
        return shades[int(self.size[0] * 100.0) % len(shades)]


@dataclass(frozen=True, slots=True)
class TrafficDensity:
    """How much there is on the road, per 100 m.

    Attributes:
        standing: Standing cars and barrels in the home lane.
        slow: Slow cars to overtake in the home lane.
        oncoming: Cars in the other direction's lanes.
        min_gap: Smallest free distance between two obstacles of the home lane [m].
    """

    standing: float
    slow: float
    oncoming: float
    min_gap: float


DENSITY = {
    "easy": TrafficDensity(standing=0.6, slow=0.0, oncoming=0.4, min_gap=70.0),
    "paper": TrafficDensity(standing=1.2, slow=0.4, oncoming=1.0, min_gap=48.0),
    "hard": TrafficDensity(standing=1.8, slow=0.8, oncoming=1.8, min_gap=38.0),
}
"""`easy`: a first drive. `paper`: the default. `hard`: little room between two manoeuvres."""


class Traffic:
    """Places obstacles and moves those that move.

    Args:
        world: Where they live.
        road: Road they keep to.
        density: How many of them.
        rng: Source of their places, sizes and speeds.
    """

    HEADWAY = 1.2
    """Time gap that a following car keeps [s]."""

    STANDOFF = 5.0
    """Free distance at which it stands behind an obstacle [m]."""

    def __init__(
        self, world: World, road: Road, density: TrafficDensity, rng: np.random.Generator
    ) -> None:
        self._world = world
        self._road = road
        self.obstacles = self._own_lane(density, rng) + self._oncoming(density, rng)
        for obstacle in self.obstacles:
            obstacle.bodies = self._build(obstacle)
            self._place(obstacle)

    def step(self, dt: float, ego: RoadPoint) -> None:
        """Move what moves by `dt` [s]; followers keep their distance, to the ego car too."""
        for obstacle in self.obstacles:
            if obstacle.cruise == 0.0:
                continue
            obstacle.speed = self._follow(obstacle, ego, dt)
            obstacle.s += obstacle.speed * dt
            self._place(obstacle)

    def _follow(self, obstacle: Obstacle, ego: RoadPoint, dt: float) -> float:
        if obstacle.cruise < 0.0:
            return obstacle.cruise
        gaps = [
            other.s - obstacle.s - 0.5 * (other.size[0] + obstacle.size[0])
            for other in self.obstacles
            if other is not obstacle
            and other.s > obstacle.s
            and abs(other.d - obstacle.d) < 0.5 * LANE_WIDTH
        ]
        if ego.s > obstacle.s and abs(ego.d - obstacle.d) < 0.75 * LANE_WIDTH:
            gaps.append(ego.s - REAR_OVERHANG - obstacle.s - 0.5 * obstacle.size[0])
        wanted = obstacle.cruise
        if gaps:
            wanted = min(wanted, max(0.0, (min(gaps) - self.STANDOFF) / self.HEADWAY))
        return min(obstacle.speed + 2.0 * dt, max(wanted, obstacle.speed - 5.0 * dt))

    def _own_lane(self, density: TrafficDensity, rng: np.random.Generator) -> list[Obstacle]:
        """Obstacles of the home lane from 40 m after the start to 25 m before the goal."""
        start, stop = 40.0, self._road.length - 25.0
        room = max(0.0, stop - start)
        count = max(
            1,
            min(
                round(room / 100.0 * (density.standing + density.slow)),
                int(room / density.min_gap) + 1,
            ),
        )
        share = density.slow / (density.standing + density.slow)
        slack = np.sort(rng.uniform(0.0, max(0.0, room - (count - 1) * density.min_gap), count))
        places = start + slack + density.min_gap * np.arange(count)
        return [
            self._slow_car(float(s), rng) if rng.random() < share else self._standing(float(s), rng)
            for s in places
        ]

    def _standing(self, s: float, rng: np.random.Generator) -> Obstacle:
        d = HOME_LANE + float(rng.uniform(-0.4, 0.4))
        if rng.random() < 0.4:
            return Obstacle("barrel", (0.7, 0.7, 1.1), s, d)
        return Obstacle("car", _car_size(rng), s, d)

    def _slow_car(self, s: float, rng: np.random.Generator) -> Obstacle:
        speed = float(rng.uniform(2.0, 4.5))
        return Obstacle("car", _car_size(rng), s, HOME_LANE, cruise=speed, speed=speed)

    def _oncoming(self, density: TrafficDensity, rng: np.random.Generator) -> list[Obstacle]:
        """Oncoming cars spread over the road and what they will have driven meanwhile."""
        span = 2.0 * self._road.length
        lanes = {lane: 0.0 for lane in (-PASSING_LANE, -HOME_LANE)}
        cars = []
        for _ in range(round(density.oncoming * span / 100.0)):
            lane = float(rng.choice(list(lanes)))
            lanes[lane] += 15.0 + float(rng.exponential(60.0 / density.oncoming))
            speed = -7.0 if lane == -PASSING_LANE else -6.0
            cars.append(
                Obstacle("car", _car_size(rng), 30.0 + lanes[lane], lane, cruise=speed, speed=speed)
            )
        return cars

    def _build(self, obstacle: Obstacle) -> tuple[int, ...]:
        length, width, height = obstacle.size
        if obstacle.kind == "barrel":
            return (self._world.cylinder(0.5 * width, height, obstacle.colour),)
        body = self._world.box((length, width, 0.62 * height), obstacle.colour)
        cabin = self._world.box(
            (0.55 * length, 0.88 * width, 0.36 * height), (0.13, 0.15, 0.19), solid=False
        )
        return (body, cabin)

    def _place(self, obstacle: Obstacle) -> None:
        """Put it on the road; beyond the ends of the road it waits far below the ground."""
        length, _, height = obstacle.size
        x, y, yaw = self._road.pose(obstacle.s, obstacle.d)
        hidden = not self._road.s[0] < obstacle.s < self._road.s[-1]
        depth = -100.0 if hidden else 0.0
        if obstacle.kind == "barrel":
            self._world.move(obstacle.bodies[0], (x, y, depth + 0.5 * height), yaw)
            return
        body, cabin = obstacle.bodies
        self._world.move(body, (x, y, depth + 0.22 + 0.31 * height), yaw)
        back = 0.06 * length * (1.0 if obstacle.cruise >= 0.0 else -1.0)
        at = (x - back * np.cos(yaw), y - back * np.sin(yaw), depth + 0.20 + 0.80 * height)
        self._world.move(cabin, at, yaw)


def _car_size(rng: np.random.Generator) -> tuple[float, float, float]:
    length, width, height = rng.uniform((3.8, 1.65, 1.40), (4.9, 1.95, 1.65))
    return float(length), float(width), float(height)
