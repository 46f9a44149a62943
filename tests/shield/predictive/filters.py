"""Filters that tests share: their CasADi functions are built once."""

from functools import lru_cache

from shield import Assumptions, LaneGeometry, PredictiveFilter, ScannerGeometry
from tests.shield.predictive.kinematic_world import KinematicWorld

TIME = 1e6  # [s] deadline of tests that must not depend on the machine


@lru_cache(maxsize=16)
def shared_filter(beams: int = 180, level: str = "P0") -> PredictiveFilter:
    """A filter for the city's car, to be reset before its use."""
    assumptions = Assumptions(level=level)  # type: ignore[arg-type]
    world, scanner = KinematicWorld([]), ScannerGeometry(beams)
    return PredictiveFilter(
        world.limits, world.geometry, scanner, assumptions, lanes=LaneGeometry(), deadline=TIME
    )


@lru_cache(maxsize=16)
def robot_filter(beams: int) -> PredictiveFilter:
    """A filter for the small robot of `scenes`."""
    from tests.shield.predictive.scenes import small_robot

    robot = small_robot(beams, [])
    assumptions = Assumptions(braking=robot.limits.max_deceleration)
    return PredictiveFilter(
        robot.limits, robot.geometry, robot.scanner, assumptions, deadline=TIME
    )  # fmt: skip
