import numpy as np
import pytest

from irl_dal.evaluation.agents import RandomAgent
from irl_dal.evaluation.episode import Episode
from irl_dal.evaluation.rollout import compare_paths, drive_episode, drive_expert, spread_steps

from .small import small_bench

SEED = 10_007


def arrays(episode: Episode) -> list[np.ndarray]:
    """What must repeat exactly: everything but durations."""
    return [episode.reward, episode.pose, episode.agent_action, episode.executed_command]


def test_the_same_seed_gives_the_same_episode() -> None:
    """Bit by bit, whatever was driven in between; another seed gives another one."""
    bench = small_bench("random")
    try:
        first = bench.drive(SEED)
        other = bench.drive(SEED + 1)
        again = bench.drive(SEED)
    finally:
        bench.close()
    for one, two in zip(arrays(first), arrays(again), strict=True):
        np.testing.assert_array_equal(one, two)
    assert not np.array_equal(first.agent_action[:3], other.agent_action[:3])


def test_the_watcher_sees_the_reset_and_every_step() -> None:
    """One call more than there are steps."""
    bench, seen = small_bench("random"), []
    try:
        episode = drive_episode(
            bench.loop, bench.agent, SEED, lambda observation, info: seen.append(info["pose"])
        )
    finally:
        bench.close()
    np.testing.assert_array_equal(np.array(seen), episode.pose)


def test_the_expert_agrees_with_itself() -> None:
    """Asked in its own states the expert answers its own labels: the BC loss is exactly 0."""
    bench = small_bench("expert")
    try:
        episode, answers = bench.probe(SEED)
    finally:
        bench.close()
    assert len(answers.mode) == episode.steps
    np.testing.assert_array_equal(answers.agent_action, answers.expert_action)
    np.testing.assert_array_equal(answers.mode, episode.mode)


def test_the_agent_is_asked_without_driving() -> None:
    """A random agent's answers do not change where the expert goes."""
    bench = small_bench("random")
    try:
        with_random, answers = drive_expert(bench.loop, bench.reference, RandomAgent(), SEED)
        own = bench.loop.supervision
    finally:
        bench.close()
    bench = small_bench("expert")
    try:
        alone = bench.drive(SEED)
    finally:
        bench.close()
    np.testing.assert_array_equal(with_random.pose, alone.pose)
    assert (answers.agent_action != answers.expert_action).any()
    assert own is not bench.reference


@pytest.mark.parametrize("step", [0, 1, 17])
def test_restored_states_are_exact(step: int) -> None:
    """The expert, put into a state of its own episode, drives exactly its own path."""
    bench = small_bench("expert")
    try:
        expert, _ = bench.probe(SEED)
        pair = compare_paths(bench.loop, bench.reference, bench.agent, expert, step, 10)
        assert bench.loop.city.camera_on
    finally:
        bench.close()
    np.testing.assert_array_equal(pair.agent, pair.expert)
    np.testing.assert_array_equal(pair.expert[0], expert.pose[step + 1, :2])


def test_another_driver_leaves_the_path() -> None:
    """Random actions from the same state end elsewhere."""
    bench = small_bench("random")
    try:
        expert, _ = bench.probe(SEED)
        pair = compare_paths(bench.loop, bench.reference, bench.agent, expert, 5, 10)
    finally:
        bench.close()
    assert np.linalg.norm(pair.agent[-1] - pair.expert[-1]) > 0.1


def test_a_state_without_enough_road_behind_it_is_refused() -> None:
    """The expert's own continuation must be long enough."""
    bench = small_bench("expert")
    try:
        expert, _ = bench.probe(SEED)
        with pytest.raises(ValueError, match="`step` must lie in"):
            compare_paths(bench.loop, bench.reference, bench.agent, expert, expert.steps - 9, 10)
    finally:
        bench.close()


def test_states_are_spread_over_episodes() -> None:
    """As many as asked for, equally many per long enough episode, each with its horizon left."""
    lengths, horizon = [300, 20, 450], 50
    steps = spread_steps(lengths, 100, horizon, np.random.default_rng(0))
    assert [len(chosen) for chosen in steps] == [50, 0, 50]
    for length, chosen in zip(lengths, steps, strict=True):
        assert chosen == sorted(set(chosen))
        assert all(0 <= step <= length - horizon for step in chosen)
    assert max(steps[2]) > 350 and min(steps[2]) < 50
    assert spread_steps([], 100, horizon, np.random.default_rng(0)) == []
