import math
from dataclasses import replace

import numpy as np
import pytest

from irl_dal.planner import PlanningContext
from irl_dal.planner import context as places
from irl_dal.planner.context import hazard
from shield import ClearanceEstimate, ScannerGeometry
from tests.irl_dal.planner.scenes import context, lane, open_road, scan_of


def test_code_has_the_paper_s_size_and_padding() -> None:
    """The code has 64 finite entries of moderate size, the unused ones zero."""
    code = context().encode()
    assert code.shape == (64,) and code.dtype == np.float32
    assert bool(np.isfinite(code).all()) and float(np.abs(code).max()) <= 3.0
    assert not code[places.NEAREST_BEARING + 1 :].any()
    assert int(np.count_nonzero(code)) > 40


def test_entries_are_where_and_what_they_should_be() -> None:
    """Each entry is the named quantity over its scale."""
    scene = replace(
        context(bearing=0.2, distance=8.0, speed=6.0),
        clearance=ClearanceEstimate(8.0, 3.0, 0.5, 0.0, True),
        lane=lane(lateral_offset=3.0, heading_error=0.1),
        previous=np.array([-0.25, 9.0]),
    )
    code = scene.encode()
    expected = {
        places.HAZARD: 1.0 - math.tanh(8.0 / 3.0),
        places.CLEARANCE: 0.2,
        places.CLOSING_SPEED: 0.25,
        places.CLEARANCE_STD: 0.5,
        places.CLEARANCE_VALID: 1.0,
        places.LATERAL_OFFSET: 3.0 / 3.5,
        places.HEADING_ERROR: 0.1 / 0.3,
        places.LANE_DEVIATION: -0.5 / 1.75,
        places.LANE_VALID: 1.0,
        places.SPEED: 0.5,
        places.PREVIOUS_STEERING: -0.5,
        places.PREVIOUS_SPEED: 0.75,
    }
    for place, value in expected.items():
        assert float(code[place]) == pytest.approx(value, rel=1e-5), place
    assert float(code[places.NEAREST_BEARING]) == pytest.approx(0.2 / (0.5 * math.pi), abs=0.01)


def test_sectors_keep_the_nearest_return() -> None:
    """An object raises its own sector, six beams wide, and no other."""
    code = open_road(scan=scan_of(math.radians(45.0), 5.0, width=0.3)).encode()
    sectors = code[places.SECTOR_START : places.SECTOR_START + places.SECTORS]
    hit = int(np.argmax(sectors))
    assert hit in (21, 22, 23)  # 45 degrees to the left, of 30 sectors from the right
    assert float(sectors[hit]) == pytest.approx(0.5, abs=0.01)
    assert float(np.delete(sectors, range(hit - 1, hit + 2)).max()) == pytest.approx(5.0 / 45.0)


def test_lane_deviation_wraps_to_the_nearest_centre() -> None:
    """Between the lanes the deviation changes its sign; in the passing lane it is small."""
    deviations = [
        replace(context(), lane=lane(lateral_offset=offset)).lane_deviation
        for offset in (0.4, 1.7, 1.8, 3.4, 4.0)
    ]
    np.testing.assert_allclose(deviations, [0.4, 1.7, -1.7, -0.1, 0.5])


def test_invalid_estimates_read_as_zero() -> None:
    """A lost lane and a dead tracker give zeros and a low flag, whatever they contain."""
    lost = replace(
        context(),
        lane=lane(valid=False, lateral_offset=math.nan, age=math.inf),
        clearance=ClearanceEstimate(math.nan, math.nan, math.inf, math.inf, False),
    )
    assert lost.finite
    code = lost.encode()
    assert bool(np.isfinite(code).all())
    for place in (places.LATERAL_OFFSET, places.LANE_VALID, places.CLEARANCE_VALID):
        assert code[place] == 0.0
    assert float(code[places.CLEARANCE]) == pytest.approx(lost.scan.min() / 40.0)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("part", ["scan", "speed", "previous", "lane", "clearance", "reference"])
def test_finite_notices_everything(part: str, bad: float) -> None:
    """A value that is no number is noticed wherever it is used."""
    scene = context()
    scan = scene.scan.copy()
    scan[17] = bad
    changed = {
        "scan": {"scan": scan},
        "speed": {"speed": bad},
        "previous": {"previous": np.array([bad, 1.0])},
        "lane": {"lane": lane(curvature=bad)},
        "clearance": {"clearance": replace(scene.clearance, closing_speed=bad)},
        "reference": {"expert_reference": np.full((8, 2), bad)},
    }[part]
    assert scene.finite
    assert not replace(scene, **changed).finite  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("scan", np.zeros(7)),
        ("scan", np.zeros((2, 90))),
        ("scanner", ScannerGeometry(beams=90)),
        ("previous", np.zeros(3)),
        ("expert_reference", np.zeros(8)),
        ("lane_centres", ()),
    ],
)
def test_wrong_shapes_are_refused(name: str, value: object) -> None:
    """A context of the wrong size is refused by name."""
    with pytest.raises(ValueError, match="must have shape .* Got|must name"):
        replace(context(), **{name: value})  # type: ignore[arg-type]


def test_context_keeps_its_own_arrays() -> None:
    """Changing the caller's scan later does not change the context, which is read-only."""
    scan = np.full(180, 40.0)
    plain = context()
    scene = PlanningContext(scan, plain.clearance, plain.lane, 5.0, np.zeros(2))
    scan[:] = 0.0
    assert float(scene.scan.min()) == 40.0
    with pytest.raises(ValueError, match="read-only"):
        scene.scan[0] = 1.0


def test_hazard_level() -> None:
    """h_t is 1 at contact, falls with distance and never leaves [0, 1]."""
    assert hazard(0.0) == 1.0
    assert hazard(3.0) == pytest.approx(1.0 - math.tanh(1.0))
    assert hazard(-5.0) == 1.0
    assert 0.0 <= hazard(1e9) < 1e-12


@pytest.mark.parametrize("beams", [8, 29, 30, 90, 181, 720])
def test_any_scanner_gives_the_same_picture(beams: int) -> None:
    """A car ahead is in the middle sectors, and nothing elsewhere, whatever the number of beams."""
    angles = ScannerGeometry(beams=beams).angles
    scan = np.where(np.abs(angles) < 0.25, 6.0, 40.0)
    scene = open_road(scan=scan)
    code = scene.encode()
    sectors = code[places.SECTOR_START : places.SECTOR_START + places.SECTORS]
    assert float(sectors[14:16].max()) == pytest.approx(5.0 / 11.0)
    assert float(sectors[[0, 5, 24, 29]].max()) == pytest.approx(5.0 / 45.0)
    assert abs(float(code[places.NEAREST_BEARING])) < 0.2
    assert float(code[places.SCAN_RETURNS]) == pytest.approx(float((scan < 40.0).mean()))


def test_the_range_of_the_scanner_is_its_own() -> None:
    """An empty scan of a 20 m scanner reads like one of a 40 m scanner: no return."""
    short = open_road(scan=np.full(180, 20.0), scanner=ScannerGeometry(max_range=20.0))
    code = short.encode()
    assert code[places.SCAN_RETURNS] == 0.0
    assert float(code[places.SCAN_MEAN]) == pytest.approx(1.0)
