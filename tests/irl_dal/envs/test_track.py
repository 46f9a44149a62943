"""Files become roads, or one line says why not."""

import re
from pathlib import Path

import numpy as np
import pytest

from irl_dal.config import ConfigError, RunConfig, parse, to_mapping
from irl_dal.envs import CityConfig, CityEnv
from irl_dal.envs.road import HALF_WIDTH, HOME_LANE
from irl_dal.envs.track import Track
from irl_dal.envs.track_file import TrackError, TrackFile

HEADER = "# x_m,y_m,w_tr_right_m,w_tr_left_m\n"
ANGLES = np.linspace(0.0, 2.0 * np.pi, 80, endpoint=False)
CIRCLE = [f"{80 * np.cos(a):.3f},{80 * np.sin(a):.3f},8,7.5" for a in ANGLES]


def write(folder: Path, text: str) -> Path:
    path = folder / "road.csv"
    path.write_bytes(text.encode())
    return path


PLAIN = HEADER + "\n".join(CIRCLE)

FORMS = {
    "plain": PLAIN,
    "no heading": "\n".join(CIRCLE),
    "bare heading": PLAIN.removeprefix("# "),
    "semicolons": PLAIN.replace(",", "; "),
    "tabs": PLAIN.replace(",", "\t"),
    "spaces": PLAIN.replace(",", "  "),
    "separator at the end": PLAIN.replace("\n", ",\n"),
    "CRLF": PLAIN.replace("\n", "\r\n"),
    "CR": PLAIN.replace("\n", "\r"),
    "blank lines": HEADER + "\n\n".join(CIRCLE) + "\n\n",
    "byte order mark": "\ufeff" + PLAIN,
    "comments": "# a circle, surveyed 2020\n" + HEADER + "\n# half\n".join(CIRCLE),
    "heading repeated": PLAIN + "\n" + HEADER,
    "first point repeated": "\n".join([PLAIN, CIRCLE[0]]),
    "first point twice more": "\n".join([PLAIN, CIRCLE[0], CIRCLE[0]]),
    "a centimetre past": PLAIN + "\n80.0,0.01,8,7.5",
    "a centimetre short": PLAIN + "\n80.0,-0.01,8,7.5",
    "half a metre past": PLAIN + "\n80.0,0.5,8,7.5",
    "three points again": "\n".join([PLAIN, *CIRCLE[:3]]),
    "three points again, aside": "\n".join([PLAIN, "80.3,0.2,8,7.5", "79.9,6.5,8,7.5"]),
}
"""One circle, written in many ways."""


@pytest.mark.parametrize("text", FORMS.values(), ids=FORMS.keys())
def test_a_circle_is_a_circle(tmp_path: Path, text: str) -> None:
    """However the file is written; the yellow line runs 7 m left of the right-hand edge."""
    track = Track.read(write(tmp_path, text))
    assert track.closed
    assert np.linalg.norm(track.points, axis=1) == pytest.approx(80.0 + 8.0 - HALF_WIDTH, abs=0.3)
    assert track.left_edge == pytest.approx(8.5, abs=0.1)
    assert track.curvature == pytest.approx(1.0 / 81.0, rel=0.06)


