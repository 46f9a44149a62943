"""Cars in processes of their own."""

from __future__ import annotations

import time

from tests.irl_dal.learning.city import new_drivers


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
