"""What is learnt from steps on which the planner acted."""

import numpy as np
import pytest
import torch

from irl_dal.learning.imitation.experience_correction import correct_as_printed
from irl_dal.learning.reinforcement.policy import mean_action
from tests.irl_dal.learning.samples import label, new_policy, observation, record


def test_the_printed_form_replaces_the_sample() -> None:
    """Of intervened steps only; the log-density of a diagonal Gaussian, recomputed."""
    policy, rng = new_policy(), np.random.default_rng(0)
    seen = [observation(rng) for _ in range(2)]
    records = [record(seen[0]), record(seen[1], intervened=True)]
    actions, log_probs = np.full((2, 2), 0.5, np.float32), torch.full((2,), -1.0)
    correct_as_printed(policy, records, actions, log_probs)
    assert np.array_equal(actions[0], [0.5, 0.5]) and log_probs[0] == -1.0
    tensors, _ = policy.obs_to_tensor(dict(seen[1]))
    with torch.no_grad():
        mean = mean_action(policy, tensors)[0].numpy()  # type: ignore[arg-type]
    log_std = policy.log_std.detach().numpy()
    z = (label(seen[1]) - mean) / np.exp(log_std)
    expected = (-0.5 * z**2 - log_std - 0.5 * np.log(2 * np.pi)).sum()
    assert np.array_equal(actions[1], label(seen[1]))
    assert log_probs[1].item() == pytest.approx(expected, rel=1e-4)
