"""G1-G4 of `HorizonProjector`: what it returns can be executed, whatever it is given."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

from shield import ActuatorLimits, HorizonProjector, InvalidProblem, Status
from tests.shield.oracles import broken_bounds
from tests.shield.strategies import (
    CITY,
    LINEAR,
    Array,
    any_shape,
    nasty_problems,
    problems,
    projector,
)
from tests.shield.tiers import two_tiers

Problem = tuple[ActuatorLimits, Array, Array]
GENTLE = np.array([0.0, 5.0])


@two_tiers(problem=problems())
def test_every_projected_horizon_is_admissible_and_honest(problem: Problem) -> None:
    """G1, G2 and G3 without tolerance; the status says what happened; admissible ones pass."""
    limits, nominal, previous = problem
    before = nominal.copy()
    got = projector(limits, len(nominal)).project(nominal, previous)
    assert broken_bounds(limits, got.actions, previous) == []
    assert got.max_violation == 0.0
    assert (nominal == before).all(), "the caller's array must not change"
    assert not got.actions.flags.writeable
    assert not got.correction.flags.writeable
    assert (got.correction == got.actions - nominal).all()
    admissible = not broken_bounds(limits, nominal, previous)
    assert (got.status is Status.NOMINAL) == admissible
    if admissible:
        assert got.actions.tobytes() == nominal.tobytes()
        assert got.reason == ""
    else:
        assert got.status in (Status.PROJECTED, Status.REPAIRED)
        assert bool(got.reason) == (got.status is Status.REPAIRED)
    assert 0.0 < got.solve_time < projector(limits, len(nominal)).deadline


@two_tiers(problem=nasty_problems())
def test_any_values_give_a_command_in_the_box_with_an_honest_status(problem: Problem) -> None:
    """G4: NaN, infinities, 1e300, denormals, previous commands outside the box."""
    limits, nominal, previous = problem
    # Not even where the caller turned rounding, overflow and NaN into exceptions.
    with np.errstate(all="raise"):
        got = projector(limits, len(nominal)).project(nominal, previous)
    assert np.isfinite(got.actions).all()
    assert ((limits.low <= got.actions) & (got.actions <= limits.high)).all()
    if not (np.isfinite(nominal).all() and np.isfinite(previous).all()):
        assert got.status is Status.FALLBACK
        assert "not finite" in got.reason or "braking" in got.reason
    if np.isfinite(previous).all():
        broken = broken_bounds(limits, got.actions, previous)
        assert (got.max_violation > 0.0) == bool(broken)
        if broken:
            assert got.status is Status.FALLBACK
            assert got.reason
        if limits.is_admissible(previous):
            assert not broken


EXAMPLES = {
    "G1 box": (LINEAR, [[0.0, 12.5]], [0.0, 12.4], "box"),
    "G2 steering rate": (LINEAR, [[0.2, 5.0]], [0.0, 5.0], "rate steering"),
    "G2 acceleration": (LINEAR, [[0.0, 5.5]], [0.0, 5.0], "rate speed"),
    "G2 deceleration": (LINEAR, [[0.0, 4.0]], [0.0, 5.0], "rate speed"),
    "G3 lateral": (CITY, [[0.12, 10.0]], [0.10, 10.0], "lateral"),
}


@pytest.mark.parametrize("name", EXAMPLES)
def test_each_bound_is_broken_without_the_shield_and_holds_with_it(name: str) -> None:
    """The same wish, executed raw and projected."""
    limits, nominal, previous, kind = EXAMPLES[name]
    assert any(item.startswith(kind) for item in broken_bounds(limits, nominal, previous))
    got = projector(limits, 1).project(nominal, previous)
    assert got.status is Status.PROJECTED
    assert not [item for item in broken_bounds(limits, got.actions, previous) if kind in item]


def test_a_single_ulp_beyond_a_bound_is_a_violation_and_is_mended() -> None:
    """The smallest violation there is, at each bound."""
    for channel in range(2):
        edge = CITY.high.copy()
        edge[1 - channel] = 0.0
        beyond = edge.copy()
        beyond[channel] = np.nextafter(edge[channel], np.inf)
        got = projector(CITY, 1).project([beyond], edge)
        assert got.status is Status.PROJECTED
        assert got.actions[0, channel] == edge[channel]
        assert projector(CITY, 1).project([edge], edge).status is Status.NOMINAL


def test_rates_hold_where_plain_float_arithmetic_breaks_them() -> None:
    """`previous + step` rounds up somewhere; the exact window ends an ulp below."""
    rng = np.random.default_rng(1)
    broken_by_clipping = 0
    for _ in range(200):
        previous = np.array([rng.uniform(-0.4, 0.4), rng.uniform(1.0, 9.0)])
        wish = np.array([[0.5, 12.0]])
        clipped = np.minimum(wish, previous + LINEAR.max_increase)
        broken_by_clipping += bool(broken_bounds(LINEAR, clipped, previous))
        got = projector(LINEAR, 1).project(wish, previous)
        assert broken_bounds(LINEAR, got.actions, previous) == []
    assert broken_by_clipping > 0


def test_an_inadmissible_previous_command_is_left_at_full_rate() -> None:
    """The box wins, everything else is approached as fast as the rates allow, and it says so."""
    got = projector(CITY, 8).project(np.tile([0.5, 12.0], (8, 1)), [0.5, 12.0])
    assert got.status is Status.FALLBACK
    assert "inadmissible" in got.reason
    assert got.max_violation > 0.0
    steps = np.diff(got.actions, axis=0, prepend=[[0.5, 12.0]])
    assert steps[:3] == pytest.approx(np.tile([-0.06, -0.6], (3, 1)))
    far = projector(CITY, 8).project(np.tile([0.0, 5.0], (8, 1)), [3.0, 1e300])
    assert far.actions[0].tolist() == [0.5, 12.0]
    assert far.status is Status.FALLBACK


def test_an_inadmissible_previous_command_within_reach_is_no_excuse() -> None:
    """Where some answer keeps every bound, one is given and nothing is said."""
    got = projector(CITY, 1).project([[0.0, 12.0]], [0.0, 12.2])
    assert got.status is Status.NOMINAL
    got = projector(CITY, 1).project([[0.0, 13.0]], [0.53, 0.0])
    assert got.status is Status.PROJECTED
    assert got.max_violation == 0.0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_horizon_with_one_bad_value_is_distrusted_as_a_whole(bad: float) -> None:
    """The answer is braking at full rate with the steering held."""
    nominal = np.tile([0.1, 6.0], (8, 1))
    nominal[5, 1] = bad
    got = projector(CITY, 8).project(nominal, [0.05, 5.0])
    assert got.status is Status.FALLBACK
    assert got.reason == f"nominal[5, 1] is {bad}: braking"
    assert (got.actions[:, 0] == 0.05).all()
    assert np.diff(got.actions[:, 1]) == pytest.approx(-0.6)
    assert not np.isfinite(got.correction[5, 1])


@pytest.mark.parametrize(
    ("previous", "assumed"),
    [
        ([np.nan, np.nan], [0.0, 0.0]),
        ([np.inf, -np.inf], [0.5, 0.0]),
        ([-np.inf, 5.0], [-0.5, 5.0]),
        ([0.1, np.inf], [0.1, 12.0]),
    ],
)
def test_an_unknown_previous_command_is_assumed_and_reported(
    previous: list[float], assumed: list[float]
) -> None:
    """NaN counts as rest, an infinity as the end of the box, and the reason says so."""
    got = projector(CITY, 8).project(np.tile(assumed, (8, 1)), previous)
    assert got.status is Status.FALLBACK
    assert "not finite" in got.reason
    assert "assumed" in got.reason


def test_integers_lists_and_float32_are_welcome_and_huge_integers_are_values() -> None:
    """Whatever numpy can read as numbers; an integer beyond float64 is infinite."""
    target = projector(CITY, 1)
    assert target.project([[0, 5]], (0, 5)).status is Status.NOMINAL
    assert target.project(np.array([[0.01, 5.0]], np.float32), GENTLE).status is Status.NOMINAL
    assert target.project([[10**400, 5]], GENTLE).status is Status.FALLBACK
    assert target.project([[-(10**400), 5]], GENTLE).status is Status.FALLBACK


@two_tiers(shape=any_shape())
def test_wrong_shapes_raise_at_once(shape: Any) -> None:
    """Naming the argument and the shape, for nominal and previous alike."""
    with pytest.raises(InvalidProblem, match=r"`nominal` must have shape \(8, 2\)\. Got"):
        projector(CITY, 8).project(shape, GENTLE)
    if shape.shape != (2,):
        with pytest.raises(InvalidProblem, match=r"`previous` must have shape \(2,\)\. Got"):
            projector(CITY, 8).project(np.zeros((8, 2)), shape)


@pytest.mark.parametrize(
    "nominal", ["fast", [["a", "b"]], [[None, 1.0]], [[1.0], [1.0, 2.0]], [[1j, 0.0]], object()]
)
def test_what_is_not_numbers_raises(nominal: Any) -> None:
    """Types are design-time mistakes, unlike values."""
    with pytest.raises(InvalidProblem, match="`nominal`"):
        projector(CITY, 1).project(nominal, GENTLE)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"horizon": 0}, "horizon"),
        ({"horizon": -1}, "horizon"),
        ({"horizon": 2.5}, "horizon"),
        ({"horizon": True}, "horizon"),
        ({"solver": "no such solver"}, "solver"),
        ({"weights": (1.0, 0.0)}, "weights"),
        ({"weights": (1.0, np.nan)}, "weights"),
        ({"weights": (1.0,)}, "weights"),
        ({"solver": None}, "solver"),
        ({"deadline": "soon"}, "deadline"),
        ({"deadline": 10**400}, "deadline"),
        ({"tolerance": None}, "tolerance"),
        ({"horizon": "8"}, "horizon"),
        ({"deadline": 0.0}, "deadline"),
        ({"deadline": np.nan}, "deadline"),
        ({"tolerance": -1.0}, "tolerance"),
        ({"limits": None}, "limits"),
    ],
)
def test_impossible_arguments_raise(arguments: dict[str, Any], name: str) -> None:
    """Naming the argument and its value."""
    with pytest.raises(InvalidProblem, match=f"`{name}`.*Got"):
        HorizonProjector(**{"limits": CITY, "horizon": 8, **arguments})


def test_the_result_does_not_depend_on_earlier_calls() -> None:
    """A warm solver finds the same optimum as a cold one."""
    rng = np.random.default_rng(2)
    warm = HorizonProjector(CITY, 8, deadline=2.0)
    for _ in range(30):
        nominal = rng.uniform([-0.6, -1.0], [0.6, 14.0], (8, 2))
        previous = np.array([0.02, rng.uniform(0.0, 12.0)])
        cold = HorizonProjector(CITY, 8, deadline=2.0).project(nominal, previous)
        assert warm.project(nominal, previous).actions == pytest.approx(cold.actions, abs=1e-7)


def test_after_a_reset_the_same_horizons_get_the_same_answers(rng: np.random.Generator) -> None:
    """Bit by bit: the solver's warm start shows in the last ones, and a drive in bends grows it."""
    target = HorizonProjector(CITY, 8, deadline=5.0)  # a busy machine must not cut one short
    wishes = np.stack([rng.uniform(-0.5, 0.5, (300, 8)), rng.uniform(4.0, 14.0, (300, 8))], axis=2)
    first = [target.project(wish, GENTLE).actions for wish in wishes]
    target.reset()
    second = [target.project(wish, GENTLE).actions for wish in wishes]
    assert np.array_equal(first, second)


