"""G4 when the solver fails: every kind of failure ends in an admissible horizon."""

import gc
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import osqp
import pytest
from scipy import sparse

from shield import HorizonProjector, InvalidProblem, Projection, SafetyFilter, Status
from shield.projection.solvers import FAILURES, Answer, DeadlineSolver, OsqpSolver
from tests.shield.oracles import broken_bounds
from tests.shield.strategies import CITY, LINEAR, Array

PREVIOUS = np.array([0.08, 9.0])
# Of tests that are not about deadlines: so long that a busy machine does not decide.
PATIENT = 5.0
WISH = np.column_stack([np.linspace(0.1, 0.5, 8), np.linspace(9.0, 13.0, 8)])


def assert_safe(got: Projection) -> None:
    """The horizon is admissible and does not claim to be the nearest."""
    assert broken_bounds(CITY, got.actions, PREVIOUS) == []
    assert got.status in (Status.REPAIRED, Status.FALLBACK)
    assert got.reason


class Scripted:
    """A solver that does as it is told."""

    def __init__(self, answer: Callable[[Array], Answer]) -> None:
        self._answer = answer

    def __call__(self, weights: Array, *_: Any) -> "Scripted":
        """Be its own factory."""
        return self

    def solve(self, q: Array, lower: Array, upper: Array, matrix: Any = None) -> Answer:
        """Answer from the script."""
        return self._answer(q)


def _raise(error: Exception) -> Any:
    raise error


