"""Everything else on the road.

Standing cars and barrels and slow cars are in the ego's own lane, oncoming cars in the others, and
pedestrians cross. There is always an admissible way: nothing stands or drives in the passing lane,
obstacles in the home lane keep a distance in which the car can go back to it, and a pedestrian
enters the ego's lanes only where the ego can stop before the crossing at 2 m/s^2.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from irl_dal.envs.road import HALF_WIDTH, HOME_LANE, LANE_WIDTH, PASSING_LANE, Road, RoadPoint
from irl_dal.envs.world import World
from shield import VehicleGeometry

ACTIVE = 85.0  # Distance from the ego beyond which nothing has a body [m]: the camera sees 75 m
PULL_OUT = 60.0  # A slow car begins to drive this near to the ego [m]: else it would not be met
HIDING, HIDDEN_AHEAD = 25.0, 4.0  # A slow car this far before or behind hides a pedestrian [m]
# Standing obstacles this far behind or before a crossing would hide it [m]
SHADOW_BEFORE, SHADOW_BEHIND = 14.0, 28.0
# Between two crossings, from the start to the first and from the last to the goal [m]
CROSSING_GAP, FIRST_CROSSING, LAST_CROSSING = 30.0, 45.0, 10.0
# From the start to the first obstacle of the home lane and from the last to the goal [m]: room to
# reach the cruising speed, and to return to the lane
FIRST_OBSTACLE, LAST_OBSTACLE = 40.0, 25.0
WIDEST_BEND = 1.0 / 20.0  # Nothing is put where the centre line bends more than this [1/m]
# Stretch of road around a standing obstacle that must not bend, and step of its search [m]
CALM_BEFORE, CALM_BEHIND, CALM_STEP = 15.0, 10.0, 2.0
SIDEWAYS, BARRELS = 0.4, 0.4  # Largest offset of standing obstacles [m]; share of barrels
# Of slow cars, and of oncoming cars in their passing and home lane [m/s]
SLOW_SPEEDS, INNER_SPEED, OUTER_SPEED = (2.0, 5.0), -7.0, -6.0
# Oncoming cars begin on so many route lengths, from here on [m]; some beyond the road's end
ONCOMING_SPAN, ONCOMING_START = 2.0, 30.0
# Least distance between two oncoming cars of a lane, and mean of what is added to it at one car per
# 100 m [m]
ONCOMING_GAP, ONCOMING_SPREAD = 15.0, 60.0
LANE_SHARE = 0.45  # Of a lane, free on both sides of its centre for oncoming traffic
CROSSING_WIDTH = 2.4  # A car brakes for a pedestrian nearer than this to its own line [m]
EGO_BESIDE = 0.75  # Share of a lane within which the ego is ahead of a car, not beside it
ACCELERATION, DECELERATION = 2.0, 5.0  # Of other cars at most [m/s^2]
# Length, width and height of barrels, footprint and heights of pedestrians [m]
BARREL, PEDESTRIAN, PEDESTRIAN_HEIGHTS = (0.7, 0.7, 1.1), (0.5, 0.5), (1.6, 1.9)
SMALLEST_CAR, LARGEST_CAR = (3.8, 1.65, 1.40), (4.9, 1.95, 1.65)  # Length, width and height [m]
PLACEMENTS = 20  # Places tried for each pedestrian
PAVEMENT = 1.5  # Distance of start and goal from the edges of the road [m]
COMFORTABLE = 2.0  # Deceleration at which the ego must be able to stop before the crossing [m/s^2]
MARGIN = 7.0  # Distance that is then left to the crossing [m]
# From the ego's lanes to where a pedestrian waits, on their side and coming from the other [m]
KERB, REFUGE = 0.5, 0.9
# The ego has passed this far beyond a crossing [m]; below this speed [m/s], and further from the
# crossing than this [m], it stands to let the pedestrian cross
EGO_PASSED, EGO_STANDS, EGO_WAITS = 8.0, 0.5, 2.0
REACHED = 0.2  # Within this distance of the ego's lanes a pedestrian stops if it has to wait [m]
EGO_SPEED = 8.0  # Speed of the ego that a pedestrian expects [m/s]: how early it sets off
FROM_THE_RIGHT = 0.6  # Probability that a pedestrian starts on the ego's side
# Range of walking speeds [m/s] and of distances to the ego at which the lanes are reached [m]
SPEEDS, NOTICES = (1.0, 1.5), (30.0, 40.0)
# Of a pedestrian who sets off [m/s^2]: gait initiation stays below; one may stop at once
STRIDE_ACCELERATION = 1.0
ORANGE, MAGENTA = (0.90, 0.40, 0.08), (0.85, 0.15, 0.60)
SKIN, GLASS = (0.80, 0.60, 0.48), (0.13, 0.15, 0.19)
PAINTS = ((0.16, 0.24, 0.52), (0.78, 0.78, 0.80), (0.10, 0.10, 0.11), (0.20, 0.42, 0.30))


@dataclass(frozen=True, slots=True)
class Crossing:
    """A way across the road."""

    start: float  # `d` at the beginning [m]
    goal: float  # `d` at the end [m]
    speed: float  # [m/s]
    notice: float  # Distance of the ego's bumper when the pedestrian should reach its lanes [m]

    def pace(self, d: float, gap: float, ego_speed: float, *, wait: bool) -> float:
        """Sideways speed to reach [m/s], positive to the left, at offset `d` [m].

        `gap` leads from the ego's bumper to the crossing [m], negative once it has passed; `wait`
        says that another car is too near.
        """
        way = 1.0 if self.goal > self.start else -1.0
        if way * (self.goal - d) <= 0.0:
            return 0.0
        entry = -HALF_WIDTH - KERB if way > 0.0 else REFUGE
        before = way * (entry - d)
        if before < 0.0:
            return way * self.speed
        lead = EGO_SPEED * before / self.speed
        if d == self.start and (gap > self.notice + lead or gap < 0.0):
            return 0.0
        stopping = ego_speed**2 / (2.0 * COMFORTABLE) + MARGIN
        ego_waits = ego_speed < EGO_STANDS and gap > EGO_WAITS
        clear = gap > stopping or gap < -EGO_PASSED or ego_waits
        if before <= REACHED and (wait or not clear):
            return 0.0
        return way * self.speed


@dataclass(slots=True)
class Obstacle:
    """One body on the road."""

    kind: str  # "car", "barrel" or "pedestrian"
    size: tuple[float, float, float]  # Length, width, height [m]
    s: float  # Arc length of its centre along the centre line [m]
    d: float  # Offset of its centre to the left of the centre line [m]
    cruise: float = 0.0  # Cruising speed along the road [m/s]; negative for oncoming traffic
    speed: float = 0.0  # Present speed along the road [m/s]
    # Its bodies in the world, none far from the ego: number, place along it and height [m]
    bodies: tuple[tuple[int, float, float], ...] = ()
    crossing: Crossing | None = None  # The way of a pedestrian across the road
    stride: float = 0.0  # Present speed of a pedestrian on it, positive to the left [m/s]


@dataclass(frozen=True, slots=True)
class TrafficDensity:
    """How much there is on the road, per 100 m."""

    standing: float  # Standing cars and barrels in the home lane
    slow: float  # Slow cars to overtake in the home lane
    oncoming: float  # Cars in the other direction's lanes
    pedestrians: float  # Crossing pedestrians
    min_gap: float  # Smallest free distance between two obstacles of the home lane [m]


# `easy`: a first drive. `paper`: the default. `hard`: little room between two manoeuvres.
DENSITY = {
    "easy": TrafficDensity(standing=0.6, slow=0.0, oncoming=0.4, pedestrians=0.05, min_gap=70.0),
    "paper": TrafficDensity(standing=1.0, slow=0.3, oncoming=0.8, pedestrians=0.12, min_gap=50.0),
    "hard": TrafficDensity(standing=1.5, slow=0.6, oncoming=1.5, pedestrians=0.4, min_gap=38.0),
}


class Traffic:
    """Places obstacles and moves those that move."""

    HEADWAY = 1.2  # Time gap that a following car keeps [s]
    STANDOFF = 5.0  # Free distance at which it stands behind an obstacle [m]

    def __init__(
        self,
        world: World,
        road: Road,
        density: TrafficDensity,
        rng: np.random.Generator,
        vehicle: VehicleGeometry,
    ) -> None:
        self._world, self._road, self._vehicle = world, road, vehicle
        own = self._own_lane(density, rng)
        self.obstacles = own + self._pedestrians(density, own, rng) + self._oncoming(density, rng)
        for obstacle in self.obstacles:
            self._place(obstacle, 0.0)

    def step(self, dt: float, ego: RoadPoint, speed: float) -> None:
        """Move what moves by `dt` [s]; cars keep a distance to the ego, which has `speed` [m/s]."""
        for obstacle in self.obstacles:
            if obstacle.crossing is not None:
                gap = obstacle.s - ego.s - self._vehicle.front_bumper
                # Behind a slow car the ego cannot see the pedestrian.
                slow = [other.s for other in self.obstacles if other.cruise > 0.0]
                wait = any(-HIDDEN_AHEAD < obstacle.s - s < HIDING for s in slow)
                pace = obstacle.crossing.pace(obstacle.d, gap, speed, wait=wait)
                most = abs(obstacle.stride) + STRIDE_ACCELERATION * dt
                obstacle.stride = min(max(pace, -most), most)
                obstacle.d += dt * obstacle.stride
            elif obstacle.cruise > 0.0 and obstacle.s - ego.s > PULL_OUT and obstacle.speed == 0.0:
                continue
            elif obstacle.cruise != 0.0:
                obstacle.speed = self._follow(obstacle, ego, dt)
                obstacle.s += obstacle.speed * dt
            self._place(obstacle, ego.s)

    def _follow(self, car: Obstacle, ego: RoadPoint, dt: float) -> float:
        """Speed that keeps a distance to what is ahead in the car's own direction [m/s]."""
        way = 1.0 if car.cruise > 0.0 else -1.0
        gaps = [
            way * (other.s - car.s) - 0.5 * (other.size[0] + car.size[0])
            for other in self.obstacles
            if way * (other.s - car.s) > 0.0
            and abs(other.d - car.d) < (CROSSING_WIDTH if other.crossing else 0.5 * LANE_WIDTH)
            and other.d > -HALF_WIDTH
        ]
        if way > 0.0 and ego.s > car.s and abs(ego.d - car.d) < EGO_BESIDE * LANE_WIDTH:
            gaps.append(ego.s - self._vehicle.rear_overhang - car.s - 0.5 * car.size[0])
        target = abs(car.cruise)
        if gaps:
            target = min(target, max(0.0, (min(gaps) - self.STANDOFF) / self.HEADWAY))
        now = abs(car.speed)
        return way * min(now + ACCELERATION * dt, max(target, now - DECELERATION * dt))

    def _own_lane(self, density: TrafficDensity, rng: np.random.Generator) -> list[Obstacle]:
        """Obstacles of the home lane, as many as the density says and the gaps allow."""
        start, stop = FIRST_OBSTACLE, self._road.length - LAST_OBSTACLE
        room = max(0.0, stop - start)
        total = density.standing + density.slow
        count = max(1, min(round(room / 100.0 * total), int(room / density.min_gap) + 1))
        share = density.slow / total
        slack = np.sort(rng.uniform(0.0, max(0.0, room - (count - 1) * density.min_gap), count))
        drawn = start + slack + density.min_gap * np.arange(count)
        places = [self._calm_place(float(s), stop) for s in drawn]
        return [_home_obstacle(s, share, rng) for s in places]

    def _calm_place(self, s: float, stop: float) -> float:
        """`s`, or the next place before `stop` around which the road does not bend too much [m]."""
        road = self._road
        for place in np.arange(s, max(stop, s + 0.5), CALM_STEP):
            around = (road.s > place - CALM_BEFORE) & (road.s < place + CALM_BEHIND)
            if np.abs(road.curvature[around]).max(initial=0.0) < WIDEST_BEND:
                return float(place)
        return s

    def _pedestrians(
        self, density: TrafficDensity, own: Sequence[Obstacle], rng: np.random.Generator
    ) -> list[Obstacle]:
        """Pedestrians, none of them hidden by what stands in the home lane."""
        number = self._road.length / 100.0 * density.pedestrians
        count = int(number) + int(rng.random() < number % 1.0)
        drawn: list[Obstacle] = []
        for _ in range(PLACEMENTS * count):
            s = float(rng.uniform(FIRST_CROSSING, self._road.length - LAST_CROSSING))
            crossing = draw_crossing(rng, float(np.interp(s, self._road.s, self._road.left_edge)))
            hidden = any(-SHADOW_BEFORE < s - o.s < SHADOW_BEHIND and o.cruise == 0.0 for o in own)
            apart = all(abs(s - other.s) > CROSSING_GAP for other in drawn)
            if len(drawn) < count and not hidden and apart:
                size = (*PEDESTRIAN, float(rng.uniform(*PEDESTRIAN_HEIGHTS)))
                drawn.append(Obstacle("pedestrian", size, s, crossing.start, crossing=crossing))
        return drawn

    def _oncoming(self, density: TrafficDensity, rng: np.random.Generator) -> list[Obstacle]:
        """Oncoming cars on the road and beyond it."""
        span = ONCOMING_SPAN * self._road.length
        room = float(self._road.left_edge.min())
        offsets = (-PASSING_LANE, -HOME_LANE)
        lanes = {lane: 0.0 for lane in offsets if lane + LANE_SHARE * LANE_WIDTH < room}
        cars: list[Obstacle] = []
        for _ in range(round(density.oncoming * span / 100.0) if lanes else 0):
            lane = float(rng.choice(list(lanes)))
            lanes[lane] += ONCOMING_GAP + float(rng.exponential(ONCOMING_SPREAD / density.oncoming))
            speed = INNER_SPEED if lane == -PASSING_LANE else OUTER_SPEED
            place = ONCOMING_START + lanes[lane], lane
            cars.append(Obstacle("car", _car_size(rng), *place, cruise=speed, speed=speed))
        return cars

    def _build(self, obstacle: Obstacle) -> tuple[tuple[int, float, float], ...]:
        world, (length, width, height) = self._world, obstacle.size
        if obstacle.kind == "barrel":
            return ((world.cylinder(0.5 * width, height, ORANGE), 0.0, 0.5 * height),)
        if obstacle.kind == "pedestrian":
            head = world.box((0.24, 0.22, 0.26), SKIN, solid=False)
            body = world.cylinder(0.5 * width, height - 0.25, MAGENTA)
            return (body, 0.0, 0.5 * height - 0.125), (head, 0.0, height - 0.12)
        paint = PAINTS[int(length * 100.0) % len(PAINTS)]
        body = world.box((length, width, 0.62 * height), paint)
        cabin = world.box((0.55 * length, 0.88 * width, 0.36 * height), GLASS, solid=False)
        ahead = 0.06 * length * (-1.0 if obstacle.cruise >= 0.0 else 1.0)
        return (body, 0.0, 0.22 + 0.31 * height), (cabin, ahead, 0.20 + 0.80 * height)

    def _place(self, obstacle: Obstacle, ego: float) -> None:
        """Put it on the road; far from the ego at `ego` [m] it has no bodies."""
        s = obstacle.s
        if not self._road.s[0] < s < self._road.s[-1] or abs(s - ego) > ACTIVE:
            for body, _, _ in obstacle.bodies:
                self._world.remove(body)
            obstacle.bodies = ()
            return
        if obstacle.bodies and obstacle.cruise == 0.0 and obstacle.crossing is None:
            return
        obstacle.bodies = obstacle.bodies or self._build(obstacle)
        x, y, yaw = self._road.pose(s, obstacle.d)
        for body, ahead, z in obstacle.bodies:
            self._world.move(body, (x + ahead * np.cos(yaw), y + ahead * np.sin(yaw), z), yaw)


