"""Each check is needed: with it a staged scene ends well, without it in a fault of the car."""

from dataclasses import replace

import numpy as np
import pytest

from shield import Assumptions, PredictiveFilter, World
from shield.predictive import certification
from shield.predictive.certification import Certification
from shield.predictive.threats import Threats
from tests.shield.predictive.bodies import Array, Road, Roll, Thing, Walk
from tests.shield.predictive.kinematic_world import (
    Driver,
    KinematicWorld,
    Record,
    constant,
    drive,
)

Patch = pytest.MonkeyPatch


def run(
    world: KinematicWorld,
    driver: Driver,
    assumptions: Assumptions,
    steps: int = 100,
    bias: float = 0.0,
) -> Record:
    """Drive a staged scene; `bias` [m] is added to every range."""
    shield = PredictiveFilter(
        world.limits, world.geometry, world.scanner, assumptions,
        lanes=world.road and world.road.lanes, deadline=1e6,
    )  # fmt: skip
    return drive(world, shield, driver, steps, lambda scan, step: scan + bias)


def no_memory(patch: Patch) -> None:
    """Nothing outlives its scan."""
    patch.setattr(World, "_keep", lambda self, known, *_: known.where(known.age < 0.0))


def no_unknown(patch: Patch) -> None:
    """Directions without a working beam are free."""

    def shrink(self: World, unseen: Array) -> None:
        self.frontier = np.zeros((0, 2))

    patch.setattr(World, "_shrink", shrink)


def no_corridor(patch: Patch) -> None:
    """Nothing is outside."""
    patch.setattr(Certification, "_outside", lambda self, offset, *_: np.full_like(offset, -1.0))


def no_growth(patch: Patch) -> None:
    """Discs do not grow."""
    patch.setattr(Threats, "radius", lambda self, t: np.zeros((len(t), len(self.points))))


def no_future(patch: Patch) -> None:
    """Vehicles stand for ever."""
    patch.setattr(
        Threats,
        "_rolling",
        lambda world, *_: Threats._at(world.obstacles, [(np.zeros(0, int), *[0.0] * 5)]),
    )


def no_backup(patch: Patch) -> None:
    """Only the first period of a motion is checked."""
    check = Certification.check

    def first(self, motions, *, roomy):  # type: ignore[no-untyped-def]
        names = [n for n in motions.__slots__ if n != "commands"]
        cut = {n: getattr(motions, n)[:, :1] for n in names}
        return check(self, replace(motions, commands=motions.commands[:, :1], **cut), roomy=False)

    patch.setattr(Certification, "check", first)


def no_margin(patch: Patch) -> None:
    """A commitment keeps no distance of its own."""
    patch.setattr(certification, "FRESH_MARGIN", 0.0)


def parked() -> KinematicWorld:
    """A lorry parked in the passing lane, its flank 0.6 m beside ours."""
    lorry = Thing(11.0, 2.4, 1.8, 10.0)
    return KinematicWorld([lorry], speed=2.0, rng=np.random.default_rng(0))


def pass_then_steer(world: KinematicWorld, step: int) -> Array:
    """Until the scanner is past the lorry, then at its flank."""
    return np.array([0.0 if world.pose[0] < 12.5 else 0.45, 2.0])


def setting_off() -> KinematicWorld:
    """A person who stands beside the way and sets off when the car is near."""
    walk = Walk([(0.0, 0.0), *3 * [(0.0, -1.8)]], hold=16)
    return KinematicWorld([Thing(26.0, 2.2, 0.5, motion=walk)], speed=8.0)


def overtaken() -> KinematicWorld:
    """A slower car in the passing lane; it goes out of view beside ours."""
    motion = Roll(Road(), 6.0, 3.5)
    return KinematicWorld(
        [Thing(10.0, 3.5, 1.8, 4.5, motion=motion, velocity=np.array([6.0, 0.0]))], speed=8.0
    )


