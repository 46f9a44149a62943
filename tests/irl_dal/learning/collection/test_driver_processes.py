"""The cars together."""

import time

import numpy as np
import pytest

from irl_dal.learning.collection import driver
from irl_dal.learning.collection.driver import demonstrations
from tests.irl_dal.learning.city import new_drivers


def test_cars_in_processes_drive_the_same_steps_in_the_same_order(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Many small blocks, an odd number of steps, an end of episodes in between."""
    monkeypatch.setattr(driver, "BLOCK", 20)
    near, far = new_drivers(), new_drivers(processes=True)
    try:
        ours, theirs = list(demonstrations(near, 131)), list(demonstrations(far, 131))
    finally:
        far.close()
    assert len(ours) == len(theirs) == 132
    assert [step.transition.episode % 2 for step in ours] == [0, 1] * 66
    assert {step.transition.episode for step in ours} == {0, 1, 2, 3}
    for mine, its in zip(ours, theirs, strict=True):
        assert mine.counts == its.counts and mine.end is its.end
        assert np.array_equal(mine.transition.image, its.transition.image)
        assert np.array_equal(mine.transition.command, its.transition.command)


def test_cars_end_in_the_middle_of_a_stretch() -> None:
    """One car has answered, the other has not, as after Ctrl-C; a second close is nothing."""
    drivers = new_drivers(processes=True)
    for remote, steps in zip(drivers.remotes, (1, 10_000), strict=True):
        remote.send(("env_method", ("demonstrate", [steps], {})))
    assert len(drivers.remotes[0].recv()) == 1
    begun = time.monotonic()
    drivers.close()
    assert time.monotonic() - begun < 5.0
    assert not any(process.is_alive() for process in drivers.processes)
    drivers.close()
