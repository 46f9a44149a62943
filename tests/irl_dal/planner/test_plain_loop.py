"""Our planning loop beside a plain one over a scheduler of diffusers."""

import time

import numpy as np
import pytest

from irl_dal.cli.threads import one_thread
from tests.irl_dal.planner.plain_loop import PlainLoop
from tests.irl_dal.planner.scenes import LIMITS, planner, random_context

SCENES = [random_context(np.random.default_rng(seed)) for seed in range(3)]


@pytest.mark.parametrize("projection", ["none", "x0", "xt"])
def test_the_plain_loop_makes_the_same_plan(projection: str) -> None:
    """From the same noise, DDIM over diffusers ends where our loop ends."""
    pytest.importorskip("diffusers", reason="pip install 'diffusers>=0.30'")
    ours = planner(projection=projection)
    plain = PlainLoop(ours, "ddim")
    for scene in SCENES:
        ours.generator.manual_seed(3)
        plan = ours.plan(scene)
        ours.generator.manual_seed(3)
        theirs = LIMITS.to_command(plain.plan(scene)[0])
        np.testing.assert_allclose(plan.actions, theirs, atol=2e-3)


def test_our_loop_is_faster_than_the_plain_one() -> None:
    """Less than three quarters of its processor time; the goal is half."""
    pytest.importorskip("diffusers", reason="pip install 'diffusers>=0.30'")
    ours = planner(sampler="ddpm")
    plain = PlainLoop(ours)
    taken: dict[str, list[float]] = {"ours": [], "plain": []}
    with one_thread():
        for scene in [SCENES[0], *SCENES[:2]]:  # the first one warms up
            for name, plan in (("ours", ours.plan), ("plain", plain.plan)):
                begun = time.process_time()
                plan(scene)
                taken[name].append(time.process_time() - begun)
    assert np.median(taken["ours"][1:]) < 0.75 * np.median(taken["plain"][1:])