def test_widths_keep_their_order_by_name(tmp_path: Path) -> None:
    """Columns are taken by their names, not by their places."""
    swapped = "# w_tr_left_m,x_m,y_m,w_tr_right_m\n"
    rows = [",".join([c.split(",")[3], *c.split(",")[:3]]) for c in CIRCLE]
    one = Track.read(write(tmp_path, HEADER + "\n".join(CIRCLE)))
    two = Track.read(write(tmp_path, swapped + "\n".join(rows)))
    assert np.array_equal(one.points, two.points)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "at least 3 points"),
        (HEADER + "1,2,7,7\n3,4,7,7", "at least 3 points make a road, got 2"),
        ("# x_m,y_m,w_tr_right_m\n1,2,7", "line 1: the column w_tr_left_m is missing"),
        (HEADER + "\n".join([*CIRCLE[:4], "1,2,3"]), "line 6: 4 columns are needed, got 3"),
        (HEADER + "\n".join([*CIRCLE[:4], "nan,2,7,7"]), "line 6: x_m .*'nan'"),
        (HEADER + "\n".join([*CIRCLE[:4], "1,oops,7,7"]), "line 6: y_m .*'oops'"),
        (HEADER + "\n".join([*CIRCLE[:4], "1,2,-7,7"]), "line 6: w_tr_right_m .*-7"),
        (HEADER + "\n".join([*CIRCLE[:4], "1,2,1,1"]), "line 6: the road is 2 m wide"),
        (HEADER + "\n".join([*CIRCLE[:4], CIRCLE[3]]), "line 6: the point .* repeats"),
        (HEADER + "0,0,7,7\n10,0,7,7\n5,8,7,7", "bends with a radius of"),
        (HEADER + "start,0,7,7\n" + "\n".join(CIRCLE), "line 2: x_m .*'start'"),
        ("0,0,wide,7\n" + "\n".join(CIRCLE), "line 1: w_tr_right_m .*'wide'"),
        (HEADER + "\n".join([*CIRCLE[:4], "1;2;7;7;1"]), "line 6: 4 columns are needed, got 5"),
        (HEADER + "\n".join([*CIRCLE[:4], "1;2,5;7;7"]), "line 6: y_m .*'2,5'"),
        (HEADER + "\n".join([*CIRCLE[:4], "1_0,2,7,7"]), "line 6: x_m .*'1_0'"),
        (HEADER + "\n".join([*CIRCLE[:4], "1,2,inf,7"]), "line 6: w_tr_right_m .*'inf'"),
        (HEADER + "\n".join([*CIRCLE[:4], "1,2,,7"]), "line 6: w_tr_right_m .*''"),
        (HEADER + "\n".join([*CIRCLE[:4], "1,2,90,90"]), "line 6: the road is 180 m wide"),
        (HEADER + "\n".join([*CIRCLE[:4], "1e9,2,7,7"]), "line 6: the point is 1e[+]09 m from"),
        ("id,x,y,right,left\n1,2,3,4,5", "line 1: .* x_m, y_m, .* missing, got id, x, y, right"),
        ("# y,x,left,right\n1,2,3,4", "line 1: .* missing, got y, x, left, right"),
        ("# s_m; x_m; y_m; psi_rad\n0;1;2;3", "line 1: .* w_tr_right_m, w_tr_left_m are missing"),
        ("# x_m,y_m,w_tr_right_m,w_tr_left_m,x_m\n", "line 1: the column x_m is named twice"),
        ("# x_m,y_m\n1,2", "line 1: the columns w_tr_right_m, w_tr_left_m are missing"),
        (PLAIN + "\n# y_m,x_m,w_tr_right_m,w_tr_left_m", "line 82: a second heading"),
        ("1,2,7,7,0\n", "line 1: 4 columns are needed, got 5"),
        (HEADER + "1,2,7,7\n" * 30, "line 3: the point .* repeats"),
    ],
)
def test_what_is_no_road_is_refused(tmp_path: Path, text: str, says: str) -> None:
    """One line with the file, the line and the value."""
    path = write(tmp_path, text)
    with pytest.raises(TrackError, match=says) as caught:
        Track.read(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("clockwise", [False, True])
def test_the_right_hand_edge_is_the_road_s(clockwise: bool, tmp_path: Path) -> None:
    """A circle driven clockwise has its right-hand edge inside."""
    rows = CIRCLE[::-1] if clockwise else CIRCLE
    track = Track.read(write(tmp_path, HEADER + "\n".join(rows)))
    radius = 80.0 - 8.0 + HALF_WIDTH if clockwise else 80.0 + 8.0 - HALF_WIDTH
    assert np.linalg.norm(track.points, axis=1) == pytest.approx(radius, abs=0.3)
    assert (np.sign(track.curvature) == (-1.0 if clockwise else 1.0)).all()


def rows_of(points: list[tuple[float, float]]) -> str:
    return HEADER + "\n".join(f"{x:.3f},{y:.3f},5,5" for x, y in points)


def uneven_circuit(first: int) -> list[tuple[float, float]]:
    """Two straights of 220 m, a point every 55 m, and bends with a point every 4 m."""
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 50)
    right = [(220.0 + 63.7 * np.cos(a), 63.7 * np.sin(a)) for a in angle]
    left = [(-63.7 * np.cos(a), -63.7 * np.sin(a)) for a in angle]
    below, above = [[(55.0 * k, y) for k in (1, 2, 3)] for y in (-63.7, 63.7)]
    points = [*below, *right, *above[::-1], *left]
    return points[first:] + points[:first]


@pytest.mark.parametrize("first", [0, 1, 2, 3, 30, 54])
def test_a_circuit_with_few_points_on_its_straights_is_closed(first: int, tmp_path: Path) -> None:
    """Wherever the file begins, the road is the same and closed."""
    track = Track.read(write(tmp_path, rows_of(uneven_circuit(first))))
    assert track.closed and track.length == pytest.approx(833.0, abs=10.0)


@pytest.mark.parametrize(
    "points",
    [
        [(10.0 * k, 0.0) for k in range(40)],
        [(100.0 * np.cos(a), 100.0 * np.sin(a)) for a in np.linspace(0.0, 4.7, 60)],
        uneven_circuit(0)[:56],
        uneven_circuit(3)[:53],
    ],
    ids=["straight", "three quarters of a circle", "half a circuit", "one bend and a straight"],
)
def test_an_open_road_is_not_closed(points: list[tuple[float, float]], tmp_path: Path) -> None:
    """No road is invented where the ends are far apart or do not lead to each other."""
    assert not Track.read(write(tmp_path, rows_of(points))).closed


