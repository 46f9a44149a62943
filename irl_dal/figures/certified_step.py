"""One step of the predictive shield: what is certified, and why the nominal was refused."""

import re
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon

from irl_dal.figures.style import PALETTE, Array, drawing
from shield import Certificate, Corridor, KinematicBicycle, PredictiveFilter
from shield.predictive.backups import Motions

AHEAD, BEHIND, ASIDE = 24.0, 5.0, 10.0  # what the picture shows around the rear axle [m]
VIEW, MARGIN, PAGE = 4.6, 2.3, 5.6  # width of a view, height around it, least width [in]
TITLE_WIDTH = 50  # [characters] of the reason's lines
ROAD_STEP = 0.5  # between two points of a corridor's edge [m]
NAMES = ("wall or hedge", "vehicle", "person or post", "last seen there")  # kinds of obstacles
KINDS = ("obstacle", "ego", "barrel", "muted")  # their colours
COMMITTED, REFUSED, NOW = (PALETTE[name] for name in ("lidar", "violation", "trail"))
REACH = "#f6d9c7"  # the colour of people, pale: where many may be it does not get darker


def certified_step(shield: PredictiveFilter, certificate: Certificate) -> Figure:
    """The step that the shield has just filtered, the car's heading up.

    To the left what was committed, to the right what was asked for, if that is another motion.
    """
    nominal, safe = certificate.nominal_action, certificate.safe_action
    what = "committed" if shield.motion is not None else "committed before, goes on"
    first = f"{what}: {safe[0]:+.3f} rad, {safe[1]:.2f} m/s, then to rest"
    asked = f"refused: {nominal[0]:+.3f} rad, {nominal[1]:.2f} m/s\n"
    own = _committed(shield, certificate)
    views = [(first, own, COMMITTED, len(own) - 1)]
    if shield.refused is not None and certificate.intervened:
        title, poses = asked + fill(certificate.reason, TITLE_WIDTH), _poses(shield.refused)
        when = re.search(r"in ([\d.]+) s", certificate.reason)
        fails = len(poses) if when is None else round(float(when[1]) / shield.limits.dt)
        views.append((title, poses, REFUSED, fails - 1))
    height = VIEW * (AHEAD + BEHIND) / (2.0 * ASIDE) + MARGIN
    with drawing(max(len(views) * VIEW + 0.6, PAGE), height) as figure:
        axes = figure.subplots(1, len(views), sharey=True, squeeze=False)[0]
        for view, (title, poses, colour, at) in zip(axes, views, strict=True):
            _surroundings(view, shield)
            _motion(view, shield, poses, colour, at)
            if colour == REFUSED or shield.motion is not None:
                _reach(view, shield, at)
            view.set(xlim=(-ASIDE, ASIDE), ylim=(-BEHIND, AHEAD), aspect="equal")
            view.set(xlabel="to the right [m]")
            view.set_title(title, fontsize=9.5, pad=8.0)
            view.grid(visible=False)
        axes[0].set_ylabel("ahead of the rear axle [m]")
        handles = _legend(shield, refused=len(views) > 1)
        figure.legend(handles=handles, loc="outside lower center", ncols=1 + len(views))
    return figure


def _committed(shield: PredictiveFilter, certificate: Certificate) -> Array:
    """Poses (n, 3) of the committed motion; one that was certified before goes on from here."""
    if shield.motion is not None:
        return _poses(shield.motion)
    bicycle = KinematicBicycle(shield.limits.wheelbase, shield.limits.dt)
    commands = np.concatenate([certificate.safe_action[None], shield.committed])
    return bicycle.rollout(np.zeros(3), commands)[1:]


def _poses(motion: Motions) -> Array:
    """At the ends of the periods (n, 3) until the car stands [m], [m], [rad]."""
    moving = int((np.abs(motion.commands[0, :, 1]) > 0.0).sum()) + 1
    return np.stack([motion.x[0], motion.y[0], motion.yaw[0]], axis=1)[:moving]


