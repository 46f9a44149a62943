"""Files become roads, or one line says why not."""

from pathlib import Path

import numpy as np
import pytest

from irl_dal.config import ConfigError, RunConfig, parse, to_mapping
from irl_dal.envs import CityConfig, CityEnv
from irl_dal.envs.road import HALF_WIDTH, HOME_LANE
from irl_dal.envs.track import Track, TrackError

HEADER = "# x_m,y_m,w_tr_right_m,w_tr_left_m\n"
ANGLES = np.linspace(0.0, 2.0 * np.pi, 80, endpoint=False)
CIRCLE = [f"{80 * np.cos(a):.3f},{80 * np.sin(a):.3f},8,7.5" for a in ANGLES]


def write(folder: Path, text: str) -> Path:
    path = folder / "road.csv"
    path.write_bytes(text.encode())
    return path


@pytest.mark.parametrize(
    "text",
    [
        HEADER + "\n".join(CIRCLE),
        "\n".join(CIRCLE),
        (HEADER + "\n".join(CIRCLE)).replace("\n", "\r\n"),
        HEADER + "\n\n".join(CIRCLE) + "\n\n",
        "\ufeff" + HEADER + "\n".join([*CIRCLE, CIRCLE[0]]),
    ],
    ids=["plain", "no header", "CRLF", "blank lines", "first point repeated"],
)
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
    ],
)
def test_what_is_no_road_is_refused(tmp_path: Path, text: str, says: str) -> None:
    """One line with the file, the line and the value."""
    path = write(tmp_path, text)
    with pytest.raises(TrackError, match=says) as caught:
        Track.read(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


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
