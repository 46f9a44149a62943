"""Planning contexts for the tests."""

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from irl_dal.planner import DiffusionPlanner, PlannerConfig, PlanningContext
from shield import ActuatorLimits, ClearanceEstimate, LaneEstimate, ScannerGeometry

Array = NDArray[np.float64]

LIMITS = ActuatorLimits()
SCANNER = ScannerGeometry()
BEAM_ANGLES, MAX_RANGE = SCANNER.angles, SCANNER.max_range
HORIZON = 8


def lane(**changes: Any) -> LaneEstimate:
    """A lane pose slightly off the home lane's centre."""
    return replace(LaneEstimate(0.6, 0.05, 0.01, 0.001, 0.1, 0.0, True), **changes)


def scan_of(bearing: float, distance: float, width: float = 2.0) -> Array:
    """A scan with one flat object [m] at a bearing [rad], facing the LiDAR."""
    scan = np.full(len(BEAM_ANGLES), MAX_RANGE)
    half = np.arctan2(0.5 * width, distance)
    inside = np.abs(BEAM_ANGLES - bearing) <= half
    scan[inside] = distance / np.cos(BEAM_ANGLES[inside] - bearing)
    return scan


def context(
    bearing: float = 0.1, distance: float = 6.0, speed: float = 6.0, **changes: Any
) -> PlanningContext:
    """A car with one object ahead; `changes` replace fields of the context."""
    scan = scan_of(bearing, distance)
    plain = PlanningContext(
        scan=scan,
        clearance=ClearanceEstimate(float(scan.min()), speed, 0.05, 0.0, True),
        lane=lane(),
        speed=speed,
        previous=np.array([0.02, speed]),
    )
    return replace(plain, **changes)


def open_road(**changes: Any) -> PlanningContext:
    """No return in sight."""
    empty = replace(
        context(),
        scan=np.full(len(BEAM_ANGLES), MAX_RANGE),
        clearance=ClearanceEstimate(MAX_RANGE, 0.0, 0.05, 0.0, True),
    )
    return replace(empty, **changes)


def random_context(rng: np.random.Generator) -> PlanningContext:
    """An object somewhere ahead, any pose, any speed."""
    speed = float(rng.uniform(1.0, 10.0))
    return context(
        bearing=float(rng.uniform(-0.6, 0.6)),
        distance=float(rng.uniform(1.0, 12.0)),
        speed=speed,
        lane=lane(
            lateral_offset=float(rng.normal(0.0, 0.8)),
            heading_error=float(rng.normal(0.0, 0.1)),
            curvature=float(rng.normal(0.0, 0.01)),
        ),
        previous=np.array([float(rng.normal(0.0, 0.05)), speed]),
    )


def planner(seed: int = 0, **settings: Any) -> DiffusionPlanner:
    """A planner with a generous deadline, so that a busy machine changes nothing."""
    config = PlannerConfig(**{"deadline": 60.0, **settings})
    return DiffusionPlanner(config, LIMITS, generator=torch.Generator().manual_seed(seed))


def chunks(rng: np.random.Generator, around: PlanningContext, batch: int) -> Array:
    """Normalised plans (B, H, 2) that start near the last command."""
    steps = rng.normal(0.0, 0.08, (batch, HORIZON, 2))
    return np.asarray(LIMITS.to_action(around.previous) + np.cumsum(steps, axis=1))


def breaks_a_bound(plan: np.ndarray, previous: np.ndarray) -> bool:
    """Whether a horizon is inadmissible from the last command on."""
    return any(
        LIMITS.violated(now, before)
        for now, before in zip(plan, [previous, *plan[:-1]], strict=True)
    )
