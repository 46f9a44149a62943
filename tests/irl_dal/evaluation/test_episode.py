import numpy as np
import pytest

from irl_dal.evaluation.episode import Episode
from irl_dal.loop import SOURCES
from tests.irl_dal.evaluation.small import small_rig, written_episode


def test_an_episode_keeps_what_the_loop_says() -> None:
    """Every array holds one entry per step, positions one more, taken from the right moment."""
    rig = small_rig("random")
    try:
        _, first = rig.loop.reset(seed=3)
        actions, rewards, infos = np.linspace(-0.4, 0.4, 10).reshape(5, 2), [], []
        for action in actions:
            _, reward, _, _, after = rig.loop.step(action)
            after["mode"] = len(infos) % 4
            rewards.append(reward)
            infos.append(after)
    finally:
        rig.close()
    infos[2] |= {"fault": "at_fault", "departure": True}
    episode = Episode.of(3, [first, *infos], actions, rewards)
    infos[2]["fault"] = "at_rest"
    assert episode.at_fault and episode.departed
    assert not Episode.of(3, [first, *infos], actions, rewards).at_fault
    assert episode.steps == 5
    np.testing.assert_array_equal(episode.pose[0], first["pose"])
    np.testing.assert_array_equal(episode.pose[-1], infos[-1]["pose"])
    np.testing.assert_array_equal(episode.expert_action[1], infos[0]["expert_action"])
    np.testing.assert_array_equal(episode.mode, [first["mode"], 0, 1, 2, 3])
    np.testing.assert_array_equal(episode.executed_command[3], infos[3]["executed_command"])
    np.testing.assert_array_equal(episode.previous_command[1:], episode.executed_command[:-1])
    assert episode.total_reward == pytest.approx(
        sum(sum(info["reward_terms"].values()) for info in infos)
    )
    policy, planner = SOURCES.index("policy"), SOURCES.index("planner")
    assert set(episode.nominal_violations[:, policy]) <= {0, 1}
    assert set(episode.nominal_violations[:, planner]) == {-1}
    assert np.isfinite(episode.shield_time).all() and len(episode.plans) == 0


def test_arrays_are_read_only() -> None:
    """What was logged cannot be changed afterwards."""
    with pytest.raises(ValueError, match="read-only"):
        written_episode().reward[0] = 5.0


def test_an_empty_episode_is_refused() -> None:
    """There is no episode without a step."""
    with pytest.raises(ValueError, match="at least one step"):
        Episode.of(1, [{}], [], [])
