from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest

from irl_dal.evaluation.rig import AgentSpec, Rig
from irl_dal.evaluation.rollout import drive_episode
from irl_dal.figures.panels import film_writer
from irl_dal.figures.video import SIZE, DriveFilm
from tests.irl_dal.evaluation.small import small_config


def test_the_film_shows_the_drive(tmp_path: Path) -> None:
    """One frame per control step up to the wanted duration, of full size, and they differ."""
    path = tmp_path / "drive.mp4"
    rig = Rig.build(small_config(), AgentSpec("expert"), render_mode="rgb_array")
    try:
        with film_writer(path, 10.0) as writer:
            film = DriveFilm(writer, rig.loop, duration=0.5)
            drive_episode(rig.loop, rig.agent, 1, film.watch)
    finally:
        rig.close()
    frames = imageio.imread(path, index=None)
    assert frames.shape[0] == 6 and frames.shape[1:3] == SIZE[::-1]
    assert np.abs(frames[0].astype(float) - frames[-1]).max() > 50.0
    assert list(tmp_path.iterdir()) == [path]


def test_an_interrupted_film_leaves_nothing(tmp_path: Path) -> None:
    """No half film under any name."""
    rig = Rig.build(small_config(), AgentSpec("expert"))
    try:
        with (
            pytest.raises(RuntimeError, match="stop"),
            film_writer(tmp_path / "drive.mp4", 10.0) as writer,
        ):
            film = DriveFilm(writer, rig.loop, duration=0.5)
            observation, info = rig.loop.reset(seed=1)
            film.watch(observation, info)
            raise RuntimeError("stop")
    finally:
        rig.close()
    assert list(tmp_path.iterdir()) == []
