"""What a shield hands back: the command, and how far it can be trusted."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["BatchProjection", "Certificate", "Projection", "Status"]


class Status(StrEnum):
    """How an answer came about, from untouched to emergency.

    Attributes:
        NOMINAL: The nominal commands were admissible and come back bit by bit.
        PROJECTED: The nearest admissible commands; the solver's answer needed no more than its
            own tolerance of repair.
        REPAIRED: Admissible, but the solver stopped early or its answer broke a bound by more than
            its tolerance, so a nearer answer may exist.
        FALLBACK: The nominal commands or the solver gave nothing to go on, or the previous command
            was such that no answer keeps every bound.
    """

    NOMINAL = "nominal"
    PROJECTED = "projected"
    REPAIRED = "repaired"
    FALLBACK = "fallback"


@dataclass(frozen=True, slots=True)
class Projection:
    """An admissible horizon.

    Attributes:
        actions: Commands [rad, m/s], shape (H, 2), read-only.
        status: How it came about.
        correction: ``actions - nominal`` [rad, m/s], shape (H, 2), read-only; not
            finite where the nominal is not.
        max_violation: Largest violation found by the independent check, as a fraction of the
            bound it breaks. Exactly 0 unless the previous command was inadmissible.
        solve_time: Wall time of the call [s].
        reason: Empty for `NOMINAL` and for an undisturbed `PROJECTED`; else what happened.
    """

    actions: NDArray[np.float64]
    status: Status
    correction: NDArray[np.float64]
    max_violation: float
    solve_time: float
    reason: str


@dataclass(frozen=True, slots=True)
class BatchProjection:
    """B admissible horizons; indexing and iterating give `Projection` objects.

    Attributes:
        actions: Commands [rad, m/s], shape (B, H, 2), read-only.
        status: Status of each horizon, length B.
        correction: ``actions - nominals``, shape (B, H, 2), read-only.
        max_violation: Largest violation of each horizon as a fraction of the bound, shape (B,).
        solve_time: Wall time of the whole call [s].
        reason: Reason of each horizon, length B.
    """

    actions: NDArray[np.float64]
    status: tuple[Status, ...]
    correction: NDArray[np.float64]
    max_violation: NDArray[np.float64]
    solve_time: float
    reason: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.status)

    def __getitem__(self, index: int) -> Projection:
        return Projection(
            self.actions[index],
            self.status[index],
            self.correction[index],
            float(self.max_violation[index]),
            self.solve_time / len(self),
            self.reason[index],
        )

    def __iter__(self) -> Iterator[Projection]:
        return (self[index] for index in range(len(self)))


@dataclass(frozen=True, slots=True)
class Certificate:
    """What the safety filter did to one command.

    Attributes:
        nominal_action: Command asked for [rad, m/s], shape (2,), read-only. In `shield.gym` an
            action in the units and the shape of the space.
        safe_action: Command, or action, to execute, same shape, read-only.
        status: How it came about.
        reason: What happened, empty when nothing did.
        correction: ``safe_action - nominal_action``, same shape, read-only.
        max_violation: As in `Projection`, for the executed command.
        solve_time: Wall time of the call [s].
        intervened: True when `safe_action` differs from `nominal_action`.
    """

    nominal_action: NDArray[Any]
    safe_action: NDArray[Any]
    status: Status
    reason: str
    correction: NDArray[np.float64]
    max_violation: float
    solve_time: float
    intervened: bool
