"""What is written down of every plan: the raw material of the numbers about the planner."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from irl_dal.planner import Plan
from shield import Status

__all__ = ["PlanLog"]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PlanLog:
    """P plans of H commands, N candidates each, as read-only arrays.

    Attributes:
        previous: Command executed before each plan (P, 2) [rad, m/s].
        nominal: The last estimate before its projection (P, H, 2) [rad, m/s].
        actions: The plan handed over (P, H, 2) [rad, m/s].
        candidates: All candidates of each plan (P, N, H, 2) [rad, m/s].
        energy: Of the last estimate before its guidance step, before its projection, and of the
            plan (P, 3); NaN where it is not known.
        latency: Duration of each plan (P,) [s].
        changed: The projection changed the plan, or there was no plan to project (P,).
        fallback: There was no usable sample (P,).
    """

    previous: Array
    nominal: Array
    actions: Array
    candidates: Array
    energy: Array
    latency: Array
    changed: NDArray[np.bool_]
    fallback: NDArray[np.bool_]

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for entry in fields(self):
            getattr(self, entry.name).flags.writeable = False

    def __len__(self) -> int:
        """Number of plans P."""
        return len(self.latency)

    @classmethod
    def of(cls, plans: Sequence[Plan], previous: Sequence[Array]) -> PlanLog:
        """The log of some plans.

        Args:
            plans: Plans of one horizon, in their order; fallbacks have a single candidate, which
                is repeated.
            previous: Command executed before each (2,) [rad, m/s].
        """
        if not plans:
            return cls.empty()
        most = max(len(plan.candidates) for plan in plans)
        return cls(
            previous=np.stack([np.asarray(command, np.float64) for command in previous]),
            nominal=np.stack([plan.nominal for plan in plans]),
            actions=np.stack([plan.actions for plan in plans]),
            candidates=np.stack(
                [np.resize(plan.candidates, (most, *plan.actions.shape)) for plan in plans]
            ),
            energy=np.array([[p.energy_unguided, p.energy_nominal, p.energy] for p in plans]),
            latency=np.array([plan.latency for plan in plans]),
            changed=np.array([plan.status != Status.NOMINAL for plan in plans], np.bool_),
            fallback=np.array([plan.is_fallback for plan in plans], np.bool_),
        )

    @classmethod
    def empty(cls) -> PlanLog:
        """No plan at all."""
        return cls(
            previous=np.empty((0, 2)),
            nominal=np.empty((0, 0, 2)),
            actions=np.empty((0, 0, 2)),
            candidates=np.empty((0, 1, 0, 2)),
            energy=np.empty((0, 3)),
            latency=np.empty(0),
            changed=np.empty(0, np.bool_),
            fallback=np.empty(0, np.bool_),
        )
