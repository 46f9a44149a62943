"""Independent answers: exact arithmetic, other solvers, IPOPT."""

import math
from fractions import Fraction
from functools import lru_cache
from typing import Any

import casadi
import mpmath
import numpy as np
import pytest
import qpsolvers
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from shield import ActuatorLimits

Array = NDArray[np.float64]
DIGITS = 50
SOLVERS = [
    name
    for name in ("quadprog", "daqp", "piqp", "proxqp", "clarabel")
    if name in qpsolvers.available_solvers
]


def broken_bounds(limits: ActuatorLimits, actions: ArrayLike, previous: ArrayLike) -> list[str]:
    """Return which bounds a horizon breaks at which step, in exact and 50-digit arithmetic.

    Args:
        limits: Limits.
        actions: Commands, shape (H, 2).
        previous: Last executed command, shape (2,).
    """
    broken = []
    last = [Fraction(float(value)) for value in np.asarray(previous)]
    turn = Fraction(limits.max_steering_rate * limits.dt)
    rise = Fraction(limits.max_acceleration * limits.dt)
    fall = Fraction(limits.max_deceleration * limits.dt)
    side = Fraction(limits.max_steering)
    for step, (steering, speed) in enumerate(np.asarray(actions)):
        delta, v = Fraction(float(steering)), Fraction(float(speed))
        if not -side <= delta <= side:
            broken.append(f"box steering {step}")
        if not Fraction(limits.min_speed) <= v <= Fraction(limits.max_speed):
            broken.append(f"box speed {step}")
        if abs(delta - last[0]) > turn:
            broken.append(f"rate steering {step}")
        if not -fall <= v - last[1] <= rise:
            broken.append(f"rate speed {step}")
        if exceeds_lateral(limits, float(steering), float(speed)):
            broken.append(f"lateral {step}")
        last = [delta, v]
    return broken


def exceeds_lateral(limits: ActuatorLimits, steering: float, speed: float) -> bool:
    """Tell whether a command breaks G3, with 50 digits where float64 cannot tell."""
    bound = limits.max_lateral_acceleration
    if bound is None:
        return False
    rounded = abs(speed * speed * math.tan(steering) / limits.wheelbase)
    if abs(rounded - bound) > 1e-9 * bound:  # a million roundings apart; not so for NaN
        return rounded > bound
    with mpmath.workdps(DIGITS):
        tangent = mpmath.tan(mpmath.mpf(steering))
        lateral = mpmath.mpf(speed) ** 2 * tangent / mpmath.mpf(limits.wheelbase)
        return bool(abs(lateral) > mpmath.mpf(bound))


def objective(limits: ActuatorLimits, actions: Array, nominal: Array) -> float:
    """Return half the squared distance of two horizons, in steps of the actuators."""
    rates = limits.max_steering_rate, max(limits.max_acceleration, limits.max_deceleration)
    difference = (actions - nominal) / (np.array(rates) * limits.dt)
    return 0.5 * float(np.sum(difference**2))


def best_objective(limits: ActuatorLimits, nominal: Array, previous: Array) -> float:
    """Return the least objective of G1 and G2 that independent solvers find."""
    if len(SOLVERS) < 3:
        pytest.skip("needs three of quadprog, daqp, piqp, proxsuite and clarabel: the test extra")
    problem = quadratic_program(limits, nominal, previous)
    objectives = []
    for name in SOLVERS:
        if name == "clarabel":
            problem.P, problem.G = sparse.csc_matrix(problem.P), sparse.csc_matrix(problem.G)
        solution = qpsolvers.solve_problem(problem, solver=name)
        if solution.found and solution.primal_residual() < 1e-8:
            objectives.append(objective(limits, solution.x.reshape(-1, 2), nominal))
    assert len(objectives) >= 3, f"only {len(objectives)} solvers answered"
    return min(objectives)


def quadratic_program(limits: ActuatorLimits, nominal: Array, previous: Array) -> qpsolvers.Problem:
    """Return the projection onto G1 and G2, written without `shield.limits`; any weights do."""
    size = nominal.size
    rows, bounds = [], []
    for index in range(size):
        row = np.zeros(size)
        row[index] = 1.0
        last = previous[index % 2]
        if index >= 2:
            row[index - 2] = -1.0
            last = 0.0
        rate = limits.max_steering_rate if index % 2 == 0 else limits.max_acceleration
        brake = limits.max_steering_rate if index % 2 == 0 else limits.max_deceleration
        rows += [row, -row]
        bounds += [rate * limits.dt + last, brake * limits.dt - last]
    repeat = size // 2
    return qpsolvers.Problem(
        np.eye(size),
        -nominal.ravel(),
        np.array(rows),
        np.array(bounds),
        lb=np.tile(limits.low, repeat),
        ub=np.tile(limits.high, repeat),
    )


@lru_cache(maxsize=16)
def _nonlinear_solver(limits: ActuatorLimits, horizon: int) -> Any:
    z, p = casadi.SX.sym("z", 2 * horizon), casadi.SX.sym("p", 2 * horizon + 2)
    rows = []
    for t in range(horizon):
        for channel in range(2):
            last = z[2 * t - 2 + channel] if t else p[2 * horizon + channel]
            rows.append(z[2 * t + channel] - last)
    for t in range(horizon):
        rows.append(z[2 * t + 1] ** 2 * casadi.tan(z[2 * t]) / limits.wheelbase)
    program = {
        "x": z,
        "p": p,
        "f": 0.5 * casadi.sumsqr((z - p[: 2 * horizon]) / np.tile(limits.step, horizon)),
        "g": casadi.vertcat(*rows),
    }
    options = {
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "print_time": 0,
        "ipopt.tol": 1e-10,
        "ipopt.bound_relax_factor": 0.0,
    }
    return casadi.nlpsol("ipopt", "ipopt", program, options)


def ipopt_objective(
    limits: ActuatorLimits, nominal: Array, previous: Array, start: Array
) -> float | None:
    """Return IPOPT's local optimum of G1, G2 and G3 from a start, None if it fails."""
    horizon = len(nominal)
    solver = _nonlinear_solver(limits, horizon)
    bound = limits.max_lateral_acceleration
    assert bound is not None
    result = solver(
        x0=start.ravel(),
        p=np.concatenate([nominal.ravel(), previous]),
        lbx=np.tile(limits.low, horizon),
        ubx=np.tile(limits.high, horizon),
        lbg=np.concatenate([np.tile(-limits.max_decrease, horizon), np.full(horizon, -bound)]),
        ubg=np.concatenate([np.tile(limits.max_increase, horizon), np.full(horizon, bound)]),
    )
    return float(result["f"]) if solver.stats()["success"] else None
