"""A predictive filter inside of `step`, around a small exact world."""

import copy
import math
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest

from shield import ActuatorLimits, InvalidProblem, PredictiveFilter, Status
from shield.gym import Reading, ShieldedEnv
from tests.shield.gym.recorder import Recorder, unit_box
from tests.shield.oracles import broken_bounds
from tests.shield.predictive.bodies import Thing
from tests.shield.predictive.filters import TIME, robot_filter, shared_filter
from tests.shield.predictive.kinematic_world import KinematicWorld
from tests.shield.predictive.scenes import small_robot

WIDE = (np.array([-1.0, -1.0]), np.array([1.0, 20.0]))


class Yard(gymnasium.Env[np.ndarray, np.ndarray]):
    """The kinematic world as an environment of commands [rad, m/s], or of normalised ones."""

    observation_space = gymnasium.spaces.Box(0.0, 50.0, (1,), np.float64)

    def __init__(self, world: KinematicWorld, *, dtype: Any = np.float64, normalised: bool = False):
        self.first, self.normalised = world, normalised
        low, high = (-np.ones(2), np.ones(2)) if normalised else WIDE
        self.action_space = gymnasium.spaces.Box(low.astype(dtype), high.astype(dtype), dtype=dtype)
        self.executed: list[np.ndarray] = []
        self.events: list[Any] = []

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """The same scene again."""
        super().reset(seed=seed)
        self.world = copy.deepcopy(self.first)
        self.executed, self.events = [], []
        return self.world.scan(), {}

    def step(self, action: np.ndarray) -> Any:
        """One period."""
        command = action.astype(np.float64)
        command = self.world.limits.to_command(command) if self.normalised else command
        self.executed.append(command)
        self.events += self.world.advance(command, len(self.executed))
        return self.world.scan(), 0.0, bool(self.events), False, {"own": 1}


def sense(env: Any, observation: np.ndarray, info: dict[str, Any]) -> Reading:
    """What the world's sensors say."""
    world = env.unwrapped.world
    return Reading(observation, world.speed, world.yaw_rate, world.lane())


def robot_env(*things: Thing, **options: Any) -> ShieldedEnv:
    """A small robot in front of things."""
    yard = Yard(small_robot(90, list(things)), **options)
    normalised = options.get("normalised", False)
    return ShieldedEnv(yard, robot_filter(90), sense=sense, normalised=normalised)


WALL = Thing(5.0, 0.0, 0.5, 8.0, 0.5 * math.pi)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("normalised", [False, True])
def test_at_full_speed_towards_a_wall_nothing_is_touched(dtype: Any, normalised: bool) -> None:
    """And G1-G3 hold exactly on what the environment executes, whatever the space's precision."""
    env = robot_env(WALL, Thing(3.0, 2.0, 0.6), dtype=dtype, normalised=normalised)
    limits, space = robot_filter(90).limits, env.action_space
    env.reset()
    rng, statuses, last = np.random.default_rng(0), set(), np.zeros(2)
    for step in range(60):
        wish = np.array([0.0, space.high[1]], dtype)
        if step % 3 == 0:
            wish = rng.uniform(space.low, space.high).astype(dtype)
        certificate = env.step(wish)[-1]["certificate"]
        inner = env.unwrapped
        assert broken_bounds(limits, [inner.executed[-1]], last) == [] and not inner.events
        assert certificate.safe_action.dtype == dtype and certificate.max_violation == 0.0
        assert np.array_equal(robot_filter(90).previous, inner.executed[-1])
        last = inner.executed[-1]
        statuses.add(certificate.status)
    assert statuses - {Status.NOMINAL} and inner.world.pose[0] > 0.5


def test_the_same_wish_without_the_filter_touches_the_wall() -> None:
    """The scene is one in which a robot can collide."""
    yard = Yard(small_robot(90, [WALL]))
    yard.reset()
    assert any(yard.step(np.array([0.0, 1.0]))[2] for _ in range(60))


def test_a_certified_action_passes_bit_by_bit_and_the_info_stays() -> None:
    """In the precision of the space."""
    env = robot_env(dtype=np.float32)
    env.reset()
    for k in range(1, 20):
        wish = np.array([0.01 * (k % 3), min(0.1 * k, 1.0)], np.float32)
        info = env.step(wish)[-1]
    assert info["certificate"].status is Status.NOMINAL and info["own"] == 1
    assert info["certificate"].safe_action.tobytes() == wish.tobytes()
    assert not info["certificate"].intervened and not info["certificate"].correction.any()


def test_a_car_in_its_lanes_stays_in_them() -> None:
    """With a lane estimate in the reading, from a moving start; every reset begins anew."""
    world = KinematicWorld([], speed=8.0)
    env = ShieldedEnv(Yard(world), shared_filter(), sense=sense)
    first = []
    for _ in range(2):
        env.reset()
        assert shared_filter().previous.tolist() == [0.0, 8.0]
        for _ in range(40):
            certificate = env.step(np.array([0.3, 8.0]))[-1]["certificate"]
            first.append(certificate)
        assert env.unwrapped.events == []
    assert first[:40] == first[40:] and any("leave the lanes" in c.reason for c in first)


