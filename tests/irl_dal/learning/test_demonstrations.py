"""The expert ahead of the learners."""

from __future__ import annotations

import time

import numpy as np
import pytest

from irl_dal.learning import demonstrations as module
from irl_dal.learning.demonstrations import demonstrations, in_processes
from tests.irl_dal.learning.city import new_drivers


def test_cars_ahead_drive_the_same_steps_in_the_same_order(monkeypatch: pytest.MonkeyPatch) -> None:
    """Many small blocks, an odd number of steps, an end of episodes in between."""
    monkeypatch.setattr(module, "BLOCK", 20)
    near, far = new_drivers(), new_drivers(processes=True)
    assert in_processes(far) and not in_processes(near)
    try:
        ours, theirs = list(demonstrations(near, 131)), list(demonstrations(far, 131))
    finally:
        far.close()
    assert len(ours) == len(theirs) == 131
    assert [step.transition.episode % 2 for step in ours] == [0, 1] * 65 + [0]
    assert {step.transition.episode for step in ours} == {0, 1, 2, 3}
    for mine, its in zip(ours, theirs, strict=True):
        assert mine.counts == its.counts and mine.end is its.end
        assert np.array_equal(mine.transition.image, its.transition.image)
        assert np.array_equal(mine.transition.command, its.transition.command)


def test_cars_in_processes_drive_while_nobody_asks(monkeypatch: pytest.MonkeyPatch) -> None:
    """After the first step the next blocks are under way; an early end leaves nothing behind."""
    monkeypatch.setattr(module, "BLOCK", 5)
    drivers = new_drivers(processes=True)
    try:
        steps = demonstrations(drivers, 1000)
        next(steps)
        time.sleep(2.0)
        begun = time.perf_counter()
        for _ in range(9 + 10 * (module.AHEAD - 1)):
            next(steps)
        assert time.perf_counter() - begun < 0.5
        steps.close()
        assert len(drivers.env_method("demonstrate", 3)) == 2
    finally:
        drivers.close()
