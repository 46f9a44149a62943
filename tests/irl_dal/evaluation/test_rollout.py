from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from irl_dal.build import build_loop, build_planner, expert_supervision, supervision
from irl_dal.evaluation.agents import ExpertAgent, RandomAgent, StepResult
from irl_dal.evaluation.episode import Episode
from irl_dal.evaluation.rollout import compare_paths, drive_episode, drive_expert, stretches
from irl_dal.loop import ControlLoop, Observation
from tests.irl_dal.evaluation.small import small_config, small_rig

SEED = 10_007


def arrays(episode: Episode) -> list[np.ndarray]:
    """What must repeat exactly: everything but durations."""
    return [episode.reward, episode.pose, episode.agent_action, episode.executed_command]


def test_the_same_seed_gives_the_same_episode() -> None:
    """Bit by bit, whatever was driven in between; another seed gives another one."""
    rig = small_rig("random")
    try:
        first = rig.drive(SEED)
        other = rig.drive(SEED + 1)
        again = rig.drive(SEED)
    finally:
        rig.close()
    for one, two in zip(arrays(first), arrays(again), strict=True):
        np.testing.assert_array_equal(one, two)
    assert not np.array_equal(first.agent_action[:3], other.agent_action[:3])


def test_the_watcher_sees_the_reset_and_every_step() -> None:
    """One call more than there are steps."""
    rig, seen = small_rig("random"), []
    try:
        episode = drive_episode(
            rig.loop, rig.agent, SEED, lambda observation, info: seen.append(info["pose"])
        )
    finally:
        rig.close()
    np.testing.assert_array_equal(np.array(seen), episode.pose)


def test_the_expert_agrees_with_itself() -> None:
    """Asked in its own states the expert answers its own labels: the BC loss is exactly 0."""
    rig = small_rig("expert")
    try:
        episode, answers = drive_expert(rig.loop, rig.reference, rig.agent, SEED)
        kept = rig.expert(SEED)
    finally:
        rig.close()
    np.testing.assert_array_equal(answers, episode.expert_action)
    assert sum(kept["cloning"]) == episode.steps  # no error, every state counted
    assert kept["return"] == episode.total_reward and kept["pose"] == episode.pose.tolist()


def test_the_agent_is_asked_without_driving() -> None:
    """A random agent's answers do not change where the expert goes."""
    rig = small_rig("random")
    try:
        with_random, answers = drive_expert(rig.loop, rig.reference, RandomAgent(), SEED)
        own = rig.loop.supervision
    finally:
        rig.close()
    rig = small_rig("expert")
    try:
        alone = rig.drive(SEED)
    finally:
        rig.close()
    np.testing.assert_array_equal(with_random.pose, alone.pose)
    assert (answers != alone.expert_action).any()
    assert own is not rig.reference


@pytest.mark.parametrize("step", [0, 1, 7])
def test_restored_states_are_exact(step: int) -> None:
    """The expert, put into a state of its own episode, drives exactly its own path."""
    rig = small_rig("expert")
    try:
        pose = np.array(rig.expert(SEED)["pose"])[step : step + 11]
        distances = compare_paths(rig.loop, rig.reference, rig.agent, SEED, step, pose)
        assert rig.loop.city.camera_on
        further = compare_paths(rig.loop, rig.reference, rig.agent, SEED, step + 1, pose)
    finally:
        rig.close()
    np.testing.assert_array_equal(distances, np.zeros(10))
    assert further.all()


def test_a_restored_state_looks_the_same() -> None:
    """What the agent sees there, camera included, is what the expert's drive had shown."""
    rig, seen, shown = small_rig("expert"), [], []

    class Looker(ExpertAgent):
        def act(self, observation: Observation, info: Mapping[str, Any]) -> np.ndarray:
            shown.append(observation)
            return super().act(observation, info)

    try:
        expert = drive_episode(
            rig.loop, ExpertAgent(), SEED, lambda observation, _: seen.append(observation)
        )
        compare_paths(rig.loop, rig.reference, Looker(), SEED, 6, expert.pose[6:8])
    finally:
        rig.close()
    for key, value in seen[6].items():
        np.testing.assert_array_equal(shown[0][key], value)
    assert shown[0]["image"].std() > 1.0


def test_plans_do_not_depend_on_what_was_compared_before() -> None:
    """The planner's random source starts anew for every stretch."""

    class Supervised(ExpertAgent):
        def drive(self, loop: ControlLoop, action: np.ndarray) -> StepResult:
            return loop.step(action)

    config = small_config()
    planner = replace(config.planner, activation="always", deadline=10.0, sampling_steps=2)
    config = replace(config, planner=planner)
    planner = build_planner(config)
    loop = build_loop(config, supervision(config, planner))
    reference, agent = expert_supervision(config), Supervised()
    try:
        expert, _ = drive_expert(loop, reference, agent, SEED)
        paths = [
            [
                compare_paths(loop, reference, agent, SEED, step, expert.pose[step : step + 9])
                for step in order
            ]
            for order in ([3, 9], [9, 3])
        ]
    finally:
        loop.close()
    assert planner is not None and planner.counts["plans"] == 32
    np.testing.assert_array_equal(paths[0][0], paths[1][1])
    np.testing.assert_array_equal(paths[0][1], paths[1][0])


def test_another_driver_leaves_the_path() -> None:
    """Random actions from the same state end elsewhere."""
    rig = small_rig("random")
    try:
        pose = np.array(rig.expert(SEED)["pose"])[5:16]
        distances = compare_paths(rig.loop, rig.reference, rig.agent, SEED, 5, pose)
    finally:
        rig.close()
    assert distances.shape == (10,) and distances[-1] > 0.1


def test_a_state_without_road_behind_it_is_refused() -> None:
    """The expert's own continuation must have a step."""
    rig = small_rig("expert")
    try:
        with pytest.raises(ValueError, match="`pose` must hold"):
            compare_paths(rig.loop, rig.reference, rig.agent, SEED, 5, np.zeros((1, 3)))
    finally:
        rig.close()


def test_states_are_spread_over_episodes() -> None:
    """As many as asked for, equally many per long enough episode, each with its horizon left."""
    drives, horizon = {n: np.full((n + 1, 3), n) for n in (300, 20, 450)}, 50
    drawn = stretches(drives, 100, horizon, np.random.default_rng(0))
    steps = {n: [step for seed, step, _ in drawn if seed == n] for n in drives}
    assert {n: len(chosen) for n, chosen in steps.items()} == {300: 50, 20: 0, 450: 50}
    for length, chosen in steps.items():
        assert chosen == sorted(set(chosen))
        assert all(0 <= step <= length - horizon for step in chosen)
    assert max(steps[450]) > 350 and min(steps[450]) < 50
    assert all(pose.shape == (horizon + 1, 3) and (pose == seed).all() for seed, _, pose in drawn)
    assert stretches({}, 100, horizon, np.random.default_rng(0)) == []
