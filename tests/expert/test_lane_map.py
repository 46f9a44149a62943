"""Scan points land in the right lane at the right distance."""

import numpy as np
import pytest

from expert.lane_map import LaneMap
from shield import LaneEstimate, LaneMeasurement, LaneTracker, ScannerGeometry

SCANNER = ScannerGeometry()
ANGLES = SCANNER.angles


def estimate(offset: float, heading: float, curvature: float) -> LaneEstimate:
    """What a tracker says after many equal, noise-free measurements while standing."""
    tracker = LaneTracker(0.1)
    for _ in range(200):
        lane = tracker.update(LaneMeasurement(offset, heading, curvature, 0.0), 0.0, 0.0)
    return lane


def scan_of(points: np.ndarray) -> np.ndarray:
    """Ranges that hit `points` (n, 2), given in the frame of the LiDAR."""
    scan = np.full(180, 40.0)
    for x, y in points:
        beam = int(np.argmin(np.abs(ANGLES - np.arctan2(y, x))))
        scan[beam] = min(scan[beam], float(np.hypot(x, y)))
    return scan


@pytest.mark.parametrize("offset", [-0.5, 0.0, 3.4])
@pytest.mark.parametrize("heading", [-0.1, 0.0, 0.15])
@pytest.mark.parametrize("curvature", [-0.03, 0.0, 0.03])
def test_a_point_ahead_is_found_where_it_is(
    offset: float, heading: float, curvature: float
) -> None:
    """An obstacle 20 m along the lane is seen there, whatever the car's pose and the bend."""
    s = SCANNER.mount + 18.0
    angle = curvature * s
    along = np.array([np.sinc(angle / np.pi) * s, s * angle / 2 * np.sinc(angle / 2 / np.pi) ** 2])
    lane_to_car = np.array(
        [[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]]
    )
    target = lane_to_car @ (along - [0.0, offset]) - [SCANNER.mount, 0.0]
    lanes = LaneMap.build(scan_of(target[None]), estimate(offset, heading, curvature), SCANNER)
    assert lanes.s == pytest.approx([18.0], abs=0.6)
    assert lanes.d == pytest.approx([0.0], abs=0.35)


def test_nothing_hit_means_free() -> None:
    """An empty scan leaves both lanes free for ever."""
    lanes = LaneMap.build(np.full(180, 40.0), estimate(0.0, 0.0, 0.0), SCANNER)
    assert lanes.gap(0.0, 1.5) == np.inf
    assert lanes.gap_on_the_way(0.0, 3.5, 0.3, 1.2) == np.inf


def test_a_lane_change_sweeps_only_its_way() -> None:
    """A late lane change hits what an early one avoids."""
    lanes = LaneMap.build(scan_of(np.array([[15.0, 0.0]])), estimate(0.0, 0.0, 0.0), SCANNER)
    assert lanes.gap(0.0, 1.5) == pytest.approx(15.0, abs=0.3)
    assert lanes.gap_on_the_way(0.0, 3.5, 0.3, 1.2) == np.inf
    assert lanes.gap_on_the_way(0.0, 3.5, 0.05, 1.2) == pytest.approx(15.0, abs=0.3)
    assert lanes.gap_on_the_way(0.0, 0.0, 0.3, 1.2) == pytest.approx(15.0, abs=0.3)


@pytest.mark.parametrize("beams", [90, 361])
def test_the_scanner_says_where_its_beams_point(beams: int) -> None:
    """A wall 12 m ahead is seen there by scanners of other resolution, mount and range."""
    scanner = ScannerGeometry(beams=beams, field_of_view=np.pi / 2.0, max_range=20.0, mount=2.0)
    scan = np.minimum(12.0 / np.cos(scanner.angles), 20.0)
    lanes = LaneMap.build(scan, estimate(0.0, 0.0, 0.0), scanner)
    assert lanes.gap(0.0, 1.5) == pytest.approx(12.0, abs=1e-6)
    assert lanes.s == pytest.approx(np.full(len(lanes.s), 12.0), abs=1e-6)
