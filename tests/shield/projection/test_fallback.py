"""The last plan, then brakes: admissible by construction."""

import numpy as np
import pytest
from hypothesis import strategies as st

from shield.projection.fallback import FallbackPlan
from tests.shield.oracles import broken_bounds
from tests.shield.strategies import CITY, VEHICLES, admissible_commands, horizons
from tests.shield.tiers import two_tiers


@two_tiers(data=st.data())
def test_the_fallback_is_admissible_and_ends_in_braking(data: st.DataObject) -> None:
    """From any admissible command, with any remembered plan, for any length."""
    limits = data.draw(st.sampled_from(VEHICLES))
    previous = data.draw(admissible_commands(limits))
    plan = FallbackPlan(limits)
    remembered = data.draw(st.integers(0, 6))
    if remembered:
        wish = data.draw(horizons(limits, remembered, previous))
        if data.draw(st.booleans()):
            wish[data.draw(st.integers(0, remembered - 1)), 0] = np.nan
        plan.remember(wish)
    commands, what = plan.horizon(*previous.tolist(), 40)
    actions = np.array(commands).reshape(-1, 2)
    assert broken_bounds(limits, actions, previous) == []
    assert what in ("braking", "the last plan shifted by one")
    slowest = min(max(0.0, limits.min_speed), limits.max_speed)
    gaps = np.abs(actions[remembered:, 1] - slowest)
    assert (np.diff(gaps) <= 0.0).all()
    if what == "braking":
        assert (actions[:, 0] == previous[0]).all()


def test_the_plan_is_shifted_by_one_each_step() -> None:
    """The second command of the plan first, then the third, then brakes."""
    plan = FallbackPlan(CITY)
    steps = np.column_stack([np.linspace(0.0, 0.05, 4), np.linspace(5.0, 5.3, 4)])
    plan.remember(steps)
    commands, what = plan.horizon(0.0, 5.0, 3)
    assert what == "the last plan shifted by one"
    assert np.array(commands).reshape(-1, 2) == pytest.approx(steps[1:], abs=1e-12)
    plan.advance()
    commands, _ = plan.horizon(*steps[1], 1)
    assert commands == pytest.approx(steps[2], abs=1e-12)
    plan.advance()
    plan.advance()
    commands, what = plan.horizon(*steps[3], 1)
    assert what == "braking"
    assert commands == pytest.approx([steps[3, 0], steps[3, 1] - 0.6])
    plan.remember(steps)
    plan.reset()
    assert plan.horizon(0.0, 5.0, 1)[1] == "braking"