@pytest.mark.parametrize("kind", FAILURES, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("limits", [CITY, LINEAR], ids=["lateral", "linear"])
def test_a_raising_solver_leads_to_the_fallback(kind: type[Exception], limits: Any) -> None:
    """Whatever it raises, its own exception included."""
    target = HorizonProjector(
        limits, 8, solver=Scripted(lambda q: _raise(kind("boom"))), deadline=PATIENT
    )
    got = target.project(WISH, PREVIOUS)
    assert broken_bounds(limits, got.actions, PREVIOUS) == []
    assert got.status is Status.FALLBACK
    assert kind.__name__ in got.reason


@pytest.mark.parametrize(
    "answer",
    [
        lambda q: (None, "gave up"),
        lambda q: (np.full(q.size, np.nan), ""),
        lambda q: (np.full(q.size, np.inf), ""),
        lambda q: (np.full(q.size, 1e6), ""),
        lambda q: (np.zeros(q.size), "stopped early"),
        lambda q: (np.random.default_rng(0).normal(0.0, 50.0, q.size), ""),
    ],
    ids=["none", "nan", "inf", "far", "early", "random"],
)
def test_a_lying_solver_is_not_believed(answer: Callable[[Array], Answer]) -> None:
    """Garbage labelled as solved does not reach the actuators, and the status tells."""
    for limits in (CITY, LINEAR):
        got = HorizonProjector(limits, 8, solver=Scripted(answer), deadline=PATIENT).project(
            WISH, PREVIOUS
        )
        assert broken_bounds(limits, got.actions, PREVIOUS) == []
        assert got.status in (Status.REPAIRED, Status.FALLBACK), limits
        assert got.reason


@pytest.mark.parametrize(
    "answer",
    [None, "text", 3, ("a", "b"), (np.zeros(3), ""), (np.zeros(16), None), (1j * np.ones(16), "")],
    ids=str,
)
def test_an_answer_of_the_wrong_type_is_none(answer: Any) -> None:
    """A solver that breaks its contract costs the optimum, not the loop."""
    target = HorizonProjector(CITY, 8, solver=Scripted(lambda _: answer), deadline=PATIENT)
    got = target.project(WISH, PREVIOUS)
    assert_safe(got)
    assert "answer" in got.reason


def test_an_exception_nobody_knows_ends_a_thread_and_not_the_loop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Call after call, and a solver that comes to its senses is used again."""

    class Surprise(Exception):  # noqa: N818 -- a name for the reason
        pass

    ended: list[Any] = []
    monkeypatch.setattr(threading, "excepthook", ended.append)
    script: list[Callable[[Array], Answer]] = [lambda _: _raise(Surprise("!"))]
    target = HorizonProjector(LINEAR, 8, solver=Scripted(lambda q: script[0](q)), deadline=PATIENT)
    for _ in range(3):
        got = target.project(WISH, PREVIOUS)
        assert broken_bounds(LINEAR, got.actions, PREVIOUS) == []
        assert got.status is Status.FALLBACK
        assert "exception of its own" in got.reason
    assert [item.exc_type for item in ended] == [Surprise] * 3
    script[0] = lambda q: (-q, "")
    assert "exception" not in target.project(WISH, PREVIOUS).reason


def test_a_factory_that_fails_raises_at_once() -> None:
    """Naming the argument."""
    with pytest.raises(InvalidProblem, match=r"`solver`.*ZeroDivisionError"):
        HorizonProjector(CITY, 8, solver=lambda *_: 1 / 0)  # type: ignore[arg-type]


def test_a_batch_with_a_slow_solver_shares_a_deadline() -> None:
    """Sixty-four horizons return within one deadline, though each alone would nearly need it."""

    def slow(q: Array) -> Answer:
        time.sleep(0.16)
        return q, ""

    target = HorizonProjector(LINEAR, 8, solver=Scripted(slow), deadline=0.5)
    # From an inadmissible command, so that every horizon is left to the solver.
    begin = time.perf_counter()
    got = target.project_batch(np.tile(WISH, (64, 1, 1)), [0.5, 14.0])
    assert time.perf_counter() - begin < 0.5
    assert set(got.status) == {Status.FALLBACK}
    assert "stopped at the deadline" in got.reason[-1]
    assert "stopped at the deadline" not in got.reason[0]


def test_a_slow_solver_is_left_behind_at_the_deadline() -> None:
    """The call returns in time, also while the solver is still busy, and recovers afterwards."""
    pause = [1.0]

    def slow(q: Array) -> Answer:
        time.sleep(pause[0])
        return q, ""

    target = HorizonProjector(LINEAR, 8, solver=Scripted(slow), deadline=0.5)
    for _ in range(3):
        begin = time.perf_counter()
        got = target.project(WISH, PREVIOUS)
        assert time.perf_counter() - begin < 0.5
        assert broken_bounds(LINEAR, got.actions, PREVIOUS) == []
        assert got.status is Status.FALLBACK
        assert "deadline" in got.reason
    pause[0] = 0.0
    time.sleep(1.2)
    assert "deadline" not in target.project(WISH, PREVIOUS).reason


def test_the_thread_of_a_solver_ends_with_its_projector() -> None:
    """Projectors that come and go leave no threads behind."""
    before = threading.active_count()
    for _ in range(20):
        target = HorizonProjector(CITY, 8, solver=Scripted(lambda q: (-q, "")), deadline=PATIENT)
        assert_safe(target.project(WISH, PREVIOUS))
    del target
    gc.collect()
    end = time.perf_counter() + PATIENT
    while threading.active_count() > before and time.perf_counter() < end:
        time.sleep(0.01)
    assert threading.active_count() <= before


def test_a_system_without_threads_does_not_end_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """What cannot be watched is not run, and the loop goes on."""
    target = HorizonProjector(CITY, 8, solver=Scripted(lambda q: (-q, "")), deadline=PATIENT)
    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", lambda _: _raise(RuntimeError("no more")))
        got = target.project(WISH, PREVIOUS)
        assert_safe(got)
        assert "no thread" in got.reason
    assert "no thread" not in target.project(WISH, PREVIOUS).reason


def test_proxqp_gives_up_on_problems_that_it_would_work_on_for_seconds() -> None:
    """It holds Python's lock, so nobody else could stop it."""
    pytest.importorskip("proxsuite")
    rng = np.random.default_rng(0)
    for _ in range(20):
        limits = replace(LINEAR, dt=1e-3, max_steering_rate=10.0 ** rng.uniform(-9.0, -6.0))
        target = HorizonProjector(limits, 16, solver="proxqp", deadline=PATIENT)
        begin = time.process_time()
        got = target.project(rng.normal(0.0, 1e3, (16, 2)), [0.0, 5.0])
        assert time.process_time() - begin < 0.5
        assert broken_bounds(limits, got.actions, np.array([0.0, 5.0])) == []


def test_osqp_stops_at_a_deadline_of_a_microsecond() -> None:
    """OSQP watches its own time; what it leaves is repaired and reported."""
    target = HorizonProjector(CITY, 64, deadline=1e-6)
    wish = np.tile([0.5, 13.0], (64, 1))
    assert_safe_long = target.project(wish, PREVIOUS)
    assert broken_bounds(CITY, assert_safe_long.actions, PREVIOUS) == []
    assert assert_safe_long.status in (Status.REPAIRED, Status.FALLBACK)
    assert assert_safe_long.reason


def test_a_failing_osqp_costs_one_call(monkeypatch: pytest.MonkeyPatch) -> None:
    """Broken from outside it leads to the fallback; once mended, all is as before."""
    target = HorizonProjector(CITY, 8, deadline=PATIENT)
    healthy = target.project(WISH, PREVIOUS)
    with monkeypatch.context() as patch:
        patch.setattr(osqp.OSQP, "solve", lambda *_, **__: _raise(RuntimeError("killed")))
        got = target.project(WISH, PREVIOUS)
        assert_safe(got)
        assert got.status is Status.FALLBACK
        assert "killed" in got.reason
        assert_safe(target.project(WISH, PREVIOUS))
    again = target.project(WISH, PREVIOUS)
    assert again.status is healthy.status
    assert again.actions == pytest.approx(healthy.actions, abs=1e-9)


@pytest.mark.parametrize("status", ["interrupted", "maximum iterations reached", "unsolved"])
@pytest.mark.parametrize("x", [None, np.full(16, np.nan), np.zeros(3), np.zeros(16), "wrong"])
def test_an_osqp_that_does_not_finish_is_reported(
    status: str, x: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Interrupted, out of iterations, without an iterate, with one of the wrong shape."""
    target = HorizonProjector(CITY, 8, deadline=PATIENT)
    result = SimpleNamespace(x=x, info=SimpleNamespace(status=status))
    monkeypatch.setattr(osqp.OSQP, "solve", lambda *_, **__: result)
    assert_safe(target.project(WISH, PREVIOUS))


def test_an_osqp_that_cannot_be_rebuilt_does_not_end_the_loop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Even `setup` may fail, call after call."""
    target = HorizonProjector(CITY, 8, deadline=PATIENT)
    monkeypatch.setattr(osqp.OSQP, "solve", lambda *_, **__: _raise(ValueError("broken")))
    monkeypatch.setattr(osqp.OSQP, "setup", lambda *_, **__: _raise(MemoryError("none left")))
    for _ in range(3):
        target.reset()
        assert_safe(target.project(WISH, PREVIOUS))


def test_osqp_is_set_up_by_resets_and_not_in_a_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """Once for each episode; the control loop does not wait for it."""
    shield = SafetyFilter(LINEAR, deadline=PATIENT)
    set_up, setups = osqp.OSQP.setup, 0

    def counted(self: osqp.OSQP, *args: Any, **settings: Any) -> None:
        nonlocal setups
        setups += 1
        set_up(self, *args, **settings)

    monkeypatch.setattr(osqp.OSQP, "setup", counted)
    counts = []
    for _ in range(2):
        shield.filter([0.5, 9.0])
        counts.append(setups)
        shield.reset()
        shield.reset()
        counts.append(setups)
    assert counts == [0, 1, 1, 2]


def test_the_filter_survives_a_failing_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    """A whole episode with a dead solver stays admissible."""
    monkeypatch.setattr(osqp.OSQP, "solve", lambda *_, **__: _raise(RuntimeError("dead")))
    shield = SafetyFilter(CITY)
    shield.reset([0.05, 9.0])
    last = shield.previous
    for angle in np.linspace(0.0, 0.5, 40):
        certificate = shield.filter([angle, 13.0])
        assert broken_bounds(CITY, [certificate.safe_action], last) == []
        last = certificate.safe_action


def test_osqp_keeps_its_workspace_and_recovers_from_nan() -> None:
    """A problem full of NaN does not poison the next one."""
    solver = OsqpSolver(np.ones(2), sparse.identity(2, format="csc"), 1e-8, 1.0)
    low, high = np.zeros(2), np.ones(2)
    assert solver.solve(np.full(2, np.nan), low, high)[0] is None
    answer, reason = solver.solve(np.full(2, -0.5), low, high)
    assert reason == ""
    assert answer == pytest.approx([0.5, 0.5], abs=1e-6)


def test_the_deadline_solver_hands_over_copies() -> None:
    """A late solver must not read what the next problem writes."""
    seen: list[Array] = []

    def remember(q: Array) -> Answer:
        seen.append(q)
        return q, ""

    solver = DeadlineSolver(Scripted(remember), 1.0)
    q = np.ones(2)
    solver.solve(q, q, q, q)
    q[:] = 7.0
    assert seen[0].tolist() == [1.0, 1.0]
