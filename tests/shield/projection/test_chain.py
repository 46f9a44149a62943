"""The dynamic program is exact, and the KKT check tells optimal from not."""

import numpy as np
import pytest
import qpsolvers
from hypothesis import strategies as st

from shield.projection.batch.chain import solve_chains
from shield.projection.chain import (
    ChainBounds,
    active_blocks,
    is_optimal,
    settle_chain,
    solve_chain,
)
from tests.shield import tolerances
from tests.shield.tiers import two_tiers


@st.composite
def chains(draw: st.DrawFn) -> tuple[list[float], ChainBounds, float]:
    """Draw targets, bounds and a previous value inside the box."""
    bounds = ChainBounds(
        draw(st.sampled_from([0.0, -0.5])),
        draw(st.sampled_from([0.5, 12.0])),
        draw(st.floats(0.01, 2.0)),
        draw(st.floats(0.01, 2.0)),
    )
    previous = draw(st.sampled_from(bounds[:2]) | st.floats(bounds.low, bounds.high))
    length = draw(st.integers(1, 12))
    targets = draw(st.lists(st.floats(-5.0, 15.0), min_size=length, max_size=length))
    return targets, bounds, previous


def quadprog(targets: list[float], bounds: ChainBounds, previous: float) -> np.ndarray:
    """Solve one channel with quadprog."""
    pytest.importorskip("quadprog")
    size = len(targets)
    difference = np.eye(size) - np.eye(size, k=-1)
    offset = np.zeros(size)
    offset[0] = previous
    solution = qpsolvers.solve_qp(
        np.eye(size),
        -np.array(targets),
        np.vstack([difference, -difference]),
        np.concatenate([bounds.rise + offset, bounds.fall - offset]),
        lb=np.full(size, bounds.low),
        ub=np.full(size, bounds.high),
        solver="quadprog",
    )
    assert solution is not None
    return solution


@two_tiers(chain=chains())
def test_the_dynamic_program_agrees_with_quadprog(
    chain: tuple[list[float], ChainBounds, float],
) -> None:
    """Scalar and batched form give the minimiser, and the KKT check confirms it."""
    targets, bounds, previous = chain
    solution = solve_chain(targets, bounds, previous)
    assert solution == pytest.approx(quadprog(*chain), abs=1e-7)
    assert is_optimal(solution, targets, bounds, previous, tolerances.ROUNDING)
    column = (np.array([value]) for value in (*bounds, previous))
    batch = solve_chains(np.array(targets)[:, None], *column)
    assert batch[:, 0] == pytest.approx(solution, abs=tolerances.ROUNDING)


@two_tiers(chain=chains(), seed=st.integers(0, 2**32 - 1))
def test_settling_recovers_the_digits_of_a_rough_answer(
    chain: tuple[list[float], ChainBounds, float], seed: int
) -> None:
    """From the minimiser with noise, a certified result is the minimiser; blocks agree with it."""
    targets, bounds, previous = chain
    exact = solve_chain(targets, bounds, previous)
    noise = np.random.default_rng(seed).normal(0.0, 1e-7, len(exact))
    rough = [x + error for x, error in zip(exact, noise, strict=True)]
    settled = settle_chain(rough, targets, bounds, previous, 1e-5)
    if is_optimal(settled, targets, bounds, previous, tolerances.ROUNDING):
        assert settled == pytest.approx(exact, abs=1e-6)
    owners, offsets, blocks = active_blocks(rough, bounds, previous, 1e-5)
    for block in range(blocks):
        steps = [t for t, owner in enumerate(owners) if owner == block]
        mean = np.mean([targets[t] - offsets[t] for t in steps])
        assert [settled[t] for t in steps] == pytest.approx(
            [mean + offsets[t] for t in steps], abs=tolerances.ROUNDING
        )
    fixed = [t for t, owner in enumerate(owners) if owner < 0]
    assert [settled[t] for t in fixed] == pytest.approx([offsets[t] for t in fixed])


def test_the_check_refuses_points_that_are_not_optimal() -> None:
    """A feasible point with a wrong multiplier, and points beyond each bound."""
    bounds, targets = ChainBounds(0.0, 1.0, 0.5, 0.5), [0.4, 0.4]
    assert is_optimal([0.4, 0.4], targets, bounds, 0.2, 1e-9)
    assert not is_optimal([0.4, 0.3], targets, bounds, 0.2, 1e-9)
    assert not is_optimal([0.4, 0.5], targets, bounds, 0.2, 1e-9)
    assert not is_optimal([0.4, 1.2], [0.4, 1.2], bounds, 0.2, 1e-9)
    assert not is_optimal([0.4, -0.2], [0.4, -0.2], bounds, 0.2, 1e-9)
    assert not is_optimal([0.9], [0.9], bounds, 0.2, 1e-9)
    assert not is_optimal([0.1], [0.1], bounds, 0.8, 1e-9)
    assert not is_optimal([0.7], [0.1], bounds, 0.2, 1e-9)
    assert not is_optimal([0.3], [0.9], bounds, 0.8, 1e-9)


def test_in_a_box_of_width_zero_its_one_point_is_optimal() -> None:
    """Whichever way the targets pull: the multiplier may have either sign."""
    bounds = ChainBounds(4.0, 4.0, 1.0, 1.0)
    assert is_optimal([4.0, 4.0], [9.0, -9.0], bounds, 4.0, tolerances.ROUNDING)
    assert is_optimal([4.0, 4.0], [-9.0, 9.0], bounds, 4.0, tolerances.ROUNDING)


def test_a_previous_value_out_of_reach_of_the_box_starts_at_its_end() -> None:
    """The first step is then the nearest end of the box."""
    bounds = ChainBounds(0.0, 1.0, 0.1, 0.1)
    assert solve_chain([0.5, 0.5], bounds, 3.0) == pytest.approx([1.0, 0.9])
    assert solve_chain([0.5, 0.5], bounds, -3.0) == pytest.approx([0.0, 0.1])
