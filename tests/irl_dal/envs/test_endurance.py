"""Long runs leave no memory behind and nothing ends in an exception."""

import os
from pathlib import Path

import numpy as np
import pytest

from irl_dal.bench.drive import expert_drives
from irl_dal.envs import FAULTS, CityConfig, CityEnv

ENOUGH = 10.0
"""Growth that is not a leak: pools that pybullet and Python fill once [MiB]."""


def resident() -> float:
    """Memory of this process [MiB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def growth(env: CityEnv, resets: int) -> float:
    """Memory that `resets` more resets and a few steps after each have taken [MiB]."""
    before = resident()
    for seed in range(resets):
        env.reset(seed=seed)
        for _ in range(2):
            env.execute(np.array([0.0, 8.0]))
    return resident() - before


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs Linux's /proc")
def test_resets_leave_no_memory_behind() -> None:
    """A mesh that pybullet kept would be 250 kB a reset."""
    env = CityEnv()
    growth(env, 20)
    assert growth(env, 60) < ENOUGH
    env.close()


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs Linux's /proc")
def test_memory_is_flat_over_two_thousand_resets() -> None:
    """At length: what leaks 5 kB a reset is seen."""
    env = CityEnv()
    growth(env, 50)
    assert growth(env, 2_000) < ENOUGH
    env.close()


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", sorted(FAULTS))
def test_forty_episodes_under_each_fault(name: str) -> None:
    """Short ones; every one ends as an episode may end, and leaves less than 250 kB behind."""
    config = CityConfig(route_length=80.0, route_spread=0.0, faults=FAULTS[name])
    before, outcomes = resident(), set()
    for drive in expert_drives(config, range(40)):
        outcomes.add(drive.outcome)
    assert outcomes <= {"success", "collision", "off_road", "timeout"}
    assert resident() - before < ENOUGH
