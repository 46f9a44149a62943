"""Everything else on the road.

Standing cars and barrels and slow cars are in the ego's own lane, oncoming cars in the others, and
pedestrians cross. There is always an admissible way: nothing stands or drives in the passing lane,
obstacles in the home lane keep a distance in which the car can go back to it, and a pedestrian
steps onto the ego's lanes only where the ego can stop in front of him at 2 m/s^2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from irl_dal.envs.pedestrian import Crossing, draw_crossing
from irl_dal.envs.road import HALF_WIDTH, HOME_LANE, LANE_WIDTH, PASSING_LANE, Road, RoadPoint
from irl_dal.envs.world import Colour, World
from shield import VehicleGeometry

ACTIVE = 85.0
"""Distance from the ego beyond which nothing has a body [m]: the camera sees 75 m."""

PULL_OUT = 60.0
"""Distance to the ego at which a slow car begins to drive [m]: else it would not be met."""

HIDING = 25.0
"""Distance behind a pedestrian in which a slow car could hide him from the ego [m]."""

WIDEST_BEND = 1.0 / 20.0
"""Standing obstacles are not put where the centre line bends more than this [1/m]."""


@dataclass(slots=True)
class Obstacle:
    """One body on the road.

    Attributes:
        kind: "car", "barrel" or "pedestrian".
        size: Length, width, height [m].
        s: Arc length of its centre along the centre line [m].
        d: Offset of its centre to the left of the centre line [m].
        cruise: Speed it would like along the road [m/s]; negative for oncoming traffic.
        speed: Speed it has [m/s].
        bodies: Its bodies in the world; none far from the ego.
        crossing: How a pedestrian crosses.
    """

    kind: str
    size: tuple[float, float, float]
    s: float
    d: float
    cruise: float = 0.0
    speed: float = 0.0
    bodies: tuple[int, ...] = ()
    crossing: Crossing | None = None

    @property
    def colour(self) -> Colour:
        """Barrels are orange, pedestrians magenta; cars have the colour of their size."""
        if self.kind == "barrel":
            return (0.90, 0.40, 0.08)
        if self.kind == "pedestrian":
            return (0.85, 0.15, 0.60)
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
        pedestrians: Pedestrians who cross.
        min_gap: Smallest free distance between two obstacles of the home lane [m].
    """

    standing: float
    slow: float
    oncoming: float
    pedestrians: float
    min_gap: float


DENSITY = {
    "easy": TrafficDensity(standing=0.6, slow=0.0, oncoming=0.4, pedestrians=0.05, min_gap=70.0),
    "paper": TrafficDensity(standing=1.0, slow=0.3, oncoming=0.8, pedestrians=0.12, min_gap=50.0),
    "hard": TrafficDensity(standing=1.5, slow=0.6, oncoming=1.5, pedestrians=0.4, min_gap=38.0),
}
"""`easy`: a first drive. `paper`: the default. `hard`: little room between two manoeuvres."""


