"""`project_batch` keeps every guarantee of `project` and finds the same optima."""

import time
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

from shield import ActuatorLimits, InvalidProblem, Status
from shield.bench.problems import bending_problems, random_problems
from shield.projection.batch.lateral import LateralBatch
from shield.projection.batch.sweep import sweep
from shield.projection.repair import Bounds
from tests.shield import tolerances
from tests.shield.oracles import broken_bounds
from tests.shield.strategies import (
    CITY,
    LINEAR,
    NASTY,
    VEHICLES,
    Array,
    admissible_commands,
    horizons,
    projector,
)
from tests.shield.tiers import two_tiers


@st.composite
def batches(draw: st.DrawFn) -> tuple[ActuatorLimits, Array, Array]:
    """Draw a vehicle and up to six horizons, each from its own previous command."""
    limits = draw(st.sampled_from(VEHICLES))
    previous = [draw(admissible_commands(limits)) for _ in range(draw(st.integers(1, 6)))]
    nominals = [draw(horizons(limits, 8, last)) for last in previous]
    return limits, np.array(nominals), np.array(previous)


@two_tiers(batch=batches())
def test_every_horizon_of_a_batch_is_admissible_and_as_good_as_by_itself(
    batch: tuple[ActuatorLimits, Array, Array],
) -> None:
    """Exact bounds, bit by bit where admissible, the same objective where the optimum is one."""
    limits, nominals, previous = batch
    target = projector(limits, 8)
    got = target.project_batch(nominals, previous)
    assert len(got) == len(nominals)
    for one, nominal, last in zip(got, nominals, previous, strict=True):
        alone = target.project(nominal, last)
        assert broken_bounds(limits, one.actions, last) == []
        assert one.max_violation == 0.0
        assert (one.status is Status.NOMINAL) == (alone.status is Status.NOMINAL)
        if one.status is Status.NOMINAL:
            assert one.actions.tobytes() == nominal.tobytes()
        if one.status is alone.status is Status.PROJECTED and not (
            _binds(limits, one.actions) or _binds(limits, alone.actions)
        ):
            assert target.objective(one.actions, nominal) == pytest.approx(
                target.objective(alone.actions, nominal),
                rel=tolerances.BATCH_OBJECTIVE,
                abs=tolerances.OBJECTIVE_FLOOR,
            )


def _binds(limits: ActuatorLimits, actions: Array) -> bool:
    """Tell whether the lateral bound is met, where there may be several local optima."""
    bound = limits.max_lateral_acceleration
    if bound is None:
        return False
    return bool(np.abs(limits.lateral_acceleration(actions)).max() > 0.999999 * bound)


@st.composite
def nasty_batches(draw: st.DrawFn) -> tuple[ActuatorLimits, Array, Array]:
    """Draw a batch in which some values may be anything that float64 can hold."""
    limits, nominals, previous = draw(batches())
    for _ in range(draw(st.integers(1, 4))):
        index = tuple(draw(st.integers(0, size - 1)) for size in nominals.shape)
        nominals[index] = draw(NASTY)
    if draw(st.booleans()):
        previous[draw(st.integers(0, len(previous) - 1)), draw(st.integers(0, 1))] = draw(NASTY)
    return limits, nominals, previous


@two_tiers(batch=nasty_batches())
def test_bad_rows_do_not_disturb_good_ones(batch: tuple[ActuatorLimits, Array, Array]) -> None:
    """G4 row by row: each row is what it would be alone."""
    limits, nominals, previous = batch
    target = projector(limits, 8)
    with np.errstate(all="raise"):
        got = target.project_batch(nominals, previous)
        for one, nominal, last in zip(got, nominals, previous, strict=True):
            alone = target.project(nominal, last)
            solved = {Status.PROJECTED, Status.REPAIRED}
            assert one.status is alone.status or {one.status, alone.status} == solved
            assert ((limits.low <= one.actions) & (one.actions <= limits.high)).all()
            assert (one.max_violation > 0.0) == (alone.max_violation > 0.0)
            if one.status is Status.FALLBACK:
                assert one.reason.split(";")[0] == alone.reason.split(";")[0]


@pytest.mark.parametrize("limits", [CITY, LINEAR], ids=["lateral", "linear"])
def test_a_large_batch_agrees_with_the_loop(
    limits: ActuatorLimits, rng: np.random.Generator
) -> None:
    """Horizons of all kinds, so many that they are worked on in parts."""
    draws = [random_problems(limits, 8, 600, rng)]
    if limits is CITY:
        draws.append(bending_problems(limits, 8, 600, rng))
    nominals, previous = (np.concatenate(part) for part in zip(*draws, strict=True))
    target = projector(limits, 8)
    got = target.project_batch(nominals, previous)
    assert not any(status is Status.FALLBACK for status in got.status)
    for index in range(0, len(nominals), 7):
        alone = target.project(nominals[index], previous[index])
        assert broken_bounds(limits, got.actions[index], previous[index]) == []
        assert target.objective(got.actions[index], nominals[index]) == pytest.approx(
            target.objective(alone.actions, nominals[index]),
            rel=tolerances.BATCH_OBJECTIVE,
            abs=tolerances.OBJECTIVE_FLOOR,
        )


