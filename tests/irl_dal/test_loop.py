"""One control step, from the sensors to the actuators."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import (
    OrderEnforcing,
    PassiveEnvChecker,
    RecordEpisodeStatistics,
    TimeLimit,
    TransformAction,
    TransformObservation,
    TransformReward,
)

from expert import FSMExpert
from irl_dal.build import build_loop, build_planner, expert_supervision, supervision
from irl_dal.config import RunConfig
from irl_dal.envs import CITY_ID, CityEnv
from irl_dal.loop import ControlLoop, Supervision
from irl_dal.planner import Activation, ProjectionMode
from shield import Certificate, TriggerConfig
from shield.trigger import TriggerForm


@pytest.fixture
def straight(tmp_path: Path) -> RunConfig:
    """A straight road with things standing on it, the planner off."""
    road = tmp_path / "straight.csv"
    road.write_text("\n".join(f"{x},0,7,7" for x in range(0, 601, 5)))
    config = RunConfig()
    return replace(
        config,
        env=replace(
            config.env,
            track=str(road),
            route_length=300.0,
            difficulty="easy",
        ),
        planner=replace(config.planner, enabled=False),
    )


def blind_drive(config: RunConfig) -> tuple[bool, float]:
    """Straight on at 8 m/s whatever comes: whether it collided, and the least clearance [m]."""
    loop = build_loop(config, supervision(config, None))
    loop.reset(seed=0)
    action, nearest = loop.limits.to_action(np.array([0.0, 8.0])), np.inf
    for _ in range(110):
        _, _, terminated, _, info = loop.step(action)
        nearest = min(nearest, float(info["clearance"]))
        if terminated:
            break
    loop.close()
    return bool(info["collision"]), nearest


@pytest.mark.parametrize("level", ["P0", "P1"])
def test_the_filter_stops_a_policy_that_sees_nothing(
    straight: RunConfig, level: Literal["P0", "P1"]
) -> None:
    """The car touches nothing; the next test shows that there is something to touch."""
    collided, nearest = blind_drive(replace(straight, shield=replace(straight.shield, level=level)))
    assert not collided and 0.0 < nearest < 8.0


@pytest.mark.parametrize("missing", [{"enabled": False}, {"level": "off"}], ids=["shield", "level"])
def test_without_the_filter_it_runs_into_what_stands_there(
    straight: RunConfig, missing: dict[str, Any]
) -> None:
    """Every command passes the shield, or its limits alone."""
    collided, _ = blind_drive(replace(straight, shield=replace(straight.shield, **missing)))
    assert collided


def test_the_expert_in_the_default_city_breaks_no_assumption() -> None:
    """Monitors that cry wolf are ignored; noise beyond A3 is named from the first scans on."""
    raised = {}
    for noise in (0.03, 0.15):
        config = RunConfig()
        config = replace(config, env=replace(config.env, lidar_noise=noise))
        loop = build_loop(config, expert_supervision(config))
        loop.reset(seed=204)
        raised[noise] = [loop.step_expert()[-1]["certificate"].flags for _ in range(150)]
        loop.close()
    assert sum(map(bool, raised[0.03])) <= 1
    assert sum("A3: noisier than assumed" in flags for flags in raised[0.15]) > 5


def test_a_lidar_that_repeats_its_scan_while_the_car_drives_is_lost(straight: RunConfig) -> None:
    """The loop tells the tracker the speed, so the frozen scan does not count as clear view."""
    faults = replace(straight.env.faults, stuck_beams=1.0)
    config = replace(straight, env=replace(straight.env, faults=faults))
    loop = build_loop(config, supervision(config, None))
    loop.reset(seed=0)
    action = loop.limits.to_action(np.array([0.0, 3.0]))
    reasons = [loop.step(action)[-1]["risk"].reasons for _ in range(20)]
    loop.close()
    assert all("lidar_lost" in each for each in reasons[10:])


@pytest.mark.parametrize(
    ("activation", "projection", "kept"),
    [
        ("trigger", "final", True),
        ("always", "final", True),
        ("always", "x0", True),
        ("always", "none", False),
    ],
)
def test_only_unprojected_plans_break_the_bounds_without_a_shield(
    straight: RunConfig, activation: Activation, projection: ProjectionMode, kept: bool
) -> None:
    """However the policy jumps: its set-points are followed within them."""
    config = replace(
        straight,
        shield=replace(straight.shield, enabled=False, trigger=TriggerConfig(form="printed")),
        planner=replace(
            straight.planner, enabled=True, activation=activation, projection=projection
        ),
    )
    loop = build_loop(config, supervision(config, build_planner(config)))
    loop.reset(seed=0)
    rng, blended, alone, violations = np.random.default_rng(0), 0, 0, 0
    for _ in range(40):
        _, _, terminated, _, info = loop.step(rng.uniform(-1.0, 1.0, 2))
        blended += 0.0 < info["blend_weight"] < 1.0
        alone += info["plan"] is None
        violations += loop.limits.violated(info["executed_command"], info["previous_command"])
        if terminated:
            break
    loop.close()
    assert alone > 3 if activation == "trigger" else blended > 10
    assert (violations == 0) == kept


@pytest.mark.parametrize("projection", ["final", "none"])
def test_a_blend_is_followed_like_any_set_point(
    straight: RunConfig, projection: ProjectionMode
) -> None:
    """Within the follower's limits, however far policy and unprojected plan lie."""
    config = replace(
        straight,
        planner=replace(straight.planner, enabled=True, activation="always", projection=projection),
    )
    loop = build_loop(config, supervision(config, build_planner(config)))
    loop.reset(seed=0)
    turns = []
    for turn in [1.0] * 10 + [-1.0] * 10:
        info = loop.step(np.array([turn, 0.0]))[-1]
        assert 0.0 < info["blend_weight"] < 1.0
        assert not loop.limits.violated(info["nominal_command"], info["previous_command"])
        turns.append(info["nominal_command"][0] - info["previous_command"][0])
    loop.close()
    assert np.ptp(turns) > 0.0


