"""Drive highway-env's racetrack at random, without and with the predictive filter.

The filter commands a steering angle and a speed. highway-env takes accelerations: `Commands` asks
for the one that reaches the commanded speed within the period. Its cars are exact bicycles with
both axles at the bumpers, 5 m apart, so the filter's geometry is exact, too. Scan and lane come
from the simulator's road and vehicles; its y axis is taken for the filter's left. What may happen
to a car that stands (others run into it) is counted apart.
"""

import math

import gymnasium
import highway_env
import numpy as np

from shield import (
    ActuatorLimits,
    Assumptions,
    LaneEstimate,
    LaneGeometry,
    PredictiveFilter,
    ScannerGeometry,
    VehicleGeometry,
)
from shield.gym import Reading, ShieldedEnv

LENGTH, HALF = 5.0, 2.5  # [m] of a vehicle; to its middle, where highway-env has its position
LIMITS = ActuatorLimits(max_speed=6.0, max_steering=0.5, wheelbase=LENGTH, max_deceleration=6.5)
BODY = VehicleGeometry(length=LENGTH, width=2.0, front_bumper=LENGTH - 0.01)
SCANNER = ScannerGeometry(beams=360, field_of_view=math.tau * 359 / 360, mount=HALF)
HARDEST = 8.0  # [m/s²] acceleration that action 1 stands for
PREVIEW = np.arange(1.0, 11.0)  # [m] along which the lane's curvature is fitted
ENDS = ("contacts", "departures", "times hit at rest")
CONFIG = {
    "action": {
        "type": "ContinuousAction",
        "acceleration_range": [-HARDEST, HARDEST],
        "steering_range": [-LIMITS.max_steering, LIMITS.max_steering],
    },
    "policy_frequency": round(1.0 / LIMITS.dt),
    "simulation_frequency": 2 * round(1.0 / LIMITS.dt),
    "other_vehicles": 8,
}


class Commands(gymnasium.ActionWrapper):
    """Steering [rad] and speed of the rear axle [m/s] in the place of highway-env's actions."""

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        self.action_space = gymnasium.spaces.Box(LIMITS.low, LIMITS.high, dtype=np.float64)
        self.steering = 0.0

    def action(self, action: np.ndarray) -> np.ndarray:
        """Throttle and steering, both in [-1, 1]."""
        self.steering = float(action[0])
        target = action[1] / math.cos(slip(self.steering))
        push = (target - self.unwrapped.vehicle.speed) / LIMITS.dt
        return np.array([push / HARDEST, self.steering / LIMITS.max_steering])


def slip(steering: float) -> float:
    """Angle between heading and motion of a vehicle's middle [rad]."""
    return math.atan(0.5 * math.tan(steering))


def sense(env: gymnasium.Env, observation: np.ndarray, info: dict) -> Reading:
    """Scan, speed, yaw rate and lane as the simulator knows them."""
    car, others = env.unwrapped.vehicle, env.unwrapped.road.vehicles
    beta = slip(env.get_wrapper_attr("steering"))
    corners = [other.polygon() - car.position for other in others if other is not car]
    edges = np.concatenate([np.stack([c[:-1], c[1:]], axis=1) for c in corners])
    speed, turn = car.speed * math.cos(beta), car.speed * math.sin(beta) / HALF
    return Reading(ranges(edges, car.heading), speed, turn, lane(env.unwrapped.road.network, car))


def ranges(edges: np.ndarray, heading: float) -> np.ndarray:
    """Distances (n,) along the beams to the nearest of edges (m, 2, 2) around the scanner [m]."""
    angles = SCANNER.angles + heading
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)[:, None]
    start, way = edges[:, 0], edges[:, 1] - edges[:, 0]
    cross = rays[..., 0] * way[:, 1] - rays[..., 1] * way[:, 0]
    along = (start[:, 0] * way[:, 1] - start[:, 1] * way[:, 0]) / cross
    place = (start[:, 0] * rays[..., 1] - start[:, 1] * rays[..., 0]) / cross
    hit = (along > 0.0) & (place >= 0.0) & (place <= 1.0)
    return np.minimum(np.where(hit, along, np.inf).min(axis=1), SCANNER.max_range)


