"""What a car tells of every step, and where its episodes come from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from irl_dal.learning.collection.driver import Driver
from irl_dal.learning.collection.step_record import DrivenStep, End
from irl_dal.learning.imitation.disturbance import DisturbanceConfig
from tests.irl_dal.learning.city import SHORT, new_driver, new_loop

CALM = replace(SHORT, disturbance=DisturbanceConfig(rate=0.0))
PUSHED = replace(SHORT, disturbance=DisturbanceConfig(rate=1.0))
STILL = np.zeros(2, np.float32)


def test_each_transition_joins_a_state_with_its_own_label_and_the_command_that_followed() -> None:
    """Against the loop itself, driven beside the driver with the same seed and actions."""
    driver, loop = new_driver(CALM, activation="always"), new_loop(activation="always")
    driver.reset(seed=7)
    planner, mine = driver.loop.supervision.planner, loop.supervision.planner
    assert planner is not None and mine is not None
    mine.generator.set_state(planner.generator.get_state())
    observation, info = loop.reset(seed=7)
    total = 0.0
    for step, action in enumerate(np.random.default_rng(0).uniform(-0.3, 0.3, (12, 2))):
        if step < 6:
            told = driver.expert_step()
            after = loop.step_expert()
        else:
            told = driver.policy_step(action)
            after = loop.step(action)
        driven, known = told.transition, after[4]
        total += after[1]
        assert np.array_equal(driven.image, observation["image"])
        assert np.array_equal(driven.lidar, observation["lidar"])
        assert np.array_equal(driven.context, info["context"].encode())
        assert np.array_equal(driven.label, info["expert_action"])
        assert driven.command == pytest.approx(known["executed_action"], abs=1e-6)
        assert driven.mode == info["mode"]
        assert driven.reward == pytest.approx(after[1], rel=1e-6)
        assert driven.expert_drove == (step < 6)
        assert driven.intervened == (step >= 6)
        assert (driven.episode, driven.step) == (0, step)
        assert told.episode_return == pytest.approx(total)
        observation, info = after[0], known


def test_the_step_that_ends_an_episode_says_how() -> None:
    """Out of time after six seconds; off the road under full throttle and full lock."""
    driver = new_driver(CALM)
    driven = driver.demonstrate(60)
    assert [step.end for step in driven] == [End.GOES_ON] * 59 + [End.TIME_LIMIT]
    assert sum(step.counts.episodes for step in driven) == 1
    assert not any(step.counts.successes or step.counts.collisions for step in driven)
    driver.reset(seed=1)
    steps: list[DrivenStep] = []
    while not steps or steps[-1].end is End.GOES_ON:
        steps.append(driver.policy_step(np.ones(2, np.float32)))
    assert steps[-1].end is End.FAILURE
    assert sum(step.counts.policy_violations for step in steps) > 0
    assert sum(step.counts.command_violations for step in steps) == 0
    assert all(step.counts.disagreement > 0.0 for step in steps)


def test_a_disturbed_step_keeps_the_clean_label_and_is_no_demonstration() -> None:
    """From one state: the label is the calm one, the executed command is not."""
    steps = []
    for config in (CALM, PUSHED):
        driver = new_driver(config)
        driver.reset(seed=7)
        steps.append(driver.expert_step().transition)
    calm, pushed = steps
    assert np.array_equal(calm.label, pushed.label)
    assert not np.array_equal(calm.command, pushed.command)
    assert calm.expert_drove and not pushed.expert_drove


def images(driver: Driver, episodes: int) -> list[np.ndarray]:
    """First pictures of the next episodes."""
    return [driver.reset()[0]["image"] for _ in range(episodes)]


def test_an_episode_depends_on_its_number_alone() -> None:
    """Cars take turns with the numbers; one that begins later drives what it would have driven."""
    first, second, late = new_driver(), new_driver(place=1), new_driver(place=1)
    ours, theirs = images(first, 3), images(second, 3)
    late.begin_at(5)
    assert np.array_equal(images(late, 1)[0], theirs[2])
    pictures = [*ours, *theirs]
    assert len({picture.tobytes() for picture in pictures}) == 6
    assert not np.array_equal(images(new_driver(seed=1), 1)[0], ours[0])
    driver = new_driver(place=1)
    numbers = [step.transition.episode for step in driver.demonstrate(130)]
    assert list(dict.fromkeys(numbers)) == [1, 3, 5]


def weights(driver: Driver, *, shift: float = 0.0) -> dict[str, np.ndarray]:
    """The policy's, with a shifted mean action."""
    arrays = {name: value.numpy().copy() for name, value in driver.policy.state_dict().items()}
    arrays["action_net.bias"] += np.float32(shift)
    return arrays


