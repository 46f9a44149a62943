"""Let a small robot with a 270 degree scanner drive at random among people, and touch nothing.

No lanes: a round yard with posts and with people who walk about. `ShieldedEnv` asks `sense` for
scan and speed after every step, and executes only what a certified stop can follow.
"""

import math

import gymnasium
import numpy as np

from shield import ActuatorLimits, Assumptions, PredictiveFilter, ScannerGeometry, VehicleGeometry
from shield.gym import Reading, ShieldedEnv

LIMITS = ActuatorLimits(max_speed=3.0, max_steering=0.7, wheelbase=0.4)
BODY = VehicleGeometry(length=0.7, width=0.5, front_bumper=0.55)
SCANNER = ScannerGeometry(beams=270, field_of_view=math.radians(270.0), max_range=15.0, mount=0.5)
PEOPLE, POSTS, FENCE = 6, 10, 48  # everything is a disc
RADII = np.repeat([0.25, 0.5, 0.8], [PEOPLE, POSTS, FENCE])  # [m]
WALK, YARD = 1.2, 12.0  # [m/s], and [m] from the middle to the fence


class Yard(gymnasium.Env):
    """A robot with the actions (steering [rad], speed [m/s]) among discs."""

    action_space = gymnasium.spaces.Box(LIMITS.low, LIMITS.high, dtype=np.float64)
    observation_space = gymnasium.spaces.Box(0.0, 15.0, (SCANNER.beams,), np.float64)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple:
        """People and posts around the robot, which stands in the middle."""
        super().reset(seed=seed)
        angle = np.append(np.arange(PEOPLE + POSTS) * 2.4, np.linspace(0.0, 2.0 * np.pi, FENCE))
        away = np.full(len(angle), YARD)
        away[: PEOPLE + POSTS] = self.np_random.uniform(3.0, 10.0, PEOPLE + POSTS)
        self.places = np.stack([away * np.cos(angle), away * np.sin(angle)], axis=1)
        self.heading = self.np_random.uniform(-math.pi, math.pi, PEOPLE)
        self.place, self.yaw, self.speed, self.yaw_rate = np.zeros(2), 0.0, 0.0, 0.0
        return self._scan(), {}

    def step(self, action: np.ndarray) -> tuple:
        """Drive a period; people walk on, and turn round where something stands in their way."""
        steering, self.speed = map(float, action)
        self.yaw_rate = self.speed * math.tan(steering) / LIMITS.wheelbase
        way = self.yaw + 0.5 * LIMITS.dt * self.yaw_rate
        self.place += LIMITS.dt * self.speed * np.array([math.cos(way), math.sin(way)])
        self.yaw += LIMITS.dt * self.yaw_rate
        way = np.stack([np.cos(self.heading), np.sin(self.heading)], axis=1)
        ahead = self.places[:PEOPLE] + LIMITS.dt * WALK * way
        apart = np.linalg.norm(ahead[:, None] - self.places[PEOPLE:], axis=2).min(axis=1)
        self.places[:PEOPLE] = np.where(apart[:, None] < 1.2, self.places[:PEOPLE], ahead)
        self.heading += np.where(apart < 1.2, 2.5, 0.0)
        return self._scan(), 0.0, self.speed > 0.0 and self._gap() <= 0.0, False, {}

    def _gap(self) -> float:
        """Distance from the body to the nearest thing [m]."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        local = (self.places - self.place) @ np.array([[cos, -sin], [sin, cos]])
        beyond = np.abs(local - (BODY.front_bumper - 0.5 * BODY.length, 0.0))
        beyond = np.maximum(beyond - (0.5 * BODY.length, 0.5 * BODY.width), 0.0)
        return float((np.linalg.norm(beyond, axis=1) - RADII).min())

    def _scan(self) -> np.ndarray:
        """Ranges [m] with noise, the maximum where nothing returns."""
        nose = np.array([math.cos(self.yaw), math.sin(self.yaw)])
        away = self.places - self.place - SCANNER.mount * nose
        bearings = SCANNER.angles + self.yaw
        along = away @ np.stack([np.cos(bearings), np.sin(bearings)])
        depth = (RADII**2 - (away**2).sum(axis=1))[:, None] + along**2
        hits = np.where((depth > 0.0) & (along > 0.0), along - np.sqrt(np.abs(depth)), np.inf)
        noise = self.np_random.uniform(-0.03, 0.03, SCANNER.beams)
        return np.clip(hits.min(axis=0) + noise, 0.01, SCANNER.max_range)


def sense(env: gymnasium.Env, observation: np.ndarray, info: dict) -> Reading:
    """What the filter needs of a step."""
    return Reading(observation, env.unwrapped.speed, env.unwrapped.yaw_rate)


def drive(env: gymnasium.Env, steps: int) -> str:
    """Drive with random commands, each held for a second; a robot that stands begins anew."""
    rng, hits, way, stands, wish = np.random.default_rng(0), 0, 0.0, 30, None
    for step in range(steps):
        if stands >= 30:
            env.reset(seed=int(rng.integers(1000)))
        wish = rng.uniform([-0.3, 0.5], [0.3, 3.0]) if step % 10 == 0 else wish
        _, _, terminated, _, _ = env.step(wish)
        stands = 30 if terminated else stands + 1 if env.unwrapped.speed < 0.05 else 0
        hits, way = hits + terminated, way + LIMITS.dt * env.unwrapped.speed
    return f"{way:.0f} m in {steps} steps, {hits} contacts while it moved"


def main(steps: int = 1000) -> None:
    """Without the filter, then with it."""
    shield = PredictiveFilter(LIMITS, BODY, SCANNER, Assumptions(understeer=0.0))
    print("without the filter:", drive(Yard(), steps))
    print("with it:           ", drive(ShieldedEnv(Yard(), shield, sense=sense), steps))


if __name__ == "__main__":
    main()
