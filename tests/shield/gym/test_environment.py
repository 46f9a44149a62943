"""The shield around other people's environments."""

from dataclasses import replace
from fractions import Fraction
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from shield import ActuatorLimits, InvalidLimits, InvalidProblem, Status
from shield.gym import ShieldedEnv
from shield.gym.box_filter import BoxFilter
from shield.gym.vehicle_filter import VehicleFilter
from tests.shield.gym.recorder import (
    DT,
    RATE,
    Recorder,
    assert_rates,
    unit_box,
    vector_of_recorders,
)
from tests.shield.oracles import broken_bounds
from tests.shield.strategies import CITY, VEHICLES


def test_pendulum_is_kept_within_box_and_rate_exactly() -> None:
    """Torques of `Pendulum-v1` in float32, judged as rational numbers; broken without."""
    for shielded in (True, False):
        plain = gymnasium.make("Pendulum-v1")
        env = ShieldedEnv(plain, rate=RATE, dt=DT) if shielded else plain
        env.action_space.seed(0)
        env.reset(seed=0)
        executed = []
        for _ in range(199):
            wish = env.action_space.sample()
            info = env.step(wish)[-1]
            executed.append(info["certificate"].safe_action if shielded else wish)
        if shielded:
            assert all(action.dtype == np.float32 for action in executed)
            assert_rates(executed, -2.0, 2.0, RATE * DT)
        else:
            with pytest.raises(AssertionError):
                assert_rates(executed, -2.0, 2.0, RATE * DT)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_any_precision_rounds_to_the_inside(dtype: Any) -> None:
    """Bounds and steps that the precision cannot express are never exceeded."""
    shield = BoxFilter([-0.3, -1.0], [0.1, 1.0], [0.7, 0.013], 0.1, dtype=dtype)
    rng = np.random.default_rng(0)
    last = [Fraction(0), Fraction(0)]
    for _ in range(500):
        certificate = shield.filter(rng.uniform(-2.0, 2.0, 2).astype(dtype))
        for channel, (low, high, rate) in enumerate(((-0.3, 0.1, 0.7), (-1.0, 1.0, 0.013))):
            value = Fraction(float(certificate.safe_action[channel]))
            assert Fraction(low) <= value <= Fraction(high)
            assert abs(value - last[channel]) <= Fraction(rate * 0.1)
            last[channel] = value


def test_an_admissible_action_reaches_the_environment_bit_by_bit() -> None:
    """Including -0.0, and the rest of the info stays."""
    env = ShieldedEnv(Recorder(gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float32)), rate=0.5)
    env.reset()
    wish = np.array([-0.0, 0.1, 0.5], np.float32)
    info = env.step(wish)[-1]
    assert env.unwrapped.actions[-1].tobytes() == wish.tobytes()
    assert info["certificate"].status is Status.NOMINAL
    assert not info["certificate"].intervened
    assert info["own"] == 1


def test_an_action_that_is_not_finite_moves_to_rest() -> None:
    """NaN and infinities never reach the environment."""
    env = ShieldedEnv(Recorder(gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)), rate=0.25)
    env.reset()
    env.step(np.array([0.25], np.float32))
    env.step(np.array([0.5], np.float32))
    for bad, expected in ((np.nan, 0.25), (np.inf, 0.0), (-np.inf, 0.0)):
        certificate = env.step(np.array([bad], np.float32))[-1]["certificate"]
        assert certificate.status is Status.FALLBACK
        assert "not finite" in certificate.reason
        assert env.unwrapped.actions[-1].tolist() == [expected]


def test_an_unbounded_space_needs_something_to_hold() -> None:
    """A rate is enough, and so is one end; the largest float32 is still a float32."""
    space = gymnasium.spaces.Box(-np.inf, np.inf, (1,), np.float32)
    env = ShieldedEnv(Recorder(space), rate=0.5)
    env.reset()
    with np.errstate(all="raise"):
        certificate = env.step(np.array([1e300]))[-1]["certificate"]
    assert certificate.status is Status.PROJECTED
    assert env.unwrapped.actions[-1].tolist() == [0.5]
    env = ShieldedEnv(Recorder(space), low=-1.0)
    env.reset()
    env.step(np.array([1e300]))
    assert env.unwrapped.actions[-1].tolist() == [np.finfo(np.float32).max]
    with pytest.raises(InvalidLimits, match=r"`env` must have bounded actions.*Got Box"):
        ShieldedEnv(Recorder(space))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("limits", VEHICLES[:6])
