"""What a car tells of every step, and where its episodes come from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irl_dal.learning.disturbance import DisturbanceConfig
from irl_dal.learning.driver import DRIVEN, DrivenStep, Driver
from irl_dal.learning.hybrid_reward import End
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
            *_, told = driver.step_expert()
            after = loop.step_expert()
        else:
            *_, told = driver.step(action)
            after = loop.step(action)
        driven, known = told[DRIVEN].transition, after[4]
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
        assert told[DRIVEN].episode_return == pytest.approx(total)
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
        steps.append(driver.step(np.ones(2, np.float32))[4][DRIVEN])
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
        steps.append(driver.step_expert()[4][DRIVEN].transition)
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


def test_the_planners_noise_is_the_episodes_own() -> None:
    """What was planned before, in other episodes, changes nothing."""
    fresh, busy = new_driver(activation="always"), new_driver(activation="always")
    busy.reset()
    for _ in range(3):
        busy.step(STILL)
    for driver in (fresh, busy):
        driver.begin_at(4)
        driver.reset()
    mine, theirs = (driver.step(STILL)[4][DRIVEN].transition for driver in (fresh, busy))
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