def test_weights_decide_whether_a_bend_costs_steering_or_speed() -> None:
    """Where the lateral bound binds, a dear channel moves less; elsewhere weights do nothing."""
    nominal = np.array([10.0, 0.0])[::-1] + np.tile([0.3, 0.0], (8, 1))
    previous = [0.1, 10.0]
    dear_steering = HorizonProjector(CITY, 8, weights=(1e4, 1.0), deadline=2.0).project(
        nominal, previous
    )
    dear_speed = HorizonProjector(CITY, 8, weights=(1.0, 1e4), deadline=2.0).project(
        nominal, previous
    )
    assert dear_steering.actions[-1, 0] > dear_speed.actions[-1, 0] + 0.05
    assert dear_steering.actions[-1, 1] < dear_speed.actions[-1, 1] - 1.0
    plain = replace(CITY, max_lateral_acceleration=None)
    one = projector(plain, 8).project(nominal, previous)
    two = HorizonProjector(plain, 8, weights=(1e4, 1.0), deadline=2.0).project(nominal, previous)
    assert one.actions == pytest.approx(two.actions, abs=1e-9)


def test_a_car_too_fast_for_a_bend_also_brakes() -> None:
    """By default both channels are measured in steps: the wish does not cost all steering."""
    wish, previous = np.tile([0.25, 9.0], (8, 1)), [0.1, 9.0]
    plain = HorizonProjector(CITY, 8, weights=(1.0, 1.0), deadline=2.0).project(wish, previous)
    got = HorizonProjector(CITY, 8, deadline=2.0).project(wish, previous)
    assert got.status is plain.status is Status.PROJECTED
    assert plain.actions[-1] == pytest.approx([0.133, 9.0], abs=0.005)
    assert got.actions[-1] == pytest.approx([0.143, 8.65], abs=0.005)


