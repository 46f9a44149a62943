"""What is learnt from steps on which the planner acted."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from irl_dal.learning.imitation.experience_correction import ExperienceCorrection
from irl_dal.learning.reinforcement.policy import mean_action, observation_tensors
from tests.irl_dal.learning.samples import filled_replay, new_policy


@pytest.mark.parametrize(
    ("form", "kept", "replaced", "marks"),
    [("label", True, False, 1), ("paper", True, True, 1), ("off", False, False, 0)],
)
def test_each_form_keeps_and_replaces_as_documented(
    form: str, kept: bool, replaced: bool, marks: int
) -> None:
    """The table in the module, for intervened steps; others are always kept as they are."""
    correction = ExperienceCorrection(form)  # type: ignore[arg-type]
    assert correction.keeps(intervened=True) is kept
    assert correction.replaces(intervened=True) is replaced
    assert correction.keeps(intervened=False)
    assert not correction.replaces(intervened=False)
    assert correction.marks == marks


def test_the_experts_action_comes_with_its_probability_under_the_policy() -> None:
    """The log-density of a diagonal Gaussian, recomputed."""
    policy = new_policy()
    seen = observation_tensors(filled_replay(20).sample(np.random.default_rng(0), 1), "cpu")
    label = np.array([0.3, -0.1], np.float32)
    with torch.no_grad():
        mean = mean_action(policy, seen)[0].numpy()
        log_std = policy.log_std.numpy()
    action, log_prob = ExperienceCorrection.expert_draw(policy, seen, label)
    z = (label - mean) / np.exp(log_std)
    assert action is label
    assert log_prob == pytest.approx(
        (-0.5 * z**2 - log_std - 0.5 * np.log(2 * np.pi)).sum(), rel=1e-4
    )


def test_an_unknown_form_is_refused() -> None:
    """The refusal names the key and the value."""
    with pytest.raises(ValueError, match="`saec` must be one of .*Got 'other'"):
        ExperienceCorrection("other")  # type: ignore[arg-type]
