"""G4 when the solver fails: every kind of failure ends in an admissible horizon."""

import multiprocessing
import os
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import osqp
import pytest
from qpsolvers.exceptions import SolverError
from scipy import sparse

from shield import (
    UNBOUNDED,
    ActuatorLimits,
    HorizonProjector,
    Projection,
    Rows,
    SafetyFilter,
    Status,
)
from shield.projection.solvers import Answer, OsqpSolver, Program, QpsolversSolver
from tests.shield.oracles import broken_bounds
from tests.shield.strategies import CITY, LINEAR, Array

PREVIOUS = np.array([0.08, 9.0])
# Of tests that are not about deadlines: so long that a busy machine does not decide.
PATIENT = 5.0
WISH = np.column_stack([np.linspace(0.1, 0.5, 8), np.linspace(9.0, 13.0, 8)])


def assert_safe(got: Projection, limits: Any = CITY) -> None:
    """The horizon is admissible and does not claim to be the nearest."""
    assert broken_bounds(limits, got.actions, PREVIOUS) == []
    assert got.status is Status.REPAIRED
    assert got.reason


class Scripted:
    """A solver that does as it is told."""

    def __init__(self, answer: Callable[[Array, int], Answer]) -> None:
        self._answer = answer

    def __call__(self, weights: Array, *_: Any) -> "Scripted":
        """Be its own factory."""
        return self

    def solve(self, program: Program, *, fine: bool = False) -> Answer:
        """Answer from the script."""
        return self._answer(program.q, len(program.lower))

    def reset(self) -> None:
        """Nothing to forget."""


def _raise(error: Exception) -> Any:
    raise error


@pytest.mark.parametrize(
    "answer",
    [
        lambda n, m: Answer(None, None, "gave up"),
        lambda n, m: Answer(np.full(n, 1e6), np.zeros(m), ""),
        lambda n, m: Answer(np.zeros(n), np.zeros(m), "stopped early"),
        lambda n, m: Answer(np.zeros(n), None, ""),
        lambda n, m: Answer(np.random.default_rng(0).normal(0.0, 50.0, n), np.ones(m), ""),
    ],
    ids=["none", "far", "early", "no multipliers", "random"],
)
def test_a_lying_solver_is_not_believed(answer: Callable[[int, int], Answer]) -> None:
    """Garbage labelled as solved does not reach the actuators, and the status tells."""
    for limits in (CITY, LINEAR):
        solver = Scripted(lambda q, m: answer(len(q), m))
        target = HorizonProjector(limits, 8, solver=solver, deadline=PATIENT)
        assert_safe(target.project(WISH, PREVIOUS), limits)


def test_an_exact_optimum_is_projected_whoever_found_it() -> None:
    """A solver without answer, but the repaired wish is the nearest: its multipliers prove it."""
    solver = Scripted(lambda q, m: Answer(None, None, "gave up"))
    wish = np.tile([0.0, 13.0], (4, 1))
    exact = HorizonProjector(LINEAR, 4, deadline=PATIENT).project(wish, [0.0, 11.9])
    got = HorizonProjector(LINEAR, 4, solver=solver, deadline=PATIENT).project(wish, [0.0, 11.9])
    assert got.actions == pytest.approx(exact.actions, abs=1e-12)
    assert got.status is exact.status is Status.PROJECTED


@pytest.mark.parametrize("error", [AttributeError, TypeError, RuntimeError, ZeroDivisionError])
def test_a_programming_error_surfaces(error: type[Exception]) -> None:
    """In a solver, and in the factory of one."""
    solver = Scripted(lambda *_: _raise(error("boom")))
    target = HorizonProjector(CITY, 8, solver=solver, deadline=PATIENT)
    with pytest.raises(error, match="boom"):
        target.project(WISH, PREVIOUS)
    with pytest.raises(error, match="boom"):
        HorizonProjector(CITY, 8, solver=lambda *_: _raise(error("boom")))