def test_the_policy_explores_with_noise_of_the_episodes_own() -> None:
    """The draw is executed as far as planner and shield let it; its probability is the policy's."""
    driver, twin = new_driver(), new_driver()
    twin.load_weights(weights(driver))
    driven, again = driver.drive(5), twin.drive(5)
    policy = driver.policy
    for step, same in zip(driven, again, strict=True):
        draw, transition = step.draw, step.transition
        assert draw is not None and same.draw is not None
        assert np.array_equal(draw.action, same.draw.action)
        seen = {"image": transition.image, "lidar": transition.lidar, "speed": transition.speed}
        tensors, _ = policy.obs_to_tensor(seen)
        value, log_prob, _ = policy.evaluate_actions(tensors, torch.from_numpy(draw.action)[None])
        assert draw.value == pytest.approx(value.item(), abs=1e-5)
        assert draw.log_prob == pytest.approx(log_prob.item(), abs=1e-4)
        assert draw.last_value == 0.0 and not transition.expert_drove
    assert len({step.draw.action.tobytes() for step in driven if step.draw is not None}) == 5
    assert np.array_equal(driver.seen()["lidar"], twin.seen()["lidar"])
    assert not np.array_equal(driver.seen()["lidar"], driven[-1].transition.lidar)


def test_new_weights_drive_from_the_next_step_on() -> None:
    """Another mean, another action, in the same state with the same noise."""
    driver, other = new_driver(), new_driver()
    other.load_weights(weights(driver, shift=0.25))
    mine, its = driver.drive(1)[0].draw, other.drive(1)[0].draw
    assert mine is not None and its is not None
    assert its.action - mine.action == pytest.approx(np.full(2, 0.25), abs=1e-6)


def test_a_time_limit_comes_with_the_value_of_what_followed() -> None:
    """So that the critic can stand in for what was cut off; the next step is a new episode's."""
    driver = new_driver()
    driver.demonstrate(59)
    last, first = driver.drive(2)
    assert last.end is End.TIME_LIMIT and last.draw is not None
    assert last.draw.last_value not in (0.0, last.draw.value)
    assert (first.transition.episode, first.transition.step) == (2, 0)


def test_the_planners_noise_is_the_episodes_own() -> None:
    """What was planned before, in other episodes, changes nothing."""
    fresh, busy = new_driver(activation="always"), new_driver(activation="always")
    busy.reset()
    for _ in range(3):
        busy.policy_step(STILL)
    for driver in (fresh, busy):
        driver.begin_at(4)
        driver.reset()
    mine, theirs = (driver.policy_step(STILL).transition for driver in (fresh, busy))
    assert np.array_equal(mine.command, theirs.command)


def test_training_begins_where_evaluation_does_not_go(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every seed is at least `first_seed`."""
    driver, seeds = new_driver(replace(SHORT, first_seed=2**31 - 3)), []
    real = driver.loop.reset
    monkeypatch.setattr(
        driver.loop, "reset", lambda *, seed, options: seeds.append(seed) or real(seed=seed)
    )
    for _ in range(5):
        driver.reset()
    assert set(seeds) <= set(range(2**31 - 3, 2**31))
