"""What a certificate says, and what is executed while nothing certifies."""

import re

import numpy as np
import pytest
from hypothesis import strategies as st

from shield import InvalidProblem, PredictiveFilter, Status
from tests.shield.oracles import broken_bounds
from tests.shield.predictive.bodies import Chase, Thing
from tests.shield.predictive.filters import shared_filter
from tests.shield.predictive.kinematic_world import KinematicWorld, constant, drive
from tests.shield.predictive.scenes import drivers, roads
from tests.shield.strategies import NASTY
from tests.shield.tiers import two_tiers


def seen(world: KinematicWorld) -> PredictiveFilter:
    """The filter after one look at a world."""
    shield = shared_filter()
    shield.reset([world.steering, world.speed])
    shield.update(world.scan(), world.speed, 0.0, world.lane())
    return shield


def test_on_a_free_road_the_nominal_passes_bit_by_bit() -> None:
    """And nothing is said."""
    world = KinematicWorld([], speed=8.0)
    certificate = seen(world).filter([0.01, 8.1])
    assert certificate.status is Status.NOMINAL and not certificate.intervened
    assert certificate.safe_action.tolist() == [0.01, 8.1] and not certificate.reason
    assert not certificate.correction.any()


def test_a_refusal_names_backup_obstacle_time_and_metres() -> None:
    """For people."""
    pattern = (
        r"backup \d of \d \([a-z ]+\) would pass [a-z ]+ \d+ at -?\d\.\d\d m of \d\.\d\d m "
        r"in \d\.\d s"
    )
    hedge = Thing(30.0, 2.7, 1.0, 56.0)
    walker = Thing(20.0, 4.0, 0.5, motion=Chase())
    for thing in (hedge, walker):
        record = drive(
            KinematicWorld([thing], speed=6.0), shared_filter(), constant(0.1, 8.0), 40
        )  # fmt: skip
        reasons = [reason for reason in record.reasons if "would pass" in reason]
        assert any(re.match(pattern, reason) for reason in reasons), reasons[:3]


def test_a_refusal_at_the_edge_names_the_metres_outside() -> None:
    """Steering out of the lanes."""
    world = KinematicWorld([], speed=8.0)
    record = drive(world, shared_filter(), constant(-0.3, 8.0), 20)
    assert any(re.search(r"leave the lanes by \d\.\d\d m", reason) for reason in record.reasons)
    assert record.events == []


def test_a_car_that_stands_may_turn_its_wheels() -> None:
    """Whatever is before it: what does not move touches nothing, and it may have to steer free."""
    certificate = seen(KinematicWorld([Thing(5.0, 0.0, 0.5)])).filter([0.05, 0.0])
    assert certificate.status is Status.NOMINAL
    moving = seen(KinematicWorld([Thing(5.0, 0.0, 0.5)])).filter([0.05, 0.3])
    assert moving.status is not Status.NOMINAL


def test_a_nominal_that_is_not_finite_is_answered() -> None:
    """With the committed backup, and a certificate that says so."""
    shield = seen(KinematicWorld([], speed=8.0))
    shield.filter([0.0, 8.0])
    certificate = shield.filter([np.nan, 8.0])
    assert "not finite" in certificate.reason and certificate.intervened
    assert certificate.safe_action[1] < 8.0


def test_the_committed_motion_is_replayed_bit_by_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    """From any moment on at which nothing certifies any more, to rest."""
    for begin in (1, 8, 15):
        world = KinematicWorld([Thing(28.0, 0.5, 1.0)], speed=7.0)
        shield = shared_filter()
        shield.reset([0.0, 7.0])
        for step in range(begin):
            shield.update(world.scan(), world.speed, world.yaw_rate, world.lane())
            world.advance(shield.filter([0.1, 8.0]).safe_action, step)
        tail = shield.committed.copy()
        assert len(tail) and tail[-1, 1] == 0.0
        with monkeypatch.context() as patch:
            patch.setattr(PredictiveFilter, "_certify", lambda *_: (None, "nothing"))
            patch.setattr(PredictiveFilter, "_nearest", lambda *_: None)
            for expected in tail:
                certificate = shield.filter([0.3, 12.0])
                assert certificate.safe_action.tobytes() == expected.tobytes()
                assert certificate.reason.endswith("the committed backup goes on")
            assert shield.filter([0.0, 12.0]).safe_action[1] == 0.0


