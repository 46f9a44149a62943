"""What a car records of every step, and where its episodes come from."""

from dataclasses import replace

import numpy as np
import pytest

from irl_dal.learning.collection.driver import Driver
from irl_dal.learning.collection.recorder import EpisodeEnd, StepRecord
from tests.irl_dal.learning.city import SHORT, new_driver, new_loop

CALM = replace(SHORT, disturbance_rate=0.0)
PUSHED = replace(SHORT, disturbance_rate=1.0)
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
            told = driver.demonstrate(1)[0]
            after = loop.step_expert()
        else:
            told = driver.step(action)[4]["record"]
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
    assert [step.end for step in driven] == [EpisodeEnd.GOES_ON] * 59 + [EpisodeEnd.TIME_LIMIT]
    assert sum(step.counts.episodes for step in driven) == 1
    assert not any(step.counts.successes or step.counts.collisions for step in driven)
    driver.reset(seed=1)
    steps: list[StepRecord] = []
    while not steps or steps[-1].end is EpisodeEnd.GOES_ON:
        steps.append(driver.step(np.ones(2, np.float32))[4]["record"])
    assert steps[-1].end is EpisodeEnd.FAILURE
    assert sum(step.counts.command_violations for step in steps) == 0
    assert all(step.counts.disagreement > 0.0 for step in steps)


def test_a_disturbed_step_keeps_the_clean_label_and_is_no_demonstration() -> None:
    """From one state: the label is the calm one, the executed command is not."""
    steps = []
    for config in (CALM, PUSHED):
        driver = new_driver(config)
        driver.reset(seed=7)
        steps.append(driver.demonstrate(1)[0].transition)
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


def test_a_car_is_a_gymnasium_environment() -> None:
    """What `step` returns agrees with its record, at the end of an episode too."""
    driver = new_driver()
    observation, _ = driver.reset(seed=1)
    over = False
    while not over:
        before = observation
        observation, reward, terminated, truncated, info = driver.step(np.ones(2, np.float32))
        record, over = info["record"], terminated or truncated
        assert np.array_equal(record.transition.image, before["image"])
        assert reward == record.transition.reward and driver.observation_space.contains(observation)
        assert terminated == (record.end in (EpisodeEnd.SUCCESS, EpisodeEnd.FAILURE))
        assert truncated == (record.end is EpisodeEnd.TIME_LIMIT)


def test_new_planner_weights_plan_from_the_next_step_on() -> None:
    """Other weights, another plan, in the same state with the same noise."""
    driver, other = (new_driver(CALM, activation="always") for _ in range(2))
    planner = driver.loop.supervision.planner
    assert planner is not None
    weights = {
        name: w.numpy() + np.float32(0.1) for name, w in planner.denoiser.state_dict().items()
    }
    other.load_planner(weights)
    for car in (driver, other):
        car.reset(seed=3)
    mine, its = (
        [car.step(STILL)[4]["record"].transition for _ in range(10)] for car in (driver, other)
    )
    assert np.array_equal(mine[0].image, its[0].image)
    assert any(not np.array_equal(m.command, i.command) for m, i in zip(mine, its, strict=True))


def test_the_planners_noise_is_the_episodes_own() -> None:
    """What was planned before, in other episodes, changes nothing."""
    fresh, busy = new_driver(activation="always"), new_driver(activation="always")
    busy.reset()
    for _ in range(3):
        busy.step(STILL)
    for driver in (fresh, busy):
        driver.begin_at(4)
        driver.reset()
    mine, theirs = (driver.step(STILL)[4]["record"].transition for driver in (fresh, busy))
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