class Traffic:
    """Places obstacles and moves those that move.

    Args:
        world: Where they live.
        road: Road they keep to.
        density: How many of them.
        rng: Source of their places, sizes and speeds.
        vehicle: Outline of the ego car.
    """

    HEADWAY = 1.2
    """Time gap that a following car keeps [s]."""

    STANDOFF = 5.0
    """Free distance at which it stands behind an obstacle [m]."""

    def __init__(
        self,
        world: World,
        road: Road,
        density: TrafficDensity,
        rng: np.random.Generator,
        vehicle: VehicleGeometry,
    ) -> None:
        self._world = world
        self._vehicle = vehicle
        self._road = road
        own = self._own_lane(density, rng)
        self.obstacles = own + self._pedestrians(density, own, rng) + self._oncoming(density, rng)
        for obstacle in self.obstacles:
            self._place(obstacle, 0.0)

    def step(self, dt: float, ego: RoadPoint, speed: float) -> None:
        """Move what moves by `dt` [s]; everybody keeps a distance, to the ego car too.

        Args:
            dt: Period [s].
            ego: Where the ego's rear axle is.
            speed: Of the ego [m/s].
        """
        for obstacle in self.obstacles:
            if obstacle.crossing is not None:
                gap = obstacle.s - ego.s - self._vehicle.front_bumper
                wait = any(self._keeps_waiting(car, obstacle.s) for car in self.obstacles)
                obstacle.d += dt * obstacle.crossing.pace(obstacle.d, gap, speed, wait=wait)
            elif obstacle.cruise > 0.0 and obstacle.s - ego.s > PULL_OUT and obstacle.speed == 0.0:
                continue
            elif obstacle.cruise != 0.0:
                obstacle.speed = self._follow(obstacle, ego, dt)
                obstacle.s += obstacle.speed * dt
            self._place(obstacle, ego.s)

    def bodies_near(self, s: float, reach: float = 15.0) -> list[int]:
        """Bodies of what is within `reach` [m] of `s`."""
        return [o.bodies[0] for o in self.obstacles if o.bodies and abs(o.s - s) < reach]

    def _keeps_waiting(self, car: Obstacle, s: float) -> bool:
        """Whether a pedestrian at `s` lets a slow car pass: it would hide him from the ego."""
        return car.cruise > 0.0 and -4.0 < s - car.s < HIDING

    def _follow(self, car: Obstacle, ego: RoadPoint, dt: float) -> float:
        """Speed that keeps a distance to what is ahead in the car's own direction [m/s]."""
        way = 1.0 if car.cruise > 0.0 else -1.0
        gaps = [
            way * (other.s - car.s) - 0.5 * (other.size[0] + car.size[0])
            for other in self.obstacles
            if way * (other.s - car.s) > 0.0
            and abs(other.d - car.d) < (2.4 if other.crossing else 0.5 * LANE_WIDTH)
            and other.d > -HALF_WIDTH
        ]
        if way > 0.0 and ego.s > car.s and abs(ego.d - car.d) < 0.75 * LANE_WIDTH:
            gaps.append(ego.s - self._vehicle.rear_overhang - car.s - 0.5 * car.size[0])
        wanted = abs(car.cruise)
        if gaps:
            wanted = min(wanted, max(0.0, (min(gaps) - self.STANDOFF) / self.HEADWAY))
        now = abs(car.speed)
        return way * min(now + 2.0 * dt, max(wanted, now - 5.0 * dt))

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
        drawn = start + slack + density.min_gap * np.arange(count)
        places = [self._calm_place(float(s), stop) for s in drawn]
        return [
            self._slow_car(float(s), rng) if rng.random() < share else self._standing(float(s), rng)
            for s in places
        ]

    def _calm_place(self, s: float, stop: float) -> float:
        """`s`, or the next place before `stop` around which the road does not bend too much [m]."""
        road = self._road
        for place in np.arange(s, max(stop, s + 0.5), 2.0):
            around = (road.s > place - 15.0) & (road.s < place + 10.0)
            if np.abs(road.curvature[around]).max(initial=0.0) < WIDEST_BEND:
                return float(place)
        return s

    def _pedestrians(
        self, density: TrafficDensity, own: Sequence[Obstacle], rng: np.random.Generator
    ) -> list[Obstacle]:
        """Pedestrians, none of them hidden by what stands in the home lane."""
        wanted = self._road.length / 100.0 * density.pedestrians
        count = int(wanted) + int(rng.random() < wanted % 1.0)
        people: list[Obstacle] = []
        for _ in range(20 * count):
            s = float(rng.uniform(45.0, self._road.length - 10.0))
            crossing = draw_crossing(rng, float(np.interp(s, self._road.s, self._road.left_edge)))
            hidden = any(-14.0 < s - o.s < 28.0 and o.cruise == 0.0 for o in own)
            if len(people) < count and not hidden and all(abs(s - p.s) > 30.0 for p in people):
                person = (0.5, 0.5, float(rng.uniform(1.6, 1.9)))
                people.append(Obstacle("pedestrian", person, s, crossing.start, crossing=crossing))
        return people

    def _standing(self, s: float, rng: np.random.Generator) -> Obstacle:
        d = HOME_LANE + float(rng.uniform(-0.4, 0.4))
        if rng.random() < 0.4:
            return Obstacle("barrel", (0.7, 0.7, 1.1), s, d)
        return Obstacle("car", _car_size(rng), s, d)

    def _slow_car(self, s: float, rng: np.random.Generator) -> Obstacle:
        return Obstacle("car", _car_size(rng), s, HOME_LANE, cruise=float(rng.uniform(2.0, 5.0)))

    def _oncoming(self, density: TrafficDensity, rng: np.random.Generator) -> list[Obstacle]:
        """Oncoming cars spread over the road and what they will have driven meanwhile."""
        span = 2.0 * self._road.length
        room = float(self._road.left_edge.min())
        offsets = (-PASSING_LANE, -HOME_LANE)
        lanes = {lane: 0.0 for lane in offsets if lane + 0.45 * LANE_WIDTH < room}
        cars: list[Obstacle] = []
        if not lanes:
            return cars
        for _ in range(round(density.oncoming * span / 100.0)):
            lane = float(rng.choice(list(lanes)))
            lanes[lane] += 15.0 + float(rng.exponential(60.0 / density.oncoming))
            speed = -7.0 if lane == -PASSING_LANE else -6.0
            cars.append(
                Obstacle("car", _car_size(rng), 30.0 + lanes[lane], lane, cruise=speed, speed=speed)
            )
        return cars

    def _build(self, obstacle: Obstacle) -> tuple[int, ...]:
        world, colour = self._world, obstacle.colour
        length, width, height = obstacle.size
        if obstacle.kind == "barrel":
            return (world.cylinder(0.5 * width, height, colour),)
        if obstacle.kind == "pedestrian":
            head = world.box((0.24, 0.22, 0.26), (0.80, 0.60, 0.48), solid=False)
            return (world.cylinder(0.5 * width, height - 0.25, colour), head)
        body = world.box((length, width, 0.62 * height), colour)
        cabin = world.box(
            (0.55 * length, 0.88 * width, 0.36 * height), (0.13, 0.15, 0.19), solid=False
        )
        return (body, cabin)

    def _place(self, obstacle: Obstacle, ego: float) -> None:
        """Put it on the road; far from the ego at `ego` [m] it has no bodies."""
        s = obstacle.s
        if not self._road.s[0] < s < self._road.s[-1] or abs(s - ego) > ACTIVE:
            for body in obstacle.bodies:
                self._world.remove(body)
            obstacle.bodies = ()
            return
        if obstacle.bodies and obstacle.cruise == 0.0 and obstacle.crossing is None:
            return
        obstacle.bodies = obstacle.bodies or self._build(obstacle)
        length, _, height = obstacle.size
        x, y, yaw = self._road.pose(s, obstacle.d)
        if obstacle.kind == "barrel":
            self._world.move(obstacle.bodies[0], (x, y, 0.5 * height), yaw)
        elif obstacle.kind == "pedestrian":
            body, head = obstacle.bodies
            self._world.move(body, (x, y, 0.5 * height - 0.125), yaw)
            self._world.move(head, (x, y, height - 0.12), yaw)
        else:
            body, cabin = obstacle.bodies
            self._world.move(body, (x, y, 0.22 + 0.31 * height), yaw)
            back = 0.06 * length * (1.0 if obstacle.cruise >= 0.0 else -1.0)
            at = (x - back * np.cos(yaw), y - back * np.sin(yaw), 0.20 + 0.80 * height)
            self._world.move(cabin, at, yaw)


def _car_size(rng: np.random.Generator) -> tuple[float, float, float]:
    length, width, height = rng.uniform((3.8, 1.65, 1.40), (4.9, 1.95, 1.65))
    return float(length), float(width), float(height)