def test_a_normalised_vehicle_executes_admissible_commands(
    limits: ActuatorLimits, dtype: Any
) -> None:
    """G1-G3 hold on `to_command` of the rounded action, which is what the car executes."""
    env = ShieldedEnv(Recorder(unit_box(dtype)), limits, normalised=True)
    rng = np.random.default_rng(0)
    env.reset()
    rest = np.clip(np.zeros(2), limits.low, limits.high)
    last = limits.to_command(limits.to_action(rest).astype(dtype))
    nominal = 0
    for step in range(400):
        wish = rng.uniform(-1.1, 1.1, 2).astype(dtype)
        if step % 2:
            near = limits.to_action(last) + rng.normal(0.0, 0.02, 2)
            wish = np.clip(near, -1.0, 1.0).astype(dtype)
        certificate = env.step(wish)[-1]["certificate"]
        action = env.unwrapped.actions[-1]
        assert action.dtype == dtype
        command = limits.to_command(action)
        assert broken_bounds(limits, [command], last) == []
        admissible = not broken_bounds(limits, [limits.to_command(wish)], last)
        assert (certificate.status is Status.NOMINAL) == admissible
        assert "held" not in certificate.reason
        if admissible:
            assert action.tobytes() == wish.tobytes()
            nominal += 1
        last = command
    assert 0 < nominal < 400


def test_a_physical_vehicle_space_is_cut_to_both_boxes() -> None:
    """[rad, m/s] actions: the limits and the space hold, whichever is narrower."""
    space = gymnasium.spaces.Box(
        np.array([-0.4, -5.0], np.float32), np.array([0.4, 8.0], np.float32), dtype=np.float32
    )
    env = ShieldedEnv(Recorder(space), CITY)
    env.reset()
    last = np.zeros(2)
    for _ in range(100):
        env.step(np.array([0.05, 9.0], np.float32))
        command = env.unwrapped.actions[-1].astype(np.float64)
        assert space.contains(env.unwrapped.actions[-1])
        assert broken_bounds(CITY, [command], last) == []
        last = command
    assert last[1] == pytest.approx(8.0)


def test_an_inadmissible_rest_is_left_at_full_rate_and_reported() -> None:
    """The certificates say so until the command is admissible."""
    shield = VehicleFilter(CITY, [-1.0, -1.0], [1.0, 1.0], normalised=True, rest=[0.5, 12.0])
    statuses = [shield.filter(np.array([1.0, 1.0], np.float32)).status for _ in range(12)]
    assert statuses[0] is Status.FALLBACK
    assert statuses[-1] is Status.PROJECTED
    assert CITY.is_admissible(shield.previous)


def test_highway_env_is_kept_within_its_rates() -> None:
    """The continuous action of highway-env: acceleration and steering, rates in its own units."""
    pytest.importorskip("highway_env")
    config = {"action": {"type": "ContinuousAction"}, "vehicles_count": 1, "lanes_count": 2}
    plain = gymnasium.make("highway-v0", config=config)
    env = ShieldedEnv(plain, rate=[0.5, 0.2])
    env.action_space.seed(1)
    env.reset(seed=1)
    last, statuses = np.zeros(2), set()
    for _ in range(20):
        _, _, terminated, truncated, info = env.step(env.action_space.sample())
        executed = info["certificate"].safe_action.astype(np.float64)
        for channel, step in enumerate((0.5, 0.2)):
            change = Fraction(executed[channel]) - Fraction(last[channel])
            assert abs(change) <= Fraction(step)
        statuses.add(info["certificate"].status)
        last = executed
        if terminated or truncated:
            env.reset(seed=1)
            last = np.zeros(2)
    assert Status.PROJECTED in statuses


@pytest.mark.parametrize(
    ("space", "arguments", "error", "name"),
    [
        (gymnasium.spaces.Discrete(3), {}, InvalidProblem, "env"),
        (gymnasium.spaces.Box(0, 9, (2,), np.int64), {}, InvalidProblem, "env"),
        (unit_box(), {"rate": 0.0}, InvalidLimits, "rate"),
        (unit_box(), {"rate": [1.0, -1.0]}, InvalidLimits, "rate"),
        (unit_box(), {"rate": [1.0, 1.0, 1.0]}, InvalidLimits, "rate"),
        (unit_box(), {"dt": 0.0}, InvalidLimits, "dt"),
        (unit_box(), {"low": 0.5, "high": -0.5}, InvalidLimits, "low"),
        (unit_box(), {"rest": [0.0]}, InvalidProblem, "rest"),
        (unit_box(), {"rest": [0.0, np.nan]}, InvalidProblem, "rest"),
        (gymnasium.spaces.Box(-1, 1, (3,)), {"limits": CITY}, InvalidProblem, r"`env`.*\(2,\)"),
        (unit_box(), {"limits": CITY, "rest": [0.0, np.nan]}, InvalidProblem, "`rest`"),
        (unit_box(), {"rate": "fast"}, InvalidProblem, "`rate`"),
        (unit_box(), {"low": [0.0, 0.0, 0.0]}, InvalidLimits, "`low`"),
        (unit_box(), {"dt": "fast"}, InvalidLimits, "`dt`"),
        (gymnasium.spaces.Box(20, 30, (2,)), {"limits": CITY}, InvalidLimits, "no command"),
        (unit_box(), {"limits": CITY, "rate": 0.1}, InvalidProblem, "`rate` has no effect"),
        (unit_box(), {"limits": CITY, "dt": 0.1}, InvalidProblem, "`dt` has no effect"),
        (unit_box(), {"limits": CITY, "low": -0.1}, InvalidProblem, "`low` has no effect"),
        (unit_box(), {"limits": CITY, "high": 0.1}, InvalidProblem, "`high` has no effect"),
        (unit_box(), {"rate": 0.1, "normalised": True}, InvalidProblem, "`normalised` needs"),
        (unit_box(), {"limits": replace(CITY, dt=1e-7)}, InvalidLimits, "too coarse"),
    ],
)
def test_impossible_wrappings_raise(
    space: Any, arguments: dict[str, Any], error: type[Exception], name: str
) -> None:
    """At once, naming the argument."""
    with pytest.raises(error, match=name):
        ShieldedEnv(Recorder(space), **arguments)