@pytest.mark.parametrize("horizon", [1, 3, 20, 64])
def test_any_horizon_length_works(horizon: int, rng: np.random.Generator) -> None:
    """From one step to more than six seconds."""
    nominal = rng.uniform([-0.6, -1.0], [0.6, 14.0], (horizon, 2))
    got = projector(CITY, horizon).project(nominal, GENTLE)
    assert broken_bounds(CITY, got.actions, GENTLE) == []


@two_tiers(start=st.floats(0.0, 12.0), wish=st.lists(st.floats(-1.0, 1.0), min_size=8, max_size=8))
def test_projection_is_idempotent(start: float, wish: list[float]) -> None:
    """An answer is admissible, so asking again changes nothing, not even the last bit."""
    previous = np.array([0.0, start])
    nominal = np.column_stack([np.array(wish), start + 5.0 * np.array(wish)[::-1]])
    once = projector(CITY, 8).project(nominal, previous)
    twice = projector(CITY, 8).project(once.actions, previous)
    assert twice.status is Status.NOMINAL
    assert twice.actions.tobytes() == once.actions.tobytes()


def test_projections_compare_by_what_they_say() -> None:
    """Equal where the actions are; the time of the call is no part of that."""
    target = projector(CITY, 8)
    first, second = (target.project(np.tile([0.0, 13.0], (8, 1)), GENTLE) for _ in range(2))
    assert first.solve_time != second.solve_time
    assert first.actions == pytest.approx(second.actions)
    nominal = [target.project(np.tile(GENTLE, (8, 1)), GENTLE) for _ in range(2)]
    assert nominal[0] == nominal[1]
    assert hash(nominal[0]) == hash(nominal[1])
    assert nominal[0] != first
    assert nominal[0] != 1
