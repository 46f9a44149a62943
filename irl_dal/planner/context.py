"""What a plan depends on, and its 64 numbers for the network (the paper's c_t)."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irl_dal.arrays import Array
from shield import ClearanceEstimate, LaneEstimate, LaneGeometry, ScannerGeometry, VehicleGeometry

CONTEXT_SIZE = 64  # Table II of the paper's text: c_t has 64 entries
FEWEST_BEAMS = 8  # A scanner with fewer does not tell the lanes apart
SECTORS = 30  # Of the scanner's field of view: of each, the nearest return is kept
HAZARD_SCALE = 3.0  # s_h of Table II [m]
# Scales of the entries: what a drive seldom exceeds. They are part of trained weights.
_SPEED, _STEERING, _OFFSET, _HEADING = 12.0, 0.5, 3.5, 0.3  # [m/s, rad, m, rad]
_CURVATURE, _CURVATURE_RATE = 0.05, 0.005  # [1/m, 1/m^2]
_NEAR, _AGE, _RANGE_STD, _OFFSET_STD = 5.0, 1.0, 1.0, 0.5  # [m, s, m, m]
LARGEST = 3.0  # Entries are clipped to [-3, 3]: beyond, a network has seen nothing
# Places of the entries; from 50 on they are unused and zero
HAZARD, CLEARANCE, CLOSING_SPEED, CLEARANCE_STD, CLEARANCE_VALID = 0, 1, 2, 3, 4
LATERAL_OFFSET, HEADING_ERROR, CURVATURE, CURVATURE_RATE, LANE_DEVIATION = 5, 6, 7, 8, 9
OFFSET_STD, LANE_AGE, LANE_VALID = 10, 11, 12
SPEED, PREVIOUS_STEERING, PREVIOUS_SPEED = 13, 14, 15
SECTOR_START = 16
SCAN_MEAN, SCAN_STD, SCAN_RETURNS, NEAREST_BEARING = 46, 47, 48, 49


def hazard(clearance: float) -> float:
    """The energies' hazard level h_t = clamp(1 - tanh(d_min / s_h), 0, 1); d_min in metres."""
    return min(1.0, max(0.0, 1.0 - math.tanh(clearance / HAZARD_SCALE)))