def test_a_unit_box_in_physical_units_is_kept_within_the_physical_bounds() -> None:
    """[-1, 1] rad and m/s: with `normalised=False` no more than 0.5 rad is ever executed."""
    env = ShieldedEnv(Recorder(unit_box()), CITY, normalised=False)
    env.reset()
    last = np.zeros(2)
    for _ in range(30):
        env.step(np.array([1.0, 1.0], np.float32))
        command = env.unwrapped.actions[-1].astype(np.float64)
        assert broken_bounds(CITY, [command], last) == []
        last = command
    assert last == pytest.approx([0.5, 1.0], abs=1e-6)
    with pytest.warns(UserWarning, match="normalised=False"):
        ShieldedEnv(Recorder(unit_box()), CITY)


def test_a_space_without_dimensions_is_shielded() -> None:
    """`Box(-1, 1, ())` is a box of floating point numbers."""
    env = ShieldedEnv(Recorder(gymnasium.spaces.Box(-1.0, 1.0, ())), rate=0.3)
    env.reset()
    for expected in (0.3, 0.6):
        certificate = env.step(1.0)[-1]["certificate"]
        assert certificate.safe_action.shape == ()
        assert env.action_space.contains(env.unwrapped.actions[-1])
        assert float(certificate.safe_action) == pytest.approx(expected, abs=1e-6)
    assert env.step(np.nan)[-1]["certificate"].status is Status.FALLBACK


def test_wrong_actions_raise() -> None:
    """Shapes and types are mistakes of the caller."""
    env = ShieldedEnv(Recorder(unit_box()), rate=1.0)
    env.reset()
    for bad in (np.zeros(3), np.zeros((1, 2)), "left", [None, 0.0]):
        with pytest.raises(InvalidProblem, match="`action`"):
            env.step(bad)
    car = ShieldedEnv(Recorder(unit_box()), CITY, normalised=True)
    car.reset()
    with pytest.raises(InvalidProblem, match="`action`"):
        car.step(np.zeros(3))
    vector, _ = vector_of_recorders(AutoresetMode.NEXT_STEP)
    vector.reset()
    with pytest.raises(InvalidProblem, match="`actions`"):
        vector.step(np.zeros((3, 1)))
    with pytest.raises(InvalidProblem, match="`dtype`"):
        BoxFilter([0.0], [1.0], dtype=np.int64)
    with pytest.raises(InvalidLimits, match="no float16"):
        BoxFilter([0.10001], [0.10002], dtype=np.float16)
    with pytest.raises(InvalidProblem, match="`dtype`"):
        VehicleFilter(CITY, [-1.0, -1.0], [1.0, 1.0], normalised=True, dtype=np.int64)
    with pytest.raises(InvalidProblem, match="normalised"):
        VehicleFilter(CITY, [-2.0, -1.0], [1.0, 1.0], normalised=True)


def test_the_city_is_shielded_like_any_other_environment() -> None:
    """`IRLDAL/City-v0` with the normalised actions of the project, where it is installed."""
    pytest.importorskip("pybullet")
    pytest.importorskip("irl_dal.envs")
    env = ShieldedEnv(gymnasium.make("IRLDAL/City-v0"), CITY, normalised=True)
    env.action_space.seed(0)
    env.reset(seed=0)
    last = CITY.to_command(CITY.to_action(np.zeros(2)).astype(np.float32))
    for _ in range(20):
        _, _, terminated, truncated, info = env.step(env.action_space.sample())
        command = CITY.to_command(info["certificate"].safe_action)
        assert broken_bounds(CITY, [command], last) == []
        last = command
        if terminated or truncated:
            break
    env.close()
