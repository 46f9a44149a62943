"""What is stored and counted of every step."""

from __future__ import annotations

import numpy as np
import pytest

from expert import Mode
from expert.replay import ReplayBuffer
from irl_dal.learning.disturbance import Disturbance, DisturbanceConfig
from irl_dal.learning.experience_correction import ExperienceCorrection
from irl_dal.learning.hybrid_reward import End
from irl_dal.learning.recorder import Counts, Recorder
from tests.irl_dal.learning.city import new_loop

FIRST_SEED = 1000


CALM = DisturbanceConfig(rate=0.0)


def new_recorder(
    seed: int = 0,
    form: str = "label",
    disturbance: DisturbanceConfig = CALM,
    **supervision: object,
) -> Recorder:
    """A recorder on the real loop."""
    return Recorder(
        new_loop(**supervision),
        ReplayBuffer(500),
        ExperienceCorrection(form),  # type: ignore[arg-type]
        np.random.default_rng(seed),
        FIRST_SEED,
        Disturbance(disturbance, np.random.default_rng(0)),
    )


def test_each_transition_joins_a_state_with_its_own_label_and_the_command_that_followed() -> None:
    """Against the loop itself, driven beside the recorder with the same seed and actions."""
    recorder, loop = new_recorder(activation="always"), new_loop(activation="always")
    recorder.reset(seed=7)
    observation, info = loop.reset(seed=7)
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (12, 2)).astype(np.float32)
    expected = []
    for step, action in enumerate(actions):
        before = (observation, info)
        if step < 6:
            recorder.step_expert()
            observation, reward, _, _, info = loop.step_expert()
        else:
            recorder.step(action)
            observation, reward, _, _, info = loop.step(action)
        expected.append((*before, reward, info))
    rows = recorder._replay.export_since(0)
    assert len(rows["serial"]) == 12
    for step, (seen, known, reward, after) in enumerate(expected):
        assert np.array_equal(rows["image"][step], seen["image"])
        assert np.array_equal(rows["lidar"][step], seen["lidar"])
        assert np.array_equal(rows["context"][step], known["context"].encode())
        assert np.array_equal(rows["label"][step], known["expert_action"])
        assert rows["command"][step] == pytest.approx(after["executed_action"], abs=1e-6)
        assert rows["mode"][step] == known["mode"]
        assert rows["reward"][step] == pytest.approx(reward, rel=1e-6)
        assert rows["expert_drove"][step] == (step < 6)
        assert rows["intervened"][step] == (step >= 6)
    assert rows["step"].tolist() == list(range(12))


def test_the_expert_in_the_buffer_is_the_one_that_the_planner_can_imitate() -> None:
    """Chunks are stretches of the expert's executed commands, within the shield's bounds."""
    recorder = new_recorder()
    recorder.reset(seed=3)
    for _ in range(30):
        recorder.step_expert()
    limits = recorder.loop.limits
    _, chunks = recorder._replay.chunks(np.random.default_rng(0), 50)
    commands = limits.to_command(chunks.astype(np.float64))
    steps = np.diff(commands, axis=1)
    slowest = -limits.max_deceleration * limits.dt
    assert np.all(np.abs(steps[..., 0]) <= limits.max_steering_rate * limits.dt + 1e-5)
    assert np.all(steps[..., 1] <= limits.max_acceleration * limits.dt + 1e-5)
    assert np.all(steps[..., 1] >= slowest - 1e-5)


def test_seeds_are_drawn_from_the_given_generator_beyond_those_of_evaluation() -> None:
    """Same generator, same first image; every seed is at least `first_seed`."""
    first, second = new_recorder(5), new_recorder(5)
    assert np.array_equal(first.reset()[0]["image"], second.reset()[0]["image"])
    drawn = np.random.default_rng(5).integers(FIRST_SEED, 2**31)
    assert drawn >= FIRST_SEED
    third = new_recorder(6)
    assert np.array_equal(
        third.reset(seed=int(drawn))[0]["lidar"], first.reset(seed=int(drawn))[0]["lidar"]
    )


def test_counts_and_ends() -> None:
    """Steps, episodes and their ends are counted; the step that ends an episode says so."""
    recorder = new_recorder()
    recorder.reset(seed=1)
    info: dict[str, object] = {}
    for _ in range(60):
        *_, truncated, info = recorder.step_expert()
    assert truncated
    assert info == {"is_success": False}
    assert recorder.last is not None and recorder.last.end is End.TIME_LIMIT
    counts = recorder.counts
    assert (counts.steps, counts.episodes, counts.successes, counts.collisions) == (60, 1, 0, 0)
    assert counts.command_violations == 0
    assert recorder.episode_return == pytest.approx(counts.reward)
    recorder.reset(seed=1)
    for _ in range(200):
        *_, terminated, truncated, info = recorder.step(np.array([1.0, 1.0], np.float32))
        if terminated or truncated:
            break
    assert recorder.last.end is End.FAILURE
    assert counts.policy_violations > 0
    assert counts.command_violations == 0
    assert counts.minus(Counts(steps=60)).steps == counts.steps - 60


def test_without_correction_intervened_steps_are_not_stored() -> None:
    """`off`: the planner's steps leave no trace in the buffer; `label` marks them."""
    for form, stored in (("off", 0), ("label", 5)):
        recorder = new_recorder(form=form, activation="always")
        recorder.reset(seed=2)
        for _ in range(5):
            recorder.step(np.zeros(2, np.float32))
        assert len(recorder._replay) == stored
        assert recorder._replay.count(source="corrected") == stored
        assert recorder.counts.triggers == 5


def test_every_mode_of_the_buffer_is_one_of_the_experts() -> None:
    """The partition is that of the state acted upon."""
    recorder = new_recorder()
    recorder.reset(seed=4)
    for _ in range(40):
        recorder.step_expert()
    assert sum(recorder._replay.sizes.values()) == 40
    assert set(recorder._replay.export_since(0)["mode"]) <= set(Mode)


def test_a_disturbed_step_keeps_the_clean_label_and_is_no_demonstration() -> None:
    """From one state: the label is the calm one, the executed command is not, no chunk begins."""
    calm, pushed = new_recorder(), new_recorder(disturbance=DisturbanceConfig(rate=1.0))
    rows = []
    for recorder in (calm, pushed):
        recorder.reset(seed=7)
        recorder.step_expert()
        rows.append(recorder._replay.export_since(0))
    assert np.array_equal(rows[0]["label"], rows[1]["label"])
    assert not np.array_equal(rows[0]["command"], rows[1]["command"])
    assert rows[0]["expert_drove"][0] and not rows[1]["expert_drove"][0]
