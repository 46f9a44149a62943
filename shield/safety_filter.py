"""The last gate before the actuators: one command at a time, tied to the last one executed."""

import time

import numpy as np
from numpy.typing import ArrayLike

from shield.errors import Array, InvalidProblem, as_array, as_horizon
from shield.limits.actuator_limits import ActuatorLimits
from shield.projection.certificate import Certificate, Projection, Status
from shield.projection.fallback import FallbackPlan
from shield.projection.projector import HorizonProjector
from shield.projection.repair import worst_excess
from shield.projection.solvers import SolverFactory

__all__ = ["SafetyFilter"]


class SafetyFilter:
    """Makes every command admissible and remembers what was executed.

    The arguments and what they raise are those of `HorizonProjector`.
    """

    def __init__(
        self,
        limits: ActuatorLimits,
        solver: str | SolverFactory = "osqp",
        *,
        weights: tuple[float, float] | None = None,
        tolerance: float = 1e-6,
        deadline: float = 0.05,
    ) -> None:
        self.limits = limits
        self._projector = HorizonProjector(
            limits, 1, solver, weights=weights, tolerance=tolerance, deadline=deadline
        )
        self._fallback = FallbackPlan(limits)
        self.reset()

    @property
    def previous(self) -> Array:
        """The last executed command [rad, m/s], shape (2,), read-only."""
        return self._previous

    def reset(self, command: ArrayLike | None = None) -> None:
        """Forget the plan and earlier problems, and set the last executed command.

        Args:
            command: The command that the actuators hold now [rad, m/s], shape (2,). None, or a
                value that is not finite: straight wheels, the speed nearest to standstill.

        Raises:
            InvalidProblem: The shape is not (2,).
        """
        rest = np.clip(np.zeros(2), self.limits.low, self.limits.high)
        values = rest if command is None else as_array("command", command, (2,))
        self._fallback.reset()
        self._projector.reset()
        self._execute(np.where(np.isfinite(values), values, rest))

    def record(self, command: ArrayLike) -> None:
        """Correct what was executed (2,) [rad, m/s], for actuators that round what they are given.

        Raises:
            InvalidProblem: The shape is not (2,), or a value is not finite.
        """
        values = as_array("command", command, (2,)).copy()
        if not np.isfinite(values).all():
            raise InvalidProblem(f"`command` must be finite. Got {values.tolist()}.")
        self._execute(values)

    @np.errstate(all="ignore")
    def filter(self, nominal: ArrayLike, plan: ArrayLike | None = None) -> Certificate:
        """Return the command to execute, and remember it as executed.

        Args:
            nominal: Command asked for [rad, m/s], shape (2,), any values.
            plan: The horizon that `nominal` is the beginning of [rad, m/s], shape (H, 2). Its
                later steps are kept for the fallback.

        Returns:
            The certificate; an admissible nominal passes bit by bit. A nominal that is not finite
            is answered with the last plan shifted by one, then by braking.

        Raises:
            InvalidProblem: A shape or a type does not fit.
        """
        begin = time.perf_counter()
        nominal_action = as_array("nominal", nominal, (2,)).copy()
        horizon = None if plan is None else as_horizon("plan", plan)
        if np.isfinite(nominal_action).all():
            projection = self._projector.project(nominal_action[None, :], self._previous)
        else:
            projection = self._follow_fallback(nominal_action)
        if horizon is None:
            self._fallback.advance()
        else:
            self._fallback.remember(horizon)
        self._execute(projection.actions[0].copy())
        nominal_action.flags.writeable = False
        return Certificate(
            nominal_action=nominal_action,
            safe_action=self._previous,
            status=projection.status,
            reason=projection.reason,
            correction=projection.correction[0],
            max_violation=projection.max_violation,
            solve_time=time.perf_counter() - begin,
            intervened=projection.status is not Status.NOMINAL,
        )

    def _follow_fallback(self, nominal_action: Array) -> Projection:
        """Return the first command of the fallback as a projection."""
        steering, speed = self._previous.tolist()
        commands, what = self._fallback.horizon(steering, speed, 1)
        actions = self._projector.project(np.array([commands]), self._previous).actions
        return Projection(
            actions,
            Status.FALLBACK,
            actions - np.where(np.isfinite(nominal_action), nominal_action, np.nan),
            worst_excess(self.limits, actions.ravel().tolist(), steering, speed),
            0.0,
            f"nominal {nominal_action.tolist()} is not finite: {what}",
        )

    def _execute(self, command: Array) -> None:
        command.flags.writeable = False
        self._previous = command
