"""Bad drivers, from random commands to steering at people."""

import itertools
from collections.abc import Callable, Mapping

import numpy as np
import torch
from gymnasium import spaces

from irl_dal.arrays import Array, Info, Observation
from irl_dal.config import RunConfig
from irl_dal.envs.road import LANE_WIDTH
from irl_dal.evaluation.agents import PolicyAgent
from irl_dal.learning import build_policy
from irl_dal.loop import ControlLoop

__all__ = ["DRIVERS", "Driver"]

FAST, BRISK = 12.0, 10.0  # [m/s] largest speed, and that of a driver who aims at something
AIM, TURN = 0.15, 0.8  # Steering per offset [rad/m] and per heading error into another lane
NOISE = (0.2, 2.0)  # Deviation of the noisy expert [rad, m/s]

Driver = Callable[[Observation, Info], Array]
"""Command [rad, m/s] (2,) for an observation and the control loop's `info` with it."""

Maker = Callable[[ControlLoop, np.random.Generator], Driver]


class Held:
    """Draws a command and holds it for between `shortest` and `longest` [s]."""

    def __init__(
        self,
        draw: Callable[[], Array],
        loop: ControlLoop,
        rng: np.random.Generator,
        shortest: float,
        longest: float,
    ) -> None:
        self._draw, self._rng, self._left = draw, rng, 0
        self._bounds = round(shortest / loop.limits.dt), round(longest / loop.limits.dt) + 1

    def __call__(self, observation: Observation, info: Info) -> Array:
        """The command that is held."""
        if self._left == 0:
            self._command, self._left = self._draw(), int(self._rng.integers(*self._bounds))
        self._left -= 1
        return self._command


def _expert(loop: ControlLoop, rng: np.random.Generator) -> Driver:
    return lambda _, info: loop.follow(info["expert"].setpoint)


def _fast_expert(loop: ControlLoop, rng: np.random.Generator) -> Driver:
    return lambda _, info: np.array([loop.follow(info["expert"].setpoint)[0], FAST])


def _noisy_expert(loop: ControlLoop, rng: np.random.Generator) -> Driver:
    return lambda _, info: loop.follow(info["expert"].setpoint) + rng.normal(0.0, NOISE)


def _random(loop: ControlLoop, rng: np.random.Generator) -> Driver:
    return lambda *_: rng.uniform(loop.limits.low, loop.limits.high)


def _held_random(loop: ControlLoop, rng: np.random.Generator) -> Driver:
    low, high = loop.limits.low, loop.limits.high
    return Held(lambda: rng.uniform(low, high), loop, rng, 0.5, 3.0)


def _straight(loop: ControlLoop, rng: np.random.Generator) -> Driver:
    return lambda *_: np.array([0.0, FAST])


def _bang_bang(loop: ControlLoop, rng: np.random.Generator) -> Driver:
    most = loop.limits.max_steering
    corners = np.array([(side, speed) for side in (-most, most) for speed in (4.0, FAST)])
    return Held(lambda: np.asarray(rng.choice(corners)), loop, rng, 0.3, 2.0)


def _at_nearest(loop: ControlLoop, rng: np.random.Generator) -> Driver:
    angles = loop.city.config.scanner.angles
    return lambda seen, _: np.array([angles[np.argmin(seen["lidar"])], BRISK])


def _at_moving(loop: ControlLoop, rng: np.random.Generator) -> Driver:
    """Steers at the nearest thing that can move, by the truth."""

    def command(_: Observation, info: Info) -> Array:
        """Straight at it; the expert's steering where nothing moves."""
        scene, (x, y, yaw) = loop.city.scene(), info["pose"]
        movers = [o for o in scene.obstacles if o.bodies and (o.cruise or o.crossing)]
        places = np.array([scene.road.pose(o.s, o.d)[:2] for o in movers]).reshape(-1, 2) - (x, y)
        if not movers:
            return np.array([loop.follow(info["expert"].setpoint)[0], FAST])
        nearest = places[np.argmin(np.hypot(*places.T))]
        bearing = float(np.arctan2(nearest[1], nearest[0])) - yaw
        return np.array([np.arctan2(np.sin(bearing), np.cos(bearing)), BRISK])

    return command


def _oncoming(loop: ControlLoop, rng: np.random.Generator) -> Driver:
    """Keeps to the middle of the inner oncoming lane."""

    def command(_: Observation, info: Info) -> Array:
        """Lane keeping about that offset."""
        lane = info["lane"]
        bend = np.arctan(loop.limits.wheelbase * lane.curvature)
        error = lane.lateral_offset - 2.0 * LANE_WIDTH
        return np.array([bend - AIM * error - TURN * lane.heading_error, BRISK])

    return command


def _brake_accelerate(loop: ControlLoop, rng: np.random.Generator) -> Driver:
    speeds = itertools.cycle((FAST, 0.0))
    pedals = Held(lambda: np.array([0.0, next(speeds)]), loop, rng, 2.0, 2.0)
    expert = _expert(loop, rng)
    return lambda seen, info: np.array([expert(seen, info)[0], pedals(seen, info)[1]])


def _untrained(loop: ControlLoop, rng: np.random.Generator) -> Driver:
    seen, acted = loop.observation_space, loop.action_space
    assert isinstance(seen, spaces.Dict) and isinstance(acted, spaces.Box)
    with torch.random.fork_rng():
        torch.manual_seed(int(rng.integers(2**31)))
        agent = PolicyAgent(build_policy(seen, acted, RunConfig().perception))
    agent.policy.set_training_mode(False)
    return lambda observation, info: loop.limits.to_command(agent.act(observation, info))


DRIVERS: Mapping[str, Maker] = {
    "expert": _expert,
    "expert at full speed": _fast_expert,
    "expert with noise": _noisy_expert,
    "random": _random,
    "held random": _held_random,
    "straight on": _straight,
    "bang-bang": _bang_bang,
    "at the nearest": _at_nearest,
    "at the moving": _at_moving,
    "oncoming lanes": _oncoming,
    "brake-accelerate": _brake_accelerate,
    "untrained policy": _untrained,
}
"""Name -> maker of a driver for a loop, from a generator of its own."""