def lane(network: object, car: object) -> LaneEstimate:
    """Where the rear axle is in the first lane, and how that lane bends ahead."""
    rear = car.position - HALF * np.array([math.cos(car.heading), math.sin(car.heading)])
    start, end, _ = network.get_closest_lane_index(rear, car.heading)
    first = network.get_lane((start, end, 0))
    s, offset = first.local_coordinates(rear)
    headings = []
    for ahead in PREVIEW:
        road, place, here = first, s + ahead, end
        while place > road.length:
            place, following = place - road.length, next(iter(network.graph[here]))
            road, here = network.get_lane((here, following, 0)), following
        headings.append(road.heading_at(place) - first.heading_at(s))
    turned = np.unwrap([0.0, *headings])[1:]
    terms = np.stack([PREVIEW, 0.5 * PREVIEW**2], axis=1)
    curvature, rate = fit = np.linalg.lstsq(terms, turned, rcond=None)[0]
    # Its bends begin at once, which no clothoid does: how far aside the fit is counts as an error.
    error = 0.03 + float(np.abs(np.cumsum(turned - terms @ fit)).max())
    heading = math.remainder(car.heading - first.heading_at(s), math.tau)
    return LaneEstimate(
        offset, heading, float(curvature), float(rate), offset_std=error, age=0.0, valid=True
    )


def blind(env: gymnasium.Env) -> np.ndarray:
    """A driver who keeps the first lane at full speed, and sees no traffic."""
    at = lane(env.unwrapped.road.network, env.unwrapped.vehicle)
    bend = at.curvature - 0.02 * at.lateral_offset - 0.3 * at.heading_error
    return np.array([math.atan(LENGTH * bend), LIMITS.max_speed])


def leaves(env: gymnasium.Env) -> bool:
    """Whether a corner is out of the two lanes."""
    network, car = env.unwrapped.road.network, env.unwrapped.vehicle
    start, end, _ = network.get_closest_lane_index(car.position, car.heading)
    first = network.get_lane((start, end, 0))
    sides = [first.local_coordinates(corner)[1] for corner in car.polygon()]
    return min(sides) < -HALF or max(sides) > 3.0 * HALF


def drive(env: gymnasium.Env, drives: int, *, random: bool) -> str:
    """Drive up to 20 s each, at random (a new command every second) or blindly; how that ends."""
    rng, way, ends, wish = np.random.default_rng(0), 0.0, dict.fromkeys(ENDS, 0), None
    for seed in range(drives):
        env.reset(seed=seed)
        for step in range(200):
            wish = rng.uniform([-0.3, 2.0], [0.3, 6.0]) if step % 10 == 0 else wish
            env.step(wish if random else blind(env))
            car = env.unwrapped.vehicle
            way += LIMITS.dt * car.speed
            if car.crashed or leaves(env):
                moves = abs(car.speed) > 0.1
                ends[ENDS[2 if not moves else 0 if car.crashed else 1]] += 1
                break
    return f"{way:.0f} m in {drives} drives, " + ", ".join(f"{n} {end}" for end, n in ends.items())


def main(drives: int = 4) -> None:
    """Without the filter, then with it."""
    gymnasium.register_envs(highway_env)
    env = Commands(gymnasium.make("racetrack-v0", config=CONFIG))
    assumptions = Assumptions(understeer=0.0, steering_lag=0.0)
    shield = PredictiveFilter(LIMITS, BODY, SCANNER, assumptions, lanes=LaneGeometry(width=5.0))
    shielded = ShieldedEnv(env, shield, sense=sense)
    for name, random in (("random", True), ("blind", False)):
        print(f"{name} driver without the filter: {drive(env, drives, random=random)}")
        print(f"{name} driver with the filter:    {drive(shielded, drives, random=random)}")


if __name__ == "__main__":
    main()