@pytest.mark.parametrize("limits", [CITY, LINEAR], ids=["lateral", "linear"])
def test_a_failing_osqp_costs_one_call(limits: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """What it raises itself leads to the repaired wish; once mended, all is as before."""
    target = HorizonProjector(limits, 8, deadline=PATIENT)
    healthy = target.project(WISH, PREVIOUS)
    with monkeypatch.context() as patch:
        patch.setattr(osqp.OSQP, "solve", lambda *_, **__: _raise(osqp.OSQPException(4)))
        for _ in range(2):
            got = target.project(WISH, PREVIOUS)
            assert_safe(got, limits)
            assert "osqp failed" in got.reason
    again = target.project(WISH, PREVIOUS)
    assert again.status is healthy.status is Status.PROJECTED
    assert again.actions == pytest.approx(healthy.actions, abs=1e-6)


def test_a_failing_solver_of_qpsolvers_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its own exceptions, not those of a mistake."""
    pytest.importorskip("daqp")
    target = HorizonProjector(LINEAR, 8, solver="daqp", deadline=PATIENT)
    with monkeypatch.context() as patch:
        patch.setattr("qpsolvers.solve_problem", lambda *_, **__: _raise(SolverError("broken")))
        got = target.project(WISH, PREVIOUS)
        assert_safe(got, LINEAR)
        assert "SolverError: broken" in got.reason
    assert target.project(WISH, PREVIOUS).status is Status.PROJECTED


@pytest.mark.parametrize("status", ["interrupted", "maximum iterations reached", "unsolved"])
@pytest.mark.parametrize("z", [np.full(16, np.nan), np.zeros(16)], ids=["nan", "zero"])
def test_an_osqp_that_does_not_finish_is_reported(
    status: str, z: Array, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Interrupted, out of iterations, without an iterate."""
    target = HorizonProjector(CITY, 8, deadline=PATIENT)
    result = SimpleNamespace(x=z, y=np.zeros(40), info=SimpleNamespace(status=status))
    monkeypatch.setattr(osqp.OSQP, "solve", lambda *_, **__: result)
    got = target.project(WISH, PREVIOUS)
    assert_safe(got)
    assert status in got.reason


def test_osqp_is_set_up_by_resets_and_not_in_a_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """Once for each episode; the control loop does not wait for it."""
    target = HorizonProjector(CITY, 8, deadline=PATIENT)
    set_up, setups = osqp.OSQP.setup, 0

    def counted(self: osqp.OSQP, *args: Any, **settings: Any) -> None:
        nonlocal setups
        setups += 1
        set_up(self, *args, **settings)

    monkeypatch.setattr(osqp.OSQP, "setup", counted)
    counts = []
    for _ in range(2):
        target.project(WISH, PREVIOUS)
        counts.append(setups)
        target.reset()
        target.reset()
        counts.append(setups)
    assert counts == [0, 1, 1, 2]


def test_the_filter_survives_a_failing_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    """A whole episode with a dead solver stays admissible."""
    monkeypatch.setattr(osqp.OSQP, "solve", lambda *_, **__: _raise(osqp.OSQPException(4)))
    shield = SafetyFilter(CITY)
    shield.reset([0.05, 9.0])
    last = shield.previous
    for angle in np.linspace(0.0, 0.5, 40):
        certificate = shield.filter([angle, 13.0])
        assert broken_bounds(CITY, [certificate.safe_action], last) == []
        last = certificate.safe_action


def test_osqp_recovers_from_nan() -> None:
    """A problem full of NaN does not poison the next one."""
    solver = OsqpSolver(np.ones(2), sparse.identity(2, format="csc"), 1.0)
    low, high = np.zeros(2), np.ones(2)
    assert solver.solve(Program(np.full(2, np.nan), low, high)).z is None
    answer = solver.solve(Program(np.full(2, -1.5), low, high))
    assert answer.reason == ""
    assert answer.z == pytest.approx([1.0, 1.0], abs=1e-6)
    assert answer.y == pytest.approx([0.5, 0.5], abs=1e-6)


class MisledByWarmStarts(OsqpSolver):
    """OSQP whose answers miss the optimum a little until it is reset."""

    error = 1e-2  # [steps]

    def reset(self) -> None:
        """From now on exact."""
        super().reset()
        self.error = 0.0

    def solve(self, program: Program, *, fine: bool = False) -> Answer:
        """Miss by `error`."""
        answer = super().solve(program, fine=fine)
        assert answer.z is not None
        return answer._replace(z=answer.z + self.error)


def test_an_optimum_that_a_warm_start_misses_is_projected_from_a_cold_one() -> None:
    """The third program is the second once more, by a solver that has forgotten the last call."""
    misled = HorizonProjector(LINEAR, 8, MisledByWarmStarts, deadline=PATIENT)
    exact = HorizonProjector(LINEAR, 8, deadline=PATIENT).project(WISH, PREVIOUS)
    got = misled.project(WISH, PREVIOUS)
    assert got.status is exact.status is Status.PROJECTED
    assert np.allclose(got.actions, exact.actions, rtol=0.0, atol=1e-9)


def test_a_step_size_that_ran_to_its_bound_does_not_cost_the_optimum() -> None:
    """OSQP's adaptation may never come back from there: then the step size is fixed."""
    limits = ActuatorLimits(
        dt=0.05,
        max_steering=0.05,
        max_steering_rate=1.01,
        min_speed=0.0,
        max_speed=0.0,
        max_acceleration=7.7,
        max_deceleration=0.01,
        max_lateral_acceleration=None,
    )
    target = HorizonProjector(limits, 2, deadline=PATIENT)
    got = target.project([[0.004, -0.86], [-0.99, -0.45]], [0.0, 0.0])
    assert got.status is Status.PROJECTED


@pytest.mark.parametrize("name", ["daqp", "quadprog", "clarabel", "piqp"])
def test_solvers_of_qpsolvers_give_the_multipliers_of_osqp(
    name: str, rng: np.random.Generator
) -> None:
    """The signs of the rows' multipliers are those that the duality gap takes."""
    pytest.importorskip(name)
    matrix = sparse.csc_matrix(np.vstack([np.eye(3), rng.normal(size=(2, 3))]))
    low, high, q = np.full(5, -0.5), np.full(5, 0.7), 3.0 * rng.normal(size=3)
    ours = OsqpSolver(np.ones(3), matrix, PATIENT).solve(Program(q, low, high))
    other = QpsolversSolver(name, np.ones(3), matrix, PATIENT).solve(Program(q, low, high))
    assert ours.z == pytest.approx(other.z, abs=1e-5)
    assert ours.y == pytest.approx(other.y, abs=1e-4)


@pytest.mark.parametrize("horizon", [8, 100, 200, 500])
def test_the_deadline_bounds_the_whole_call_whatever_the_horizon(
    horizon: int, rng: np.random.Generator
) -> None:
    """Processor time, so that other work on the machine does not count; half of it for luck."""
    deadline = 0.05
    target = HorizonProjector(CITY, horizon, deadline=deadline)
    for _ in range(4):
        last = np.array([rng.uniform(-0.05, 0.05), rng.uniform(0.0, 12.0)])
        wish = last + np.cumsum(rng.normal(0.0, [0.1, 0.5], (horizon, 2)), axis=0)
        begin = time.thread_time()
        got = target.project(wish, last)
        assert time.thread_time() - begin < 1.5 * deadline
        assert broken_bounds(CITY, got.actions, last) == []


def test_dense_rows_of_the_callers_do_not_cost_the_deadline(rng: np.random.Generator) -> None:
    """Of a matrix (500, 1000) only its 500 entries reach the solver."""

    class SpeedLimit:
        def rows(self, actions: Array, previous: Array) -> Rows:
            matrix = np.eye(actions.size)[1::2]
            return Rows(matrix, np.full(500, -UNBOUNDED), np.full(500, 11.0))

    target = HorizonProjector(CITY, 500, constraints=[SpeedLimit()], deadline=0.05)
    for _ in range(4):
        wish = PREVIOUS + np.cumsum(rng.normal(0.0, [0.1, 0.5], (500, 2)), axis=0)
        begin = time.thread_time()
        target.project(wish, PREVIOUS)
        assert time.thread_time() - begin < 0.075


def test_osqp_stops_at_a_deadline_of_a_microsecond() -> None:
    """What it leaves is repaired and reported."""
    target = HorizonProjector(CITY, 64, deadline=1e-6)
    got = target.project(np.tile([0.5, 13.0], (64, 1)), PREVIOUS)
    assert_safe(got)
    assert "deadline" in got.reason


def test_proxqp_gives_up_on_problems_that_it_would_work_on_for_seconds() -> None:
    """It holds Python's lock, so nothing else could stop it."""
    pytest.importorskip("proxsuite")
    rng = np.random.default_rng(0)
    for _ in range(20):
        limits = replace(LINEAR, dt=1e-3, max_steering_rate=10.0 ** rng.uniform(-9.0, -6.0))
        target = HorizonProjector(limits, 16, solver="proxqp", deadline=PATIENT)
        begin = time.process_time()
        got = target.project(rng.normal(0.0, 1e3, (16, 2)), [0.0, 5.0])
        assert time.process_time() - begin < 1.0
        assert broken_bounds(limits, got.actions, np.array([0.0, 5.0])) == []


@pytest.mark.parametrize("solver", ["osqp", "daqp", "clarabel"])
def test_a_projector_works_in_a_forked_process(solver: str) -> None:
    """There is no thread that a fork could lose."""
    if solver != "osqp":
        pytest.importorskip(solver)
    if "fork" not in multiprocessing.get_all_start_methods():
        pytest.skip("no fork on this system")
    target = HorizonProjector(CITY, 8, solver, deadline=PATIENT)
    parent = target.project(WISH, PREVIOUS)
    before = threading.active_count()
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        answers = [target.project(WISH, PREVIOUS) for _ in range(3)]
        os.write(write, " ".join(answer.status.value for answer in answers).encode())
        os._exit(0)
    os.waitpid(child, 0)
    assert os.read(read, 1000).decode().split() == [parent.status.value] * 3
    assert threading.active_count() == before