@pytest.mark.parametrize("count", [2, 20, 60])
def test_the_line_of_a_bend_is_named(count: int, tmp_path: Path) -> None:
    """However many points the straight before a right angle has."""
    straight = [(float(x), 0.0) for x in np.linspace(0.0, 500.0, count)]
    rest = [(500.0 + 5.0 * k, 0.0) for k in range(1, 21)]
    corner = [(600.0, 5.0 * k) for k in range(1, 61)]
    path = write(tmp_path, rows_of([*straight, *rest, *corner]))
    with pytest.raises(TrackError) as caught:
        Track.read(path)
    named = re.search(r"line (\d+)", str(caught.value))
    assert named is not None and abs(int(named[1]) - (count + 21)) <= 1


def test_the_points_of_a_file_are_kept(tmp_path: Path) -> None:
    """What is read is what was written, with the line that each point stands in."""
    file = TrackFile.read(write(tmp_path, "\n" + PLAIN + "\n" + CIRCLE[0]))
    assert file.points[3] == pytest.approx([float(v) for v in CIRCLE[3].split(",")[:2]])
    assert len(file.points) == len(CIRCLE) and file.closed
    assert file.lines == tuple(range(3, 3 + len(CIRCLE)))
    assert (file.widths == (8.0, 7.5)).all()


def test_map_coordinates_are_moved_to_the_origin(tmp_path: Path) -> None:
    """A road in UTM coordinates looks like the same road at the origin: the renderer has floats."""
    images = []
    for offset in (0.0, 5_500_000.0):
        rows = [
            (float(x) + offset, float(y) + offset) for x, y, *_ in (c.split(",") for c in CIRCLE)
        ]
        path = write(tmp_path, rows_of(rows))
        env = CityEnv(CityConfig(track=str(path), route_length=100.0, route_spread=0.0))
        images.append(env.reset(seed=1)[0]["image"].astype(float))
        env.close()
    assert np.abs(images[0] - images[1]).mean() < 1.0


def test_a_missing_file_is_named() -> None:
    """The operating system's reason is in the message."""
    with pytest.raises(TrackError, match=r"nowhere\.csv: No such file"):
        Track.read("nowhere.csv")


def test_configuration_names_the_key(tmp_path: Path) -> None:
    """A bad file is refused where the configuration is read, before anything starts."""
    mapping = to_mapping(RunConfig())
    mapping["env"]["track"] = str(write(tmp_path, HEADER + "1,2,nan,7\n"))
    with pytest.raises(ConfigError, match=r"env\.track: .*line 2: w_tr_right_m.*'nan'"):
        parse(mapping)


def test_triangle_and_figure_of_eight_are_roads(tmp_path: Path) -> None:
    """Three points make a round course; where a road crosses itself it is a bridge."""
    triangle = Track.read(write(tmp_path, HEADER + "0,0,7,7\n400,0,7,7\n200,300,7,7"))
    assert triangle.closed and triangle.length > 1000.0
    eight = [f"{200 * np.sin(a):.3f},{100 * np.sin(2 * a):.3f},7,7" for a in ANGLES]
    track = Track.read(write(tmp_path, HEADER + "\n".join(eight)))
    road = track.stretch(0, 600.0)
    for s in np.arange(0.0, 600.0, 0.7):
        x, y, _ = road.pose(float(s), HOME_LANE)
        hint = int((s + 25.0) / 0.5)
        assert road.locate(x, y, hint).s == pytest.approx(s, abs=0.3)


def test_stretches_follow_each_other(tmp_path: Path) -> None:
    """The goal of one stretch is the start of the next, all around a closed course."""
    track = Track.read(write(tmp_path, HEADER + "\n".join(CIRCLE)))
    count = track.stretches(100.0)
    assert count == 5
    for number in range(count):
        goal = track.stretch(number, 100.0).pose(100.0, 0.0)
        start = track.stretch(number + 1, 100.0).pose(0.0, 0.0)
        if number + 1 < count:
            assert goal[:2] == pytest.approx(start[:2], abs=0.1)
    road = track.stretch(count - 1, 100.0)
    assert np.abs(np.diff(road.heading)).max() < 0.02


def test_a_short_open_road_says_so(tmp_path: Path) -> None:
    """A straight of 200 m has no room for 300 m and what lies before and after them."""
    straight = "\n".join(f"{10 * k},0,7,7" for k in range(21))
    with pytest.raises(TrackError, match="too short"):
        Track.read(write(tmp_path, HEADER + straight)).stretch(0, 300.0)


def test_the_city_drives_on_it(tmp_path: Path) -> None:
    """The option chooses the stretch; the episode ends where it should."""
    path = write(tmp_path, HEADER + "\n".join(CIRCLE))
    env = CityEnv(CityConfig(track=str(path), route_length=120.0, route_spread=0.0))
    env.reset(seed=1, options={"stretch": 2})
    assert env.scene().road.length == 120.0
    assert env.scene().road.pose(0.0, 0.0)[:2] == pytest.approx(
        Track.read(path).stretch(2, 120.0).pose(0.0, 0.0)[:2]
    )
    env.close()
