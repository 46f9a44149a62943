"""The picture of a step of the predictive shield."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from irl_dal.figures.certified_step import certified_step
from irl_dal.figures.style import picture
from shield import Certificate, PredictiveFilter
from tests.shield.predictive.bodies import Chase, Thing
from tests.shield.predictive.filters import shared_filter
from tests.shield.predictive.kinematic_world import KinematicWorld

Until = Callable[[PredictiveFilter, Certificate], bool]


def step(
    world: KinematicWorld, wish: tuple[float, float], until: Until, steps: int = 60
) -> tuple[PredictiveFilter, Certificate]:
    """The filter and its certificate of the first step that is looked for."""
    shield = shared_filter()
    shield.reset([0.0, world.speed])
    for number in range(steps):
        shield.update(world.scan(), world.speed, world.yaw_rate, world.lane())
        certificate = shield.filter(wish)
        if until(shield, certificate):
            return shield, certificate
        world.advance(certificate.safe_action, number)
    raise AssertionError("there is none")


def labels(figure: Figure) -> list[str]:
    """Of the legend."""
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_a_certified_step_is_one_view(tmp_path: Path) -> None:
    """Nothing was refused; the picture has a size for a page."""
    world = KinematicWorld([Thing(15.0, 5.0, 0.6)], speed=6.0)
    figure = certified_step(*step(world, (0.0, 6.0), lambda _, step: not step.intervened))
    (view,) = figure.axes
    assert view.get_title(loc="left").startswith("committed: +0.000 rad, 6.00 m/s")
    assert {"person or post", "own lanes"} <= set(labels(figure))
    assert not any("refused" in label for label in labels(figure))
    picture(figure, str(tmp_path / "step.png"))
    with Image.open(tmp_path / "step.png") as image:
        assert image.width < image.height < 1200


def test_a_refusal_stands_beside_what_was_committed() -> None:
    """With the reason in its title."""
    refuses: Until = lambda _, step: "would pass" in step.reason  # noqa: E731
    world = KinematicWorld([Thing(30.0, 2.7, 1.0, 56.0)], speed=6.0)
    shield, certificate = step(world, (0.1, 8.0), refuses)
    figure = certified_step(shield, certificate)
    left, right = figure.axes
    assert left.get_title(loc="left").startswith("committed")
    title = right.get_title(loc="left").replace("\n", " ")
    assert title.startswith("refused: +0.100 rad, 8.00 m/s") and certificate.reason in title
    assert any("refused" in label for label in labels(figure))


def test_a_commitment_that_goes_on_is_drawn_from_here() -> None:
    """Its roll-out is an earlier one: it is driven by its commands."""
    goes_on: Until = lambda shield, step: shield.motion is None and step.safe_action[1] > 1.0  # noqa: E731
    world = KinematicWorld([Thing(18.0, 6.0, 0.5, motion=Chase())], speed=7.0)
    shield, certificate = step(world, (0.05, 10.0), goes_on)
    figure = certified_step(shield, certificate)
    assert figure.axes[0].get_title(loc="left").startswith("committed before, goes on")
    bold = figure.axes[0].collections[-1].get_paths()[0].vertices
    assert np.isfinite(bold).all() and bold[:, 1].max() > shield.geometry.front_bumper