def test_one_previous_command_serves_all_and_batches_may_be_empty() -> None:
    """(2,) is broadcast; B = 0 and B = 1 are batches too."""
    target = projector(CITY, 8)
    nominals = np.tile([0.3, 9.0], (3, 8, 1))
    shared = target.project_batch(nominals, [0.0, 8.0])
    each = target.project_batch(nominals, np.tile([0.0, 8.0], (3, 1)))
    assert shared.actions == pytest.approx(each.actions, abs=tolerances.ROUNDING)
    assert target.project_batch(np.zeros((0, 8, 2)), [0.0, 0.0]).actions.shape == (0, 8, 2)
    assert len(target.project_batch(nominals[:1], [0.0, 8.0])) == 1
    assert not shared.actions.flags.writeable
    assert not shared.correction.flags.writeable
    assert (shared.correction == shared.actions - nominals).all()


@pytest.mark.parametrize(
    ("nominals", "previous", "name"),
    [
        (np.zeros((8, 2)), np.zeros(2), "nominals"),
        (np.zeros((3, 7, 2)), np.zeros(2), "nominals"),
        (np.zeros((3, 8, 3)), np.zeros(2), "nominals"),
        (np.zeros((3, 8, 2)), np.zeros(3), "previous"),
        (np.zeros((3, 8, 2)), np.zeros((2, 2)), "previous"),
        ("text", np.zeros(2), "nominals"),
    ],
)
def test_wrong_shapes_raise(nominals: Any, previous: Any, name: str) -> None:
    """Naming the argument."""
    with pytest.raises(InvalidProblem, match=f"`{name}`"):
        projector(CITY, 8).project_batch(nominals, previous)


def test_the_sweep_solves_its_block_tridiagonal_system(rng: np.random.Generator) -> None:
    """Against a dense solver, system by system."""
    horizon, batch = 5, 3
    joints = rng.uniform(0.0, 1.0, (horizon, 2, batch))
    diagonal = 3.0 + rng.uniform(0.0, 1.0, (horizon, 2, batch))
    across, force = rng.uniform(-1.0, 1.0, (horizon, batch)), rng.normal(size=(horizon, 2, batch))
    solution = sweep(diagonal, across, joints, force)
    for index in range(batch):
        dense = np.diag(diagonal[..., index].ravel())
        for t in range(horizon):
            dense[2 * t, 2 * t + 1] = dense[2 * t + 1, 2 * t] = across[t, index]
            for channel in range(2):
                if t:
                    row = 2 * t + channel
                    dense[row, row - 2] = dense[row - 2, row] = -joints[t, channel, index]
        expected = np.linalg.solve(dense, force[..., index].ravel())
        assert solution[..., index].ravel() == pytest.approx(expected, rel=1e-12)


def test_the_interior_point_method_converges_on_what_it_is_given(
    rng: np.random.Generator,
) -> None:
    """All of 200 bends, within its steps, from the optimum without lateral bound."""
    nominals, previous = bending_problems(CITY, 8, 200, rng)
    start = projector(LINEAR, 8).project_batch(nominals, previous).actions
    solution, solved = LateralBatch(Bounds.of(CITY), (1.0, 1.0)).solve(
        np.ascontiguousarray(nominals.transpose(1, 2, 0)),
        np.ascontiguousarray(start.transpose(1, 2, 0)),
        np.ascontiguousarray(previous.T),
    )
    assert solved.all()
    lateral = np.abs(CITY.lateral_acceleration(solution.transpose(2, 0, 1)))
    assert lateral.max() <= 4.0


def test_a_batch_is_several_times_faster_than_the_loop(rng: np.random.Generator) -> None:
    """The bench asks for 10 on a quiet machine; on a busy one 4 must remain."""
    nominals, previous = random_problems(LINEAR, 8, 512, rng)
    target = projector(LINEAR, 8)
    ratios = []
    for _ in range(5):
        begin = time.thread_time()
        target.project_batch(nominals, previous)
        middle = time.thread_time()
        for nominal, last in zip(nominals, previous, strict=True):
            target.project(nominal, last)
        ratios.append((time.thread_time() - middle) / (middle - begin))
    assert np.median(ratios) > 4.0