def _surroundings(view: Axes, shield: PredictiveFilter) -> None:
    world = shield.world
    view.set_facecolor(PALETTE["ground"])
    if world.corridor is not None:
        right, left = (
            _edge(world.corridor, d) for d in (world.corridor.right, world.corridor.left)
        )
        view.fill(*np.concatenate([right, left[::-1]]).T, color=PALETTE["edge"], zorder=0.5)
        for edge in (right, left):
            view.plot(*edge.T, color=PALETTE["muted"], linewidth=0.8)
    known = world.obstacles
    for kind, colour in enumerate(KINDS):
        for fresh in (True, False):
            x, y = known.points[(known.kind == kind) & ((known.age == 0.0) == fresh)].T
            face = PALETTE[colour] if fresh else "none"
            view.plot(-y, x, "o", color=PALETTE[colour], markerfacecolor=face, markersize=3.5)
    if len(world.frontier):
        x, y = world.frontier.T
        view.plot(-y, x, "x", color=PALETTE["muted"], markersize=4.0)


def _motion(view: Axes, shield: PredictiveFilter, poses: Array, colour: str, at: int) -> None:
    """The body now and at each period up to rest, the one of a period in bold."""
    _bodies(view, shield, poses, facecolor=colour, alpha=0.08)
    _bodies(view, shield, poses, facecolor="none", edgecolor=colour, linewidth=0.5)
    _bodies(view, shield, np.zeros((1, 3)), facecolor=NOW, zorder=3)
    bold: dict[str, Any] = {"facecolor": "none", "edgecolor": colour, "linewidth": 2.0, "zorder": 4}
    _bodies(view, shield, poses[at : at + 1], **bold)


def _reach(view: Axes, shield: PredictiveFilter, at: int) -> None:
    """Where others may be at the end of a period."""
    checks = shield.checks
    if checks is None or not len(checks.threats.points):
        return
    time = np.array([shield.limits.dt * (at + 1)])
    (x,), (y,) = checks.threats.centres(time)
    (radius,) = checks.threats.radius(time)
    discs = [Circle((-b, a), max(r, 0.1)) for a, b, r in zip(x, y, radius, strict=True)]
    view.add_collection(PatchCollection(discs, facecolor=REACH, edgecolor="none", zorder=0.8))


def _bodies(view: Axes, shield: PredictiveFilter, poses: Array, **look: Any) -> None:
    geometry = shield.geometry
    along = np.array([-geometry.rear_overhang, geometry.front_bumper])[[0, 1, 1, 0]]
    aside = 0.5 * geometry.width * np.array([1.0, 1.0, -1.0, -1.0])
    outlines = []
    for x, y, yaw in poses:
        ahead = x + np.cos(yaw) * along - np.sin(yaw) * aside
        left = y + np.sin(yaw) * along + np.cos(yaw) * aside
        outlines.append(Polygon(np.stack([-left, ahead], axis=1)))
    view.add_collection(PatchCollection(outlines, **look))


def _legend(shield: PredictiveFilter, *, refused: bool) -> list[Artist]:
    """What the colours mean."""
    known = shield.world.obstacles
    handles: list[Artist] = [Patch(color=NOW, label="the car now")]
    ways = [(COMMITTED, "committed; bold: at rest")]
    if refused:
        ways.append((REFUSED, "refused; bold: where it fails"))
    handles += [Patch(facecolor=(c, 0.15), edgecolor=c, label=name) for c, name in ways]
    dots = [
        (PALETTE[colour], NAMES[kind], "o", (known.kind == kind).any())
        for kind, colour in enumerate(KINDS)
    ]
    dots.append((PALETTE["muted"], "unknown beyond", "x", len(shield.world.frontier)))
    dots.append(("none", "hollow: remembered", "o", (known.age > 0.0).any()))
    handles += [
        Line2D([], [], color=c if c != "none" else "k", markerfacecolor=c, marker=marker,
               linestyle="", markersize=4.0, label=name)
        for c, name, marker, there in dots if there
    ]  # fmt: skip
    handles.append(Patch(facecolor=REACH, label="where others may be by then"))
    if shield.world.corridor is not None:
        handles.append(Patch(facecolor="w", edgecolor=PALETTE["muted"], label="own lanes"))
    return handles


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
