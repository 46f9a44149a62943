"""How long one step of the predictive filter takes: its update, and its answer."""

import time

import numpy as np

from shield.bench.estimation import disc_ranges
from shield.errors import Array
from shield.estimation.lane import LaneEstimate, LaneGeometry
from shield.estimation.scan import ScannerGeometry
from shield.limits.actuator_limits import ActuatorLimits
from shield.predictive.predictive_filter import PredictiveFilter

BEAMS = (45, 180, 360, 1080)
STEPS = 150  # [-] of a street
PARKED, POSTS, WALKERS = 14, 10, 8  # [-] beside the road, and people who cross it
HELD = 10  # [steps] for which the random driver holds a command


def predictive_times(rng: np.random.Generator, *, streets: int = 6) -> dict[str, float]:
    """Drive streets with a driver who keeps to the lane at 7 m/s, and one who asks for anything.

    Returns:
        p50 and p99 of the processor's time for `update` and for `filter` [ms].
    """
    result = {}
    for beams in BEAMS:
        scanner, lanes = ScannerGeometry(beams), LaneGeometry()
        shield = PredictiveFilter(ActuatorLimits(), scanner=scanner, lanes=lanes)
        for driver in ("steady", "random"):
            rows = [_street(shield, rng, random=driver == "random") for _ in range(streets)]
            for name, times in zip(("update", "filter"), np.concatenate(rows).T, strict=True):
                for percent, value in zip((50, 99), np.percentile(times, (50, 99)), strict=True):
                    result[f"{name}_{beams}_beams_{driver}_p{percent}_ms"] = 1e3 * float(value)
    return result


def _street(shield: PredictiveFilter, rng: np.random.Generator, *, random: bool) -> Array:
    """Times (`STEPS`, 2) of `update` and `filter` along a straight street [s]."""
    limits, scanner, count = shield.limits, shield.world.scanner, PARKED + POSTS + WALKERS + 1
    places = np.stack([rng.uniform(12.0, 120.0, count), rng.choice([-3.4, 6.6], count)], axis=1)
    radii = np.repeat([1.0, 0.15, 0.25, 1.0], [PARKED, POSTS, WALKERS, 1])
    velocities = np.zeros((count, 2))
    velocities[PARKED + POSTS : -1, 1] = rng.uniform(-1.2, 1.2, WALKERS)
    places[-1], velocities[-1] = (25.0, 0.0), (6.0, 0.0)  # a car ahead
    pose, turn, command, times = np.zeros(3), 0.0, np.array([0.0, 6.0]), np.empty((STEPS, 2))
    shield.reset(command)
    for step in range(STEPS):
        x, y, yaw = pose
        ways = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        centres = (places - (x, y)) @ ways - (scanner.mount, 0.0)
        scan = disc_ranges(centres, radii, scanner.angles) + rng.normal(0.0, 0.03, scanner.beams)
        lane = LaneEstimate(y, yaw, 0.0, 0.0, 0.03, age=0.0, valid=True)
        if not random:
            nominal = np.array([-0.05 * y - 0.3 * yaw, 7.0])
        elif step % HELD == 0:
            nominal = rng.uniform(limits.low, limits.high)
        begin = time.thread_time()
        shield.update(np.minimum(scan, scanner.max_range), command[1], turn, lane)
        middle = time.thread_time()
        command = shield.filter(nominal).safe_action
        times[step] = middle - begin, time.thread_time() - middle
        turn = float(command[1] * np.tan(command[0]) / limits.wheelbase)
        ahead = yaw + 0.5 * limits.dt * turn
        drive = limits.dt * np.array([command[1] * np.cos(ahead), command[1] * np.sin(ahead), turn])
        pose, places = pose + drive, places + limits.dt * velocities
    return times