def cut_in(world: KinematicWorld, step: int) -> Array:
    """To the left as soon as the bumper is past the other's."""
    return np.array([0.2 if world.pose[0] > world.things[0].x - 1.0 else 0.0, 8.0])


def hedge() -> KinematicWorld:
    """A long hedge to the left."""
    return KinematicWorld([Thing(30.0, 2.7, 1.0, 56.0)], speed=4.0)


def wall() -> KinematicWorld:
    """A wall across the road."""
    return KinematicWorld([Thing(60.0, 1.75, 14.0, 1.0)], speed=9.0)


SCENES = {
    "backup": (no_backup, wall, constant(0.0, 9.0)),
    "corridor": (no_corridor, lambda: KinematicWorld([], speed=6.0), constant(-0.2, 6.0)),
    "memory": (no_memory, parked, pass_then_steer),
    "growth": (no_growth, setting_off, constant(0.0, 8.0)),
    "future of vehicles": (no_future, overtaken, cut_in),
}


@pytest.mark.parametrize("name", SCENES)
def test_a_check_is_needed(name: str, monkeypatch: Patch) -> None:
    """With it nothing happens; without it the car is at fault."""
    remove, scene, driver = SCENES[name]
    assert run(scene(), driver, Assumptions()).faults == []
    remove(monkeypatch)
    assert run(scene(), driver, Assumptions()).faults != []


def test_unknown_space_is_needed(monkeypatch: Patch) -> None:
    """The scanner dies before anything is in view; without unknown space the car meets the wall."""

    def dies(scan: Array, step: int) -> Array:
        return scan if step < 10 else np.full(180, np.nan)

    for remove, ends_well in ((None, True), (no_unknown, False)):
        if remove is not None:
            remove(monkeypatch)
        world = wall()
        shield = PredictiveFilter(
            world.limits, world.geometry, world.scanner, lanes=Road().lanes, deadline=1e6
        )
        record = drive(world, shield, constant(0.0, 9.0), 90, dies)
        assert (record.faults == []) == ends_well


def test_the_margin_for_errors_of_range_is_needed(monkeypatch: Patch) -> None:
    """Ranges are 0.25 m too long, which the assumptions allow, or do not."""
    careful = Assumptions(range_error=0.25)
    steer_left = constant(0.05, 4.0)
    assert run(hedge(), steer_left, careful, bias=0.25).faults == []
    no_margin(monkeypatch)
    careless = Assumptions(range_error=0.0, tracking_error=0.0)
    assert run(hedge(), steer_left, careless, bias=0.25).faults != []


def test_the_margin_for_errors_of_the_lane_is_needed() -> None:
    """The lane estimate is 0.15 m off, five of its deviations."""
    faults = []
    for assumed in (Assumptions(), Assumptions(lane_sigmas=0.0, lane_error=0.0)):
        world = KinematicWorld([], speed=6.0)
        see = world.lane
        world.lane = lambda see=see: replace(see(), lateral_offset=see().lateral_offset + 0.15)  # type: ignore[method-assign,misc]
        faults.append(run(world, constant(-0.2, 6.0), assumed).faults)
    assert faults[0] == [] and faults[1] != []


def test_memory_alone_keeps_what_is_out_of_view() -> None:
    """The scene of the parked car really hides it: from the steering on no beam hits it."""
    world = parked()
    record = run(world, pass_then_steer, Assumptions())
    assert record.faults == [] and world.seen[0] > 5


def test_a_scanner_that_freezes_beside_a_flank_brings_the_car_to_rest() -> None:
    """It repeats its scan from the moment on at which the flank fills it.

    Without noise a long flank looks the same from scan to scan, so the scans are not taken; what is
    remembered of its far end are hits a metre apart, some of which seem to move.
    """
    world = parked()
    world.rng = None
    assert run(world, pass_then_steer, Assumptions(), steps=120).faults == []
