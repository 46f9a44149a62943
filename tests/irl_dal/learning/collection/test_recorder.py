"""What is stored, counted and averaged of the cars' steps."""

import numpy as np
import pytest

from expert import Mode
from expert.replay import ReplayBuffer
from irl_dal.learning.collection.driver import demonstrations
from irl_dal.learning.collection.recorder import Counts, Recorder
from shield import ActuatorLimits
from tests.irl_dal.learning.city import new_driver, new_drivers


def new_recorder(form: str = "label") -> Recorder:
    """Of two cars."""
    return Recorder(ReplayBuffer(500), 2, keep_intervened=form != "off")


def test_the_expert_in_the_buffer_is_the_one_that_the_planner_can_imitate() -> None:
    """Chunks are stretches of one car's executed commands, within the shield's bounds."""
    recorder = new_recorder()
    for driven in demonstrations(new_drivers(), 80):
        recorder.take(driven)
    replay = recorder._replay
    assert replay.count(source="chunk") > 10
    assert set(replay.export_since(0)["episode"]) == {0, 1}
    limits = ActuatorLimits()
    _, chunks = replay.chunks(np.random.default_rng(0), 50)
    steps = np.diff(limits.to_command(chunks.astype(np.float64)), axis=1)
    slowest = -limits.max_deceleration * limits.dt
    assert np.all(np.abs(steps[..., 0]) <= limits.max_steering_rate * limits.dt + 1e-5)
    assert np.all(steps[..., 1] <= limits.max_acceleration * limits.dt + 1e-5)
    assert np.all(steps[..., 1] >= slowest - 1e-5)
    assert sum(replay.sizes.values()) == 80
    assert set(replay.export_since(0)["mode"]) <= set(Mode)


def test_counts_and_running_means() -> None:
    """Steps, episodes and returns are those of the cars; what comes next is remembered."""
    recorder = new_recorder()
    assert np.isnan(recorder.recent).all()
    driven = list(demonstrations(new_drivers(), 124))
    for step in driven:
        recorder.take(step)
    counts = recorder.counts
    assert (counts.steps, counts.episodes, counts.successes) == (124, 2, 0)
    assert counts.command_violations == 0
    assert counts.reward == pytest.approx(sum(step.transition.reward for step in driven))
    ends = [step.episode_return for step in driven if step.counts.episodes]
    assert recorder.recent == pytest.approx((np.mean(ends), 0.0))
    assert recorder.upcoming == [4, 5]
    assert (counts - Counts(steps=60)).steps == 64
    again = new_recorder()
    again.load_state_dict(recorder.state_dict())
    assert again.state_dict() == recorder.state_dict()


def test_without_correction_intervened_steps_are_not_stored() -> None:
    """`off`: the planner's steps leave no trace in the buffer; `label` marks them."""
    for form, stored in (("off", 0), ("label", 5)):
        recorder, driver = new_recorder(form), new_driver(activation="always")
        driver.reset(seed=2)
        for _ in range(5):
            recorder.take(driver.step(np.zeros(2, np.float32))[4]["record"])
        assert len(recorder._replay) == stored
        assert recorder._replay.count(source="corrected") == stored
        assert recorder.counts.triggers == 5