@dataclass(frozen=True, slots=True, eq=False)
class PlanningContext:
    """Everything a plan is made from, in physical units.

    `ValueError` for a wrong shape, or no lane centre. Values are not judged here.
    """

    scan: Array  # LiDAR ranges (beams,) [m]
    clearance: ClearanceEstimate  # Filtered minimum clearance and closing speed
    lane: LaneEstimate  # Filtered lane pose
    speed: float  # Measured speed [m/s]
    previous: Array  # Last executed command (2,) [rad, m/s]
    expert_reference: Array | None = None  # The expert's commands (H, 2) [rad, m/s], or None
    lane_centres: tuple[float, ...] = LaneGeometry().centres  # As lateral offsets [m]
    scanner: ScannerGeometry | None = None  # By default the scan's beams over a half turn
    vehicle: VehicleGeometry = VehicleGeometry()  # Outline of the car

    def __post_init__(self) -> None:
        scan, previous = _read_only(self.scan), _read_only(self.previous)
        if scan.ndim != 1 or scan.size < FEWEST_BEAMS:
            raise ValueError(f"`scan` must have shape (n,), n >= {FEWEST_BEAMS}. Got {scan.shape}.")
        if self.scanner is not None and scan.size != self.scanner.beams:
            beams = self.scanner.beams
            raise ValueError(f"`scan` must have shape ({beams},). Got {scan.shape}.")
        if previous.shape != (2,):
            raise ValueError(f"`previous` must have shape (2,). Got {previous.shape}.")
        if not self.lane_centres:
            raise ValueError("`lane_centres` must name at least one lane. Got ().")
        object.__setattr__(self, "scan", scan)
        object.__setattr__(self, "previous", previous)
        if self.expert_reference is not None:
            reference = _read_only(self.expert_reference)
            if reference.ndim != 2 or reference.shape[1] != 2:
                got = reference.shape
                raise ValueError(f"`expert_reference` must have shape (H, 2). Got {got}.")
            object.__setattr__(self, "expert_reference", reference)

    @property
    def geometry(self) -> ScannerGeometry:
        """Where the beams of the scan point."""
        return ScannerGeometry(beams=self.scan.size) if self.scanner is None else self.scanner

    @property
    def nearest(self) -> float:
        """The paper's d_min [m]: the tracked clearance, or the scan's minimum without one."""
        if self.clearance.valid:
            return float(self.clearance.clearance)
        return float(self.scan.min())

    @property
    def lane_deviation(self) -> float:
        """Signed distance to the nearest admissible lane centre [m], positive to its left."""
        offset = float(self.lane.lateral_offset)
        return min((offset - centre for centre in self.lane_centres), key=abs)

    @property
    def finite(self) -> bool:
        """Whether everything that a plan uses is a finite number."""
        near, lane = self.clearance, self.lane
        numbers = [self.speed, *self.scan, *self.previous]
        if near.valid:
            numbers += [near.clearance, near.closing_speed, near.std]
        if lane.valid:
            numbers += [lane.lateral_offset, lane.heading_error, lane.curvature]
            numbers += [lane.curvature_rate, lane.offset_std]
        if self.expert_reference is not None:
            numbers += self.expert_reference.ravel().tolist()
        return bool(np.isfinite(numbers).all())

    def encode(self) -> NDArray[np.float32]:
        """The paper's c_t (64,) float32.

        Estimates that are not valid read as zero with their flag at zero. Everything is scaled to
        about [-1, 1] and clipped to [-3, 3]; NaN stays NaN.
        """
        code, lane, scanner = np.zeros(CONTEXT_SIZE), self.lane, self.geometry
        code[HAZARD] = hazard(self.nearest)
        code[CLEARANCE] = self.nearest / scanner.max_range
        if self.clearance.valid:
            code[CLOSING_SPEED] = self.clearance.closing_speed / _SPEED
            code[CLEARANCE_STD] = self.clearance.std / _RANGE_STD
            code[CLEARANCE_VALID] = 1.0
        code[LANE_AGE] = min(float(lane.age) / _AGE, LARGEST)
        if lane.valid:
            code[LATERAL_OFFSET] = lane.lateral_offset / _OFFSET
            code[HEADING_ERROR] = lane.heading_error / _HEADING
            code[CURVATURE] = lane.curvature / _CURVATURE
            code[CURVATURE_RATE] = lane.curvature_rate / _CURVATURE_RATE
            code[LANE_DEVIATION] = self.lane_deviation / (0.5 * _OFFSET)
            code[OFFSET_STD] = lane.offset_std / _OFFSET_STD
            code[LANE_VALID] = 1.0
        code[SPEED] = self.speed / _SPEED
        code[PREVIOUS_STEERING] = self.previous[0] / _STEERING
        code[PREVIOUS_SPEED] = self.previous[1] / _SPEED
        ranges = np.clip(self.scan, 0.0, scanner.max_range)
        # With fewer beams than sectors, neighbouring sectors share a beam.
        nearest = np.minimum.reduceat(ranges, np.arange(SECTORS) * scanner.beams // SECTORS)
        # Nearness d_0 / (d_0 + d) keeps the resolution where it matters.
        code[SECTOR_START : SECTOR_START + SECTORS] = _NEAR / (_NEAR + nearest)
        code[SCAN_MEAN] = ranges.mean() / scanner.max_range
        code[SCAN_STD] = ranges.std() / scanner.max_range
        returned = ranges < scanner.max_range
        code[SCAN_RETURNS] = returned.mean()
        if returned.any():
            code[NEAREST_BEARING] = scanner.angles[int(np.argmin(ranges))] / (0.5 * math.pi)
        return np.clip(code, -LARGEST, LARGEST).astype(np.float32)


def _read_only(values: Array) -> Array:
    """A read-only double-precision copy."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array
