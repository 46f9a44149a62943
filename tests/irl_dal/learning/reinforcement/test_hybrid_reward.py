"""The hybrid reward."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from irl_dal.learning.collection.recorder import EpisodeEnd
from irl_dal.learning.reinforcement.hybrid_reward import R_MAX, HybridRewardConfig
from tests.irl_dal.learning.samples import GAMMA, hybrid


@given(st.floats(-200.0, 200.0))
def test_both_forms_are_bounded_and_grow_with_the_logit(logit: float) -> None:
    """Centred is in [-1, 1] and odd; printed in [R_MIN, R_MAX]; neither falls as D grows."""
    centred, printed = hybrid(), hybrid(form="printed")
    near = np.array([logit, logit + 1.0, -logit], np.float32)
    r = centred.imitation_reward(near)
    assert np.all(np.abs(r) <= 1.0)
    assert r[0] <= r[1]
    assert r[0] == pytest.approx(-r[2], abs=1e-6)
    p = printed.imitation_reward(near)
    assert np.all((p >= 0.0) & (p <= R_MAX))
    assert p[0] <= p[1] + 1e-6


def test_the_printed_form_is_the_papers_equation() -> None:
    """-log(1 - D + eps) with D the sigmoid of the logit, before the clipping matters."""
    logits = np.array([-2.0, 0.0, 1.5], np.float32)
    printed = hybrid(form="printed").imitation_reward(logits)
    d = 1.0 / (1.0 + np.exp(-logits))
    assert printed == pytest.approx(-np.log(1.0 - d + 1e-8), rel=1e-5)


def test_the_printed_form_pays_for_every_step_and_the_centred_one_does_not() -> None:
    """An agent that is found out earns from going on as printed, loses as centred."""
    logits = np.full(5, -1.0, np.float32)
    assert np.all(hybrid(form="printed").imitation_reward(logits) > 0.0)
    assert np.all(hybrid().imitation_reward(logits) < 0.0)


@given(st.lists(st.floats(-30.0, 30.0, width=32), min_size=2, max_size=20))
def test_failing_is_never_better_than_driving_on(logits: list[float]) -> None:
    """Whatever D says, r_irl after a failure is at most that of any way of going on."""
    reward = hybrid()
    imitation = reward.imitation_reward(np.array(logits, np.float32))
    ends = np.full(len(logits), EpisodeEnd.GOES_ON, np.int8)
    ends[-1] = EpisodeEnd.FAILURE
    after = reward.continuation(ends, imitation)
    any_other_way = sum(GAMMA**k * imitation.min() for k in range(1, 2000))
    assert after[-1] <= any_other_way + 1e-3
    assert np.all(after[:-1] == 0.0)


def test_without_absorbing_states_an_end_is_worth_nothing() -> None:
    """The printed behaviour stays selectable; then a crash ends a negative reward."""
    reward = hybrid(absorbing=False)
    imitation = np.full(3, -1.0, np.float32)
    ends = np.array([EpisodeEnd.GOES_ON, EpisodeEnd.GOES_ON, EpisodeEnd.FAILURE], np.int8)
    assert np.all(reward.continuation(ends, imitation) == 0.0)
    assert hybrid().continuation(ends, imitation)[2] == pytest.approx(-GAMMA / (1 - GAMMA))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"w_env": 0.5, "w_irl": 0.3}, "`w_env` and `w_irl` .* add to 1. Got 0.5, 0.3"),
        ({"form": "other"}, "`form` must be one of .*Got 'other'"),
    ],
)
def test_impossible_values_are_refused(arguments: dict[str, object], message: str) -> None:
    """The refusal names the key and the value."""
    with pytest.raises(ValueError, match=message):
        HybridRewardConfig(**arguments)
