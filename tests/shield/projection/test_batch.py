"""`project_batch` is `project`, one horizon after the other."""

from typing import Any

import numpy as np
import pytest

from shield import HorizonProjector, InvalidProblem, Status
from shield.bench.problems import bending_problems, random_problems
from tests.shield.oracles import broken_bounds
from tests.shield.strategies import CITY, projector


def test_a_batch_is_the_loop_bit_by_bit(rng: np.random.Generator) -> None:
    """After a reset the same horizons in the same order get the same answers."""
    draws = [random_problems(CITY, 8, 40, rng), bending_problems(CITY, 8, 40, rng)]
    nominals, previous = (np.concatenate(part) for part in zip(*draws, strict=True))
    nominals[3, 2, 1] = np.nan
    target = HorizonProjector(CITY, 8, deadline=5.0)
    batch = target.project_batch(nominals, previous)
    target.reset()
    assert len(batch) == 80
    for got, nominal, last in zip(batch, nominals, previous, strict=True):
        alone = target.project(nominal, last)
        assert got.actions.tobytes() == alone.actions.tobytes()
        assert got.status is alone.status
        assert broken_bounds(CITY, got.actions, last) == []
    assert batch[3].status is Status.FALLBACK


def test_one_previous_command_serves_all_and_batches_may_be_empty() -> None:
    """(2,) is broadcast; B = 0 and B = 1 are batches too."""
    target = projector(CITY, 8)
    nominals = np.tile([0.3, 9.0], (3, 8, 1))
    shared = target.project_batch(nominals, [0.0, 8.0])
    each = target.project_batch(nominals, np.tile([0.0, 8.0], (3, 1)))
    for one, two in zip(shared, each, strict=True):
        assert one.actions == pytest.approx(two.actions, abs=1e-6)
    assert target.project_batch(np.zeros((0, 8, 2)), [0.0, 0.0]) == ()
    assert len(target.project_batch(nominals[:1], [0.0, 8.0])) == 1


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
