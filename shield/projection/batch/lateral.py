r"""Projection with the lateral bound, over many horizons at once.

A primal-dual interior point method on :math:`\min \tfrac12\|z - n\|_W^2` subject to
:math:`g(z) \le 0`, with slacks :math:`s` and multipliers :math:`y`. A step solves

.. math:: \Big(W + \sum_i y_i\nabla^2 g_i + J^\top\tfrac{Y}{S}J\Big)\Delta z =
          W(n - z) - J^\top\Big(\tfrac{\sigma\mu}{s} + \tfrac{y}{s}(g + s)\Big)

The matrix couples only steering and speed of one step and the same channel of neighbouring steps:
it is block tridiagonal with 2 × 2 blocks, and a forward and a backward sweep solve it. What has
not converged to a feasible point with vanishing complementarity is left to the caller.

References:
    J. Nocedal, S. Wright, Numerical Optimization, 2nd ed., algorithm 19.1.
"""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from shield.projection.batch.sweep import sweep
from shield.projection.repair import INWARD, Bounds

__all__ = ["LateralBatch"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_MAX_STEPS = 30
# Share of the average complementarity that the next step aims at: cautious, and after a step that
# went nearly the whole way.
_CAUTIOUS, _BOLD = 0.1, 0.01
# The start: least slack as a share of a step, complementarity as a share of a rough guess.
_PUSH, _FIRST = 0.1, 0.1
# Share of the way to the nearest bound that a step may go.
_TO_BOUNDARY = 0.9995
# Converged: average complementarity, and violation of the slack equations.
_COMPLEMENTARITY, _VIOLATION = 1e-11, 1e-10


@dataclass(slots=True)
class _Iterate:
    """Horizons still being solved; the batch is the last axis.

    Attributes:
        index: Which horizon of the batch, (B,).
        target: n, (H, 2, B).
        point: z, (H, 2, B).
        previous: Command before the first step, (2, B).
        side: Sign of the steering that the lateral row bounds, (H, B).
        scale: Length of the lateral row's gradient at the start, (H, B).
        slack: Slacks of box above, box below, rise and fall, (4, H, 2, B).
        dual: Their multipliers, (4, H, 2, B).
        lateral_slack: Slacks of the lateral rows, (H, B).
        lateral_dual: Their multipliers, (H, B).
        complementarity: Average of slack times multiplier, (B,).
        aim: Complementarity that the next step aims at, (B,).
    """

    index: NDArray[np.int64]
    target: Array
    point: Array
    previous: Array
    side: Array
    scale: Array
    slack: Array
    dual: Array
    lateral_slack: Array
    lateral_dual: Array
    complementarity: Array
    aim: Array

    def keep(self, mask: Mask) -> "_Iterate":
        """Return the iterate of some horizons."""
        return _Iterate(*(getattr(self, field.name)[..., mask] for field in fields(self)))


class LateralBatch:
    """Solver for a batch of horizons in which the lateral bound binds.

    Args:
        bounds: Limits with a lateral bound.
        weights: Weights of steering and speed.
    """

    def __init__(self, bounds: Bounds, weights: tuple[float, float]) -> None:
        assert bounds.lateral is not None
        # A little inside, so that what is left of the violation does not matter.
        self._bound = bounds.lateral * bounds.wheelbase * (INWARD - 1e-9)
        self._weights = np.array(weights)[:, None]
        side, step = bounds.max_steering, bounds.steering_step
        self._ends = np.array(
            [
                [side, bounds.max_speed],
                [side, -bounds.min_speed],
                [step, bounds.rise],
                [step, bounds.fall],
            ]
        )[:, None, :, None]
        self._unit = np.array([step, min(bounds.rise, bounds.fall)])[:, None]

    def solve(self, targets: Array, start: Array, previous: Array) -> tuple[Array, Mask]:
        """Approach the nearest horizons.

        Args:
            targets: Nominal horizons, shape (H, 2, B).
            start: Optima of G1 and G2, shape (H, 2, B).
            previous: Last executed commands, shape (2, B).

        Returns:
            Horizons (H, 2, B) and which of them are solved, (B,).
        """
        solution = start.copy()
        solved = np.zeros(start.shape[-1], dtype=bool)
        iterate = self._begin(targets, start, previous)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for _ in range(_MAX_STEPS):
                violation = self._advance(iterate)
                done = (iterate.complementarity < _COMPLEMENTARITY) & (violation < _VIOLATION)
                if done.any():
                    index = iterate.index[done]
                    solution[..., index] = iterate.point[..., done]
                    solved[index] = True
                    if done.all():
                        break
                    iterate = iterate.keep(~done)
        return solution, solved

    def _begin(self, targets: Array, start: Array, previous: Array) -> _Iterate:
        """Start at the optimum without lateral bound, pushed off the bounds."""
        steering, speed = start[:, 0], start[:, 1]
        tangent = np.tan(steering)
        along = speed * speed * (1.0 + tangent * tangent)
        # The size of a multiplier times the size of a slack.
        first = (np.abs(self._weights * (targets - start)) * self._unit).mean(axis=(0, 1))
        first = _FIRST * first + 1e-4
        slack = np.maximum(self._ends - _linear(start, previous), _PUSH * self._unit)
        iterate = _Iterate(
            index=np.arange(start.shape[-1]),
            target=targets,
            point=start.copy(),
            previous=previous,
            side=np.where(steering < 0.0, -1.0, 1.0),
            scale=np.maximum(np.hypot(along, 2.0 * speed * tangent), 1e-3),
            slack=slack,
            dual=first / slack,
            lateral_slack=np.empty(0),
            lateral_dual=np.empty(0),
            complementarity=first,
            aim=_CAUTIOUS * first,
        )
        value, _, _ = self._lateral_rows(iterate)
        iterate.lateral_slack = np.maximum(-value, 1e-3)
        iterate.lateral_dual = first / iterate.lateral_slack
        return iterate

    def _advance(self, iterate: _Iterate) -> Array:
        """Make one step in place; return the violation that it started from, (B,)."""
        slack, dual = iterate.slack, iterate.dual
        side_slack, side_dual = iterate.lateral_slack, iterate.lateral_dual
        aim = iterate.aim
        value, gradient, hessian = self._lateral_rows(iterate)
        residual = _linear(iterate.point, iterate.previous)
        residual -= self._ends
        residual += slack
        side_residual = value + side_slack
        inverse, side_inverse = 1.0 / slack, 1.0 / side_slack
        stiffness, side_stiffness = dual * inverse, side_dual * side_inverse
        push = aim * inverse + stiffness * residual
        side_push = aim * side_inverse + side_stiffness * side_residual
        force = self._weights * (iterate.target - iterate.point)
        force -= _transposed(push)
        force -= gradient * side_push[:, None]
        step = self._newton(stiffness, side_stiffness, side_dual, gradient, hessian, force)
        moved, side_moved = _linear(step, 0.0), (gradient * step).sum(axis=1)
        # Steps of slacks and multipliers with the other sign: what they lose.
        slack_loss, side_slack_loss = residual + moved, side_residual + side_moved
        dual_loss = dual - push - stiffness * moved
        side_dual_loss = side_dual - side_push - side_stiffness * side_moved
        primal = _longest(slack_loss * inverse, side_slack_loss * side_inverse)
        dual_length = _longest(dual_loss / dual, side_dual_loss / side_dual)
        iterate.point += primal * step
        slack -= primal * slack_loss
        side_slack -= primal * side_slack_loss
        dual -= dual_length * dual_loss
        side_dual -= dual_length * side_dual_loss
        total = (slack * dual).sum(axis=(0, 1, 2)) + (side_slack * side_dual).sum(axis=0)
        iterate.complementarity = np.asarray(total / (9 * len(side_slack)))
        bold = np.minimum(primal, dual_length) > 0.9
        iterate.aim = np.where(bold, _BOLD, _CAUTIOUS) * iterate.complementarity
        violation = np.abs(residual).max(axis=(0, 1, 2))
        worst: Array = np.maximum(violation, np.abs(side_residual).max(axis=0))
        return worst

    def _lateral_rows(self, iterate: _Iterate) -> tuple[Array, Array, tuple[Array, Array, Array]]:
        """Return scaled values (H, B), gradients (H, 2, B) and second derivatives of the rows."""
        steering, speed = iterate.point[:, 0], iterate.point[:, 1]
        side, inverse = iterate.side, 1.0 / iterate.scale
        tangent = np.tan(steering) * side
        square = 1.0 + tangent * tangent
        value = (speed * speed * tangent - self._bound) * inverse
        gradient = np.empty_like(iterate.point)
        gradient[:, 0] = speed * speed * square * side * inverse
        gradient[:, 1] = 2.0 * speed * tangent * inverse
        across = 2.0 * speed * square * side * inverse
        return value, gradient, (speed * tangent * across * side, across, 2.0 * tangent * inverse)

    def _newton(
        self,
        stiffness: Array,
        side_stiffness: Array,
        side_dual: Array,
        gradient: Array,
        hessian: tuple[Array, Array, Array],
        force: Array,
    ) -> Array:
        """Assemble and solve the block tridiagonal system for the step, (H, 2, B)."""
        joints = stiffness[2] + stiffness[3]
        diagonal = stiffness[0] + stiffness[1]
        diagonal += joints
        diagonal[:-1] += joints[1:]
        diagonal += self._weights
        g1, g2 = gradient[:, 0], gradient[:, 1]
        p11, p12, p22 = side_stiffness * g1 * g1, side_stiffness * g1 * g2, side_stiffness * g2 * g2
        k11, k12, k22 = (side_dual * part for part in hessian)
        # The curvature of the bound is kept where the step's own block stays convex with it.
        w1, w2 = self._weights
        b11, b12, b22 = w1 + p11 + k11, p12 + k12, w2 + p22 + k22
        convex = (b11 > 0.0) & (b11 * b22 > b12 * b12)
        diagonal[:, 0] += np.where(convex, p11 + k11, p11)
        diagonal[:, 1] += np.where(convex, p22 + k22, p22)
        return sweep(diagonal, np.where(convex, b12, p12), joints, force)


def _linear(point: Array, previous: Array | float) -> Array:
    """Return z, -z, d and -d with d the first differences of z, (4, H, 2, B)."""
    rows = np.empty((4, *point.shape))
    rows[0] = point
    rows[2] = point
    rows[2, 0] -= previous
    rows[2, 1:] -= point[:-1]
    np.negative(rows[::2], out=rows[1::2])
    return rows


def _transposed(rows: Array) -> Array:
    """Return the transpose of `_linear` applied to rows (4, H, 2, B), (H, 2, B)."""
    total: Array = rows[0] - rows[1]
    joint = rows[2] - rows[3]
    total += joint
    total[:-1] -= joint[1:]
    return total


def _longest(loss: Array, side_loss: Array) -> Array:
    """Return the share of a step, at most 1, that loses less than everything, (B,).

    Args:
        loss: What the step takes from positive values, as a share of each, (4, H, 2, B).
        side_loss: The same of the lateral rows, (H, B).
    """
    shrink = np.maximum(loss.max(axis=(0, 1, 2)), side_loss.max(axis=0))
    return np.asarray(np.minimum(1.0, _TO_BOUNDARY / np.maximum(shrink, 1e-9)))
