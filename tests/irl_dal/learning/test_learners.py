"""What the learners draw from the replay buffer and from the rollout."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irl_dal.learning.learners import _evenly
from tests.irl_dal.learning.city import SHORT, new_driver, new_pipeline


def test_rows_are_drawn_evenly_over_the_modes_that_occur() -> None:
    """Ninety-five to five becomes half and half, within a mode every row is as likely."""
    modes = np.array([0] * 95 + [3] * 5, np.int8)
    rows = _evenly(np.random.default_rng(0), modes, 2000)
    assert np.bincount(modes[rows], minlength=4).tolist() == [1000, 0, 0, 1000]
    assert np.bincount(rows[modes[rows] == 3] - 95) == pytest.approx(np.full(5, 200), abs=60)


@pytest.mark.parametrize("sampling", ["balanced", "uniform"])
def test_the_discriminator_sees_both_sides_in_the_same_mixture_of_modes(
    tmp_path: Path, sampling: str
) -> None:
    """In balanced sampling the agent's pairs, out of the rollout, are balanced as well."""
    config = replace(SHORT, imitation_steps=20, mixed_steps=32, sampling=sampling)  # type: ignore[arg-type]
    pipeline = new_pipeline(tmp_path, config)
    pipeline.run()
    buffer = pipeline.learners.ppo.rollout_buffer
    buffer.modes[:] = 0
    buffer.modes[-2:] = 2
    buffer.executed_actions[..., 0] = buffer.modes
    for key, values in buffer.observations.items():
        buffer.observations[key] = values.reshape(16, 2, -1)
    _, actions = pipeline.learners._agent_pairs(buffer)
    share = float((actions[:, 0] == 2.0).float().mean())
    assert share == pytest.approx(0.5 if sampling == "balanced" else 0.125, abs=0.2)


def test_a_part_of_each_cloning_batch_is_corrected_steps(tmp_path: Path) -> None:
    """As soon as there are marks, `corrected_share` of a batch carries them."""
    config = replace(SHORT, imitation_steps=40, mixed_steps=32)
    pipeline = new_pipeline(tmp_path, config)
    learners, driver = pipeline.learners, new_driver(activation="always")
    for record in driver.demonstrate(20):
        pipeline.recorder.take(record)
    assert not learners._cloning_batch().intervened.any()
    for _ in range(2):
        pipeline.recorder.take(driver.step(np.zeros(2, np.float32))[4]["record"])
    batch = learners._cloning_batch()
    assert len(batch) == 16
    assert batch.intervened.sum() >= 4