def test_a_plan_that_is_a_ramp_is_driven_as_it_is(
    straight: RunConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The follower is late by what the loop looks ahead in the plan."""
    config = replace(straight, planner=replace(straight.planner, enabled=True, activation="always"))
    planner = build_planner(config)
    assert planner is not None
    loop = build_loop(config, supervision(config, planner))
    monkeypatch.setattr(planner.blend, "weight", lambda *_, **__: 1.0)
    real, slope = planner.plan, np.array([0.002, 0.1])
    monkeypatch.setattr(
        planner,
        "plan",
        lambda context: replace(
            real(context), actions=context.previous + slope * np.arange(1, 9)[:, None]
        ),
    )
    loop.reset(seed=0)
    infos = [loop.step(np.zeros(2))[-1] for _ in range(12)]
    loop.close()
    change = infos[-1]["nominal_command"] - infos[-1]["previous_command"]
    assert change == pytest.approx(slope, rel=0.15)


def test_what_the_shield_does_is_not_gone_on_with(
    straight: RunConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wheels that it turns right in every third step still come to the left, where they should."""
    loop = build_loop(straight, supervision(straight, None))
    shield = loop.supervision.safety_filter
    assert shield is not None
    real, steps = shield.filter, iter(range(100))

    def interrupted(command: np.ndarray, plan: np.ndarray | None = None) -> Certificate:
        answer = real(np.array([command[0], 0.0]))
        if next(steps) % 3:
            return answer
        wheels = max(loop._previous[0] - loop.limits.steering_step, -0.5)
        braked = max(loop._previous[1] - loop.limits.deceleration_step, 0.0)
        return replace(answer, safe_action=np.array([wheels, braked]), intervened=True)

    monkeypatch.setattr(shield, "filter", interrupted)
    loop.reset(seed=0)
    action = loop.limits.to_action(np.array([0.3, 2.0]))
    infos = [loop.step(action)[-1] for _ in range(40)]
    loop.close()
    assert infos[-1]["executed_command"][0] > 0.2


@pytest.mark.parametrize(("form", "asked"), [("predicted", False), ("printed", True)])
def test_a_planner_that_sees_no_lane_is_asked_as_printed_only(
    straight: RunConfig, monkeypatch: pytest.MonkeyPatch, form: TriggerForm, asked: bool
) -> None:
    """The state is risky all the same."""
    # Without a lane the predictive filter would stop the car.
    shield = replace(straight.shield, level="off", trigger=TriggerConfig(form=form))
    planner = replace(straight.planner, enabled=True)
    config = replace(straight, planner=planner, shield=shield)
    loop = build_loop(config, supervision(config, build_planner(config)))
    loop.reset(seed=0)
    see = loop._lane.update
    monkeypatch.setattr(loop._lane, "update", lambda _, *motion, see=see: see(None, *motion))
    ahead = loop.limits.to_action(np.array([0.0, 4.0]))
    infos = [loop.step(ahead)[-1] for _ in range(40)][20:]
    loop.close()
    assert all("lane_lost" in info["risk"].reasons for info in infos)
    assert {info["triggered"] for info in infos} == {asked}


@pytest.mark.parametrize(("form", "hands_over"), [("predicted", True), ("printed", False)])
def test_a_policy_that_stands_hands_over_to_the_planner(
    straight: RunConfig, form: TriggerForm, hands_over: bool
) -> None:
    """By prediction it goes on after a while, on an open road; as printed it waits for ever."""
    config = replace(
        straight,
        shield=replace(straight.shield, trigger=TriggerConfig(form=form)),
        planner=replace(straight.planner, enabled=True),
    )
    loop = build_loop(config, supervision(config, build_planner(config)))
    loop.reset(seed=0)
    stop = loop.limits.to_action(np.zeros(2))
    steps = [loop.step(stop)[-1] for _ in range(100)]
    loop.close()
    alone = [info["blend_weight"] == 1.0 for info in steps if info["triggered"]]
    assert any(alone) == hands_over
    speeds = [info["executed_command"][1] for info in steps]
    assert (max(speeds[50:]) > loop.city.config.initial_speed / 4) == hands_over


def test_the_loop_asks_before_the_shield_has_to_act(straight: RunConfig) -> None:
    """Towards an obstacle: by prediction the state is risky some steps before the first change."""
    loop = build_loop(straight, supervision(straight, None))
    loop.reset(seed=0)
    ahead = loop.limits.to_action(np.array([0.0, 6.0]))
    infos = [loop.step(ahead)[-1]]
    while not infos[-1]["certificate"].intervened:
        infos.append(loop.step(ahead)[-1])
        assert len(infos) <= 200
    loop.close()
    risky = next(i for i, info in enumerate(infos) if "shield" in info["risk"].reasons)
    assert 2 <= len(infos) - 1 - risky <= 12


class OwnWrapper(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Changes nothing, which the loop cannot know."""


WRAPPERS: dict[str, Callable[[CityEnv], gymnasium.Env[Any, Any]]] = {
    "TimeLimit": lambda city: TimeLimit(city, 5),
    "TransformAction": lambda city: TransformAction(city, lambda a: -a, city.action_space),
    "TransformObservation": lambda city: TransformObservation(
        city, lambda seen: {**seen, "speed": 0.0 * seen["speed"]}, city.observation_space
    ),
    "TransformReward": lambda city: TransformReward(city, lambda reward: 2.0 * reward),
    "RecordEpisodeStatistics": RecordEpisodeStatistics,
    "OwnWrapper": OwnWrapper,
}


@pytest.mark.parametrize("name", WRAPPERS)
def test_a_wrapper_around_the_city_is_refused_by_name(straight: RunConfig, name: str) -> None:
    """The loop hands commands to the city itself; what stands between would not see them."""
    city = CityEnv(straight.env, straight.limits)
    for wrapped in (WRAPPERS[name](city), PassiveEnvChecker(WRAPPERS[name](city))):
        with pytest.raises(TypeError, match=f"wrapped in {name}"):
            control_loop(straight, wrapped)
    city.close()


def test_the_wrappers_of_make_and_those_around_the_loop_work(straight: RunConfig) -> None:
    """A time limit around the loop ends the episode after its steps."""
    made = gymnasium.make(CITY_ID, config=straight.env, limits=straight.limits)
    assert isinstance(made, OrderEnforcing)
    loop = TimeLimit(control_loop(straight, made), 3)
    loop.reset(seed=0)
    truncated = [bool(loop.step(np.array([0.0, 0.3]))[3]) for _ in range(3)]
    loop.close()
    assert truncated == [False, False, True]


def test_an_environment_that_is_no_city_is_refused(straight: RunConfig) -> None:
    """Naming what it is."""
    with pytest.raises(TypeError, match="CityEnv. Got PendulumEnv"):
        control_loop(straight, gymnasium.make("Pendulum-v1", disable_env_checker=True).unwrapped)


def control_loop(config: RunConfig, env: Any) -> ControlLoop:
    """A loop around an environment, without a planner."""
    expert = FSMExpert(config.expert, config.limits)
    return ControlLoop(env, expert, Supervision(), config.shield.trigger)


def test_the_world_is_seen_whatever_the_supervision(straight: RunConfig) -> None:
    """Without any, and of the newest scan."""
    loop = control_loop(straight, build_loop(straight, Supervision()).city)
    loop.reset(seed=0)
    context = loop.step(np.zeros(2))[-1]["context"]
    reading = loop.world.reading
    loop.close()
    assert reading is not None and np.array_equal(reading.scan, context.scan)
    assert reading.lane is context.lane and loop.world.clean.usable


def test_the_seed_of_a_reset_is_the_planner_s_too(straight: RunConfig) -> None:
    """Two drives of one seed plan alike, whatever the planner has drawn in between."""
    config = replace(straight, planner=replace(straight.planner, enabled=True, activation="always"))
    loop = build_loop(config, supervision(config, build_planner(config)))
    plans = []
    for seed in (0, 1, 0):
        loop.reset(seed=seed)
        plan = loop.step(np.zeros(2))[-1]["plan"]
        assert plan is not None
        plans.append(plan.actions)
    loop.close()
    assert np.array_equal(plans[0], plans[2]) and not np.array_equal(plans[0], plans[1])


def test_another_supervision_is_only_lent(straight: RunConfig) -> None:
    """Also when the drive under it fails."""
    loop = build_loop(straight, supervision(straight, None))
    own, other = loop.supervision, Supervision()
    with loop.under(other):
        assert loop.supervision is other
    with pytest.raises(RuntimeError), loop.under(other):
        raise RuntimeError
    assert loop.supervision is own
    loop.close()


def test_nothing_is_written_into_the_view_unless_it_is_rendered(straight: RunConfig) -> None:
    """The overlay is for the eye."""
    for render_mode, written in ((None, False), ("rgb_array", True)):
        loop = build_loop(straight, supervision(straight, None), render_mode=render_mode)
        loop.reset(seed=0)
        assert bool(loop.city.overlay[1]) == written
        loop.close()
