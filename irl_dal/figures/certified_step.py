"""One step of the predictive shield: what is certified, and why the nominal was refused."""

from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from irl_dal.figures.style import PALETTE, Array, drawing
from shield import Certificate, Corridor, PredictiveFilter
from shield.predictive.backups import Motions

AHEAD, BEHIND, ASIDE = 26.0, 6.0, 11.0  # what the picture shows around the rear axle [m]
TITLE_WIDTH = 56  # [characters] of the reason's lines
ROAD_STEP = 0.5  # between two points of a corridor's edge [m]
KINDS = ("obstacle", "car", "barrel")  # colour of `Kind.STRUCTURE`, `VEHICLE` and `PERSON`


def certified_step(shield: PredictiveFilter, certificate: Certificate) -> Figure:
    """Two views of the step that the shield has just filtered, the car's heading up."""
    nominal, safe = certificate.nominal_action, certificate.safe_action
    reason = fill(certificate.reason or "certified", TITLE_WIDTH)
    titles = (
        f"committed: {safe[0]:+.3f} rad, {safe[1]:.2f} m/s, then to rest",
        f"asked for: {nominal[0]:+.3f} rad, {nominal[1]:.2f} m/s\n{reason}",
    )
    with drawing(10.0, 7.4) as figure:
        axes = figure.subplots(1, 2, sharey=True)
        for view, title, motion, colour in zip(
            axes, titles, (shield.motion, shield.refused), ("plan", "violation"), strict=True
        ):
            _surroundings(view, shield)
            if motion is not None:
                _motion(view, shield, motion, colour)
            view.set(xlim=(-ASIDE, ASIDE), ylim=(-BEHIND, AHEAD), aspect="equal")
            view.set(title=title, xlabel="to the right [m]")
            view.grid(visible=False)
        axes[0].set_ylabel("ahead [m]")
    return figure


def _surroundings(view: Axes, shield: PredictiveFilter) -> None:
    world = shield.world
    view.set_facecolor(PALETTE["ground"])
    if world.corridor is not None:
        right, left = (
            _edge(world.corridor, d) for d in (world.corridor.right, world.corridor.left)
        )
        view.fill(*np.concatenate([right, left[::-1]]).T, color=PALETTE["road"])
    known = world.obstacles
    for kind, colour in enumerate(KINDS):
        rows = known.kind == kind
        fresh = rows & (known.age == 0.0)
        for shown, alpha in ((fresh, 1.0), (rows & ~fresh, 0.4)):
            x, y = known.points[shown].T
            view.plot(-y, x, ".", color=PALETTE[colour], markersize=5.0, alpha=alpha)
    if len(world.frontier):
        x, y = world.frontier.T
        view.plot(-y, x, "x", color=PALETTE["muted"], markersize=3.0)
    _bodies(view, shield, np.zeros((1, 3)), "trail", 0.9)


def _motion(view: Axes, shield: PredictiveFilter, motion: Motions, colour: str) -> None:
    """The body at each period up to rest, and where others may be when it comes to rest."""
    moving = int((np.abs(motion.commands[0, :, 1]) > 0.0).sum()) + 1
    poses = np.stack([motion.x[0], motion.y[0], motion.yaw[0]], axis=1)[:moving]
    _bodies(view, shield, poses, colour, 0.16)
    checks = shield.checks
    if checks is None or not len(checks.threats.points):
        return
    time = np.array([shield.limits.dt * moving])
    (x,), (y,) = checks.threats.centres(time)
    (radius,) = checks.threats.radius(time)
    discs = [Circle((-b, a), max(r, 0.05)) for a, b, r in zip(x, y, radius, strict=True)]
    view.add_collection(PatchCollection(discs, color=PALETTE["barrel"], alpha=0.12))


def _bodies(view: Axes, shield: PredictiveFilter, poses: Array, colour: str, alpha: float) -> None:
    geometry = shield.geometry
    along = np.array([-geometry.rear_overhang, geometry.front_bumper])[[0, 1, 1, 0]]
    aside = 0.5 * geometry.width * np.array([1.0, 1.0, -1.0, -1.0])
    outlines = []
    for x, y, yaw in poses:
        ahead = x + np.cos(yaw) * along - np.sin(yaw) * aside
        left = y + np.sin(yaw) * along + np.cos(yaw) * aside
        outlines.append(Polygon(np.stack([-left, ahead], axis=1)))
    view.add_collection(
        PatchCollection(outlines, facecolor=PALETTE[colour], edgecolor=PALETTE[colour], alpha=alpha)
    )


def _edge(road: Corridor, offset: float) -> Array:
    """Points (n, 2) of the line at an offset of the corridor [m], to the right and ahead."""
    along = np.arange(-BEHIND - ASIDE, AHEAD + ASIDE, ROAD_STEP)
    ways = road.direction(along)
    steps = ROAD_STEP * 0.5 * (ways[1:] + ways[:-1])
    centre = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    start = int(round((BEHIND + ASIDE) / ROAD_STEP))
    centre -= centre[start]
    normal = np.stack([-ways[:, 1], ways[:, 0]], axis=1)
    points = centre + (offset - road.lane[0]) * normal
    return np.stack([-points[:, 1], points[:, 0]], axis=1)
