"""Cars in processes of their own."""

from __future__ import annotations

import time

import numpy as np

from tests.irl_dal.learning.city import new_drivers


def test_cars_end_in_the_middle_of_a_step() -> None:
    """One car has answered, the other has not, as after Ctrl-C; a second close is nothing."""
    drivers = new_drivers(processes=True)
    drivers.reset()
    drivers.step_async(np.zeros((2, 2), np.float32))
    drivers.remotes[0].recv()
    begun = time.monotonic()
    drivers.close()
    assert time.monotonic() - begun < 5.0
    assert not any(process.is_alive() for process in drivers.processes)
    drivers.close()
