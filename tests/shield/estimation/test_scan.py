"""What counts as an obstacle in a scan, and what as a defect."""

from typing import Any

import numpy as np
import pytest

from shield import InvalidLimits, InvalidProblem, ScannerGeometry
from shield.estimation.scan import ScanFilter

FREE = np.full(180, 40.0)


def with_beams(values: dict[int, float], base: np.ndarray = FREE) -> np.ndarray:
    """Return a scan with some beams set."""
    scan = base.copy()
    for index, value in values.items():
        scan[index] = value
    return scan


def test_a_cluster_is_an_obstacle_and_a_lone_beam_is_not() -> None:
    """Three neighbours that agree are believed at once; one or two are not."""
    scans = ScanFilter(40.0)
    assert scans.examine(FREE).nearest == 40.0
    assert scans.examine(with_beams({90: 2.0})).nearest == 40.0
    assert scans.examine(with_beams({90: 2.0, 91: 2.1})).nearest == 40.0
    assert scans.examine(with_beams({90: 2.0, 91: 2.1, 92: 2.2})).nearest == 2.2
    assert scans.examine(with_beams({90: 2.0, 92: 2.1, 94: 2.2})).nearest == 2.2


def test_a_gap_in_a_cluster_does_not_hide_it() -> None:
    """Two of five neighbours may give nothing, whatever nothing looks like."""
    for nothing in (np.nan, 0.0, -1.0, 40.0, np.inf):
        scan = with_beams({88: 3.0, 89: nothing, 90: 3.0, 91: nothing, 92: 3.0})
        assert ScanFilter(40.0).examine(scan).nearest == 3.0


def test_a_scan_with_too_few_working_beams_is_missing() -> None:
    """A dead sensor gives no clearance at all, rather than a large one."""
    scans = ScanFilter(40.0)
    assert scans.examine(np.full(180, np.nan)).nearest is None
    assert scans.examine(np.zeros(180)).nearest is None
    half = FREE.copy()
    half[:91] = np.nan
    assert scans.examine(half).nearest is None


def test_lone_stuck_beams_are_ignored_but_never_a_cluster() -> None:
    """A beam stuck beside an ordinary pair is no cluster; stuck neighbours may be an obstacle."""
    rng = np.random.default_rng(0)
    lone, cluster = ScanFilter(40.0), ScanFilter(40.0)
    for step in range(12):
        moving = 20.0 + rng.normal(0.0, 0.05, 180)
        pair = {91: 5.0 + rng.normal(0.0, 0.05), 92: 5.0 + rng.normal(0.0, 0.05)}
        first = lone.examine(with_beams({90: 1.0, **pair}, moving)).nearest
        second = cluster.examine(with_beams({90: 1.0, 91: 1.0, 92: 1.0}, moving)).nearest
        assert first is not None
        assert (first > 15.0) == (step >= 5), "until then it supports the pair"
        assert second == 1.0


def test_a_still_scene_is_not_a_stuck_sensor() -> None:
    """Without noise and without motion everything repeats, and nothing may be ignored."""
    scans = ScanFilter(40.0)
    scene = with_beams({89: 2.0, 90: 2.0, 91: 2.0}, np.full(180, 15.0))
    for _ in range(20):
        assert scans.examine(scene).nearest == 2.0
        assert scans.examine(scene, speed=0.0).nearest == 2.0


def test_a_scan_that_repeats_while_driving_is_dead() -> None:
    """The last scan sent over and over again; it comes back to life with the first new one."""
    scans = ScanFilter(40.0)
    scene = np.linspace(5.0, 20.0, 180)
    answers = [scans.examine(scene, speed=5.0).nearest for _ in range(8)]
    assert answers[:5] == [pytest.approx(5.0, abs=0.3)] * 5
    assert answers[5:] == [None] * 3
    assert scans.examine(scene + 0.01, speed=5.0).nearest is not None
    scans.reset()
    assert scans.examine(scene, speed=5.0).nearest is not None


def test_scans_of_other_lengths_start_afresh_and_short_ones_work() -> None:
    """A sensor may be replaced; a scan shorter than the window is one window."""
    scans = ScanFilter(40.0)
    assert scans.examine(np.full(3, 7.0)).nearest == 7.0
    assert scans.examine(np.full(1, 6.0)).nearest == 6.0
    assert scans.examine(np.full(180, 5.0)).nearest == 5.0


@pytest.mark.parametrize("scan", [np.zeros((2, 3)), np.zeros(0), 1.0])
def test_wrong_shapes_raise(scan: Any) -> None:
    """Naming the argument and the shape."""
    with pytest.raises(InvalidProblem, match="`scan`"):
        ScanFilter(40.0).examine(scan)


def test_beams_spread_evenly_from_the_right_to_the_left() -> None:
    """Whatever their number and the field of view."""
    scanner = ScannerGeometry(beams=5, field_of_view=2.0, max_range=30.0)
    assert scanner.angles == pytest.approx([-1.0, -0.5, 0.0, 0.5, 1.0])
    scan = np.array([1.0, 29.6, np.inf, np.nan, 0.0])
    assert scanner.returned(scan).tolist() == [True, False, False, False, False]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("beams", 1),
        ("beams", 2.5),
        ("beams", True),
        ("field_of_view", 0.0),
        ("field_of_view", 7.0),
        ("max_range", np.nan),
        ("mount", "front"),
    ],
)
def test_an_impossible_scanner_is_refused(field: str, value: Any) -> None:
    """Naming the field and the value."""
    with pytest.raises(InvalidLimits, match=f"`{field}`.*Got"):
        ScannerGeometry(**{field: value})


def test_a_beam_that_repeats_while_the_car_drives_is_marked_at_once() -> None:
    """And stays marked at standstill until it changes; a standing car's beams never are."""
    scans, rng = ScanFilter(40.0), np.random.default_rng(0)
    first = 20.0 + rng.normal(0.0, 0.1, 180)
    second = first + rng.normal(0.0, 0.1, 180)
    second[90:95] = first[90:95]
    marks = []
    for scan, speed in ((first, 5.0), (second, 5.0), (second, 0.0), (second + 0.1, 0.0)):
        marks.append(int(scans.examine(scan, speed).repeated.sum()))
    assert marks == [0, 5, 5, 0]
    scans.reset()
    assert not any(scans.examine(first, 0.0).repeated.any() for _ in range(9))


def test_a_frozen_scan_is_noticed_though_the_car_brakes_to_a_stop() -> None:
    """Two scans of driving are enough to begin the count."""
    scans, scene = ScanFilter(40.0), np.linspace(5.0, 20.0, 180)
    frozen = [scans.examine(scene, speed).frozen for speed in (1.2, 0.6, 0.0, 0.0, 0.0, 0.0, 0.0)]
    assert frozen == [False] * 5 + [True] * 2