def _home_obstacle(s: float, share: float, rng: np.random.Generator) -> Obstacle:
    """A slow car, with a probability of `share`, or a standing obstacle at `s` [m]."""
    if rng.random() < share:
        size = _car_size(rng)
        return Obstacle("car", size, s, HOME_LANE, cruise=float(rng.uniform(*SLOW_SPEEDS)))
    d = HOME_LANE + float(rng.uniform(-SIDEWAYS, SIDEWAYS))
    barrel = rng.random() < BARRELS
    return Obstacle("barrel", BARREL, s, d) if barrel else Obstacle("car", _car_size(rng), s, d)


def _car_size(rng: np.random.Generator) -> tuple[float, float, float]:
    length, width, height = rng.uniform(SMALLEST_CAR, LARGEST_CAR)
    return float(length), float(width), float(height)


def draw_crossing(rng: np.random.Generator, left_edge: float) -> Crossing:
    """Draw a side, a speed and a distance to the ego; `left_edge` is the edge's `d` [m]."""
    sides = (-HALF_WIDTH - PAVEMENT, left_edge + PAVEMENT)
    start, goal = sides if rng.random() < FROM_THE_RIGHT else sides[::-1]
    return Crossing(start, goal, float(rng.uniform(*SPEEDS)), float(rng.uniform(*NOTICES)))