def test_among_people_the_tail_is_what_is_executed() -> None:
    """Whenever the certificate says that the backup goes on."""
    replayed = 0
    for lateral in (6.0, 3.0, -4.0):
        world = KinematicWorld([Thing(18.0, lateral, 0.5, motion=Chase())], speed=7.0)
        shield = shared_filter()
        shield.reset([0.0, 7.0])
        for step in range(50):
            shield.update(world.scan(), world.speed, world.yaw_rate, world.lane())
            tail = shield.committed.copy()
            certificate = shield.filter([0.05, 10.0])
            if certificate.reason.endswith("the committed backup goes on") and len(tail):
                assert certificate.safe_action.tobytes() == tail[0].tobytes()
                replayed += 1
            world.advance(certificate.safe_action, step)
    assert replayed > 3


@two_tiers(
    fast=8, slow=500, world=roads(), driver=drivers(), wild=st.lists(st.tuples(NASTY, NASTY))
)
def test_every_command_keeps_g1_to_g3_exactly(world, driver, wild) -> None:  # type: ignore[no-untyped-def]
    """Also when the wishes are no numbers; in exact arithmetic, command by command."""
    shield = shared_filter()
    shield.reset([0.0, world.speed])
    for step in range(30):
        shield.update(world.scan(), world.speed, world.yaw_rate, world.lane())
        previous = shield.previous
        wish = wild[step % len(wild)] if wild and step % 3 == 0 else driver(world, step)
        certificate = shield.filter(wish)
        assert broken_bounds(world.limits, [certificate.safe_action], previous) == []
        assert certificate.max_violation == 0.0 and shield.previous is certificate.safe_action
        if world.advance(certificate.safe_action, step):
            break


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("scan", (None, 5.0, 0.0)),
        ("scan", ("scan", 5.0, 0.0)),
        ("scan", (np.zeros(90), 5.0, 0.0)),
        ("scan", (np.zeros((1, 180)), 5.0, 0.0)),
        ("scan", (np.zeros(180) * 1j, 5.0, 0.0)),
        ("scan", ([[1.0], [1.0, 2.0]], 5.0, 0.0)),
        ("speed", (np.full(180, 40.0), None, 0.0)),
        ("speed", (np.full(180, 40.0), "5", 0.0)),
        ("speed", (np.full(180, 40.0), [5.0], 0.0)),
        ("yaw_rate", (np.full(180, 40.0), 5.0, "a")),
        ("yaw_rate", (np.full(180, 40.0), 5.0, None)),
    ],
)
def test_wrong_types_are_refused_by_name(name: str, arguments: tuple[object, ...]) -> None:
    """With `InvalidProblem`, before anything has changed."""
    shield = seen(KinematicWorld([Thing(20.0, 0.0, 1.0)], speed=5.0))
    before = shield.world.obstacles.points.copy()
    with pytest.raises(InvalidProblem, match=f"`{name}`"):
        shield.update(*arguments)  # type: ignore[arg-type]
    assert np.array_equal(before, shield.world.obstacles.points) and len(before)


@pytest.mark.parametrize("wish", [None, ["a", 1.0], np.zeros(3), np.zeros((1, 2))])
def test_a_nominal_of_a_wrong_shape_is_refused(wish: object) -> None:
    """By name, and the commitment stays."""
    shield = seen(KinematicWorld([], speed=5.0))
    shield.filter([0.0, 5.0])
    before = shield.committed.copy()
    with pytest.raises(InvalidProblem, match="`nominal`"):
        shield.filter(wish)  # type: ignore[arg-type]
    assert np.array_equal(before, shield.committed)


def test_a_reset_forgets_what_was_seen() -> None:
    """World and commitment."""
    shield = seen(KinematicWorld([Thing(20.0, 0.0, 1.0)], speed=5.0))
    shield.filter([0.0, 5.0])
    shield.reset([0.0, 5.0])
    assert not len(shield.committed) and not len(shield.world.obstacles.points)
    assert shield.filter([0.0, 5.0]).safe_action[1] < 5.0