def test_an_action_that_is_no_number_is_answered() -> None:
    """The committed backup goes on."""
    env = robot_env(normalised=True)
    env.reset()
    env.step(np.array([0.0, 0.5]))
    certificate = env.step(np.array([np.nan, 0.5]))[-1]["certificate"]
    assert certificate.status is Status.FALLBACK and "not finite" in certificate.reason
    assert np.isfinite(env.unwrapped.executed[-1]).all()


def test_a_late_scan_says_nothing() -> None:
    """With readings older than `delay` the robot drives no further than it has seen."""

    def late(env: Any, observation: np.ndarray, info: dict[str, Any]) -> Reading:
        old = len(env.unwrapped.executed) > 10
        return replace(sense(env, observation, info), age=0.3 if old else 0.0)

    env = ShieldedEnv(Yard(small_robot(90, [])), robot_filter(90), sense=late)
    env.reset()
    for _ in range(40):
        env.step(np.array([0.0, 2.0]))
    assert env.unwrapped.world.speed == 0.0
    speeds = [command[1] for command in env.unwrapped.executed]
    assert max(speeds) > 1.5


def test_a_speed_that_is_no_number_at_reset_counts_as_standing() -> None:
    """Nothing is raised inside of the loop."""
    blind = lambda env, observation, info: Reading(observation, math.nan, math.nan)  # noqa: E731
    env = ShieldedEnv(Yard(small_robot(90, [])), robot_filter(90), sense=blind)
    env.reset()
    assert robot_filter(90).previous.tolist() == [0.0, 0.0]


def test_a_deep_copy_goes_on_by_itself() -> None:
    """The original keeps its own world and commitment."""
    env, other = robot_env(WALL), robot_env(WALL)
    env = ShieldedEnv(env.env, copy.deepcopy(robot_filter(90)), sense=sense)
    for one in (env, other):
        one.reset()
    ahead = copy.deepcopy(env)
    expected = [ahead.step(np.array([0.0, 2.0]))[-1]["certificate"] for _ in range(20)]
    assert [env.step(np.array([0.0, 2.0]))[-1]["certificate"] for _ in range(20)] == expected
    assert [other.step(np.array([0.0, 2.0]))[-1]["certificate"] for _ in range(20)] == expected


def _wrong(*_: Any) -> Any:
    return np.zeros(90)


@pytest.mark.parametrize(
    ("space", "options", "name"),
    [
        (unit_box(), {}, "`sense`"),
        (unit_box(), {"sense": 3}, "`sense`"),
        (unit_box(), {"sense": sense}, "`env` must have all actions"),
        (gymnasium.spaces.Discrete(3), {"sense": sense}, "`env`"),
        (gymnasium.spaces.Box(-1.0, 1.0, (3,)), {"sense": sense}, "`env`"),
        (gymnasium.spaces.Box(0, 9, (2,), np.int64), {"sense": sense}, "floating"),
    ],
)
def test_impossible_wrappings_raise(space: Any, options: dict[str, Any], name: str) -> None:
    """In one line that names the argument."""
    with pytest.raises(InvalidProblem, match=name) as caught:
        ShieldedEnv(Recorder(space), robot_filter(90), **options)
    assert "\n" not in str(caught.value)


def test_sense_without_a_predictive_filter_raises() -> None:
    """Limits have no use for it."""
    with pytest.raises(InvalidProblem, match="`predictive_filter`"):
        ShieldedEnv(Recorder(unit_box()), ActuatorLimits(), sense=sense)


def test_readings_of_a_wrong_shape_or_type_raise() -> None:
    """At the first reset, by name."""
    short = lambda env, observation, info: Reading(np.zeros(7), 0.0, 0.0)  # noqa: E731
    old = lambda env, observation, info: Reading(observation, 0.0, 0.0, age="x")  # type: ignore[arg-type] # noqa: E731
    for function, name in ((_wrong, "`sense`"), (short, "`scan`"), (old, "`age`")):
        env = ShieldedEnv(Yard(small_robot(90, [])), robot_filter(90), sense=function)
        with pytest.raises(InvalidProblem, match=name):
            env.reset()


def test_a_vectorised_environment_is_refused() -> None:
    """A filter remembers one car."""
    vector = gymnasium.vector.SyncVectorEnv([lambda: Recorder(unit_box())] * 2)
    with pytest.raises(InvalidProblem, match="not vectorised"):
        ShieldedEnv(vector, robot_filter(90), sense=sense)


def test_a_specification_cannot_rebuild_it_and_says_so() -> None:
    """Filter and function are objects, not arguments that JSON can hold."""
    shield = PredictiveFilter(ActuatorLimits(max_speed=0.9, max_steering=0.9), deadline=TIME)
    pendulum = gymnasium.make("Pendulum-v1")
    pair = gymnasium.wrappers.TransformAction(
        pendulum, lambda a: a[:1], gymnasium.spaces.Box(*WIDE)
    )
    env = ShieldedEnv(pair, shield, sense=sense)
    with pytest.raises(ValueError, match="RecordConstructorArgs"):
        gymnasium.make(env.spec)
