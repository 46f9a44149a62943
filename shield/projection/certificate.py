"""What a shield hands back: the command, and how far it can be trusted."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shield.errors import Array

__all__ = ["Certificate", "Projection", "Status"]


class Status(StrEnum):
    """How an answer came about, from untouched to emergency.

    Attributes:
        NOMINAL: The nominal commands were admissible and come back bit by bit.
        PROJECTED: The nearest admissible commands, verified at the answer itself: a local optimum
            where a constraint is not convex.
        REPAIRED: Admissible, but not verified to be the nearest, or the caller's own constraints
            cannot be kept together with the limits. The reason says which.
        FALLBACK: Not what was asked for: the nominal or the previous command was not finite, the
            previous command was such that no answer keeps every bound, or nothing near the nominal
            is certified to be safe.
    """

    NOMINAL = "nominal"
    PROJECTED = "projected"
    REPAIRED = "repaired"
    FALLBACK = "fallback"


class _Result:
    """Results are equal if they say the same; the time that they took is no part of that."""

    __slots__: tuple[str, ...] = ()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Result) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def _key(self) -> tuple[object, ...]:
        """Return all that counts; arrays by their bytes, so that NaN equals itself."""
        key: list[object] = [type(self)]
        for name in self.__slots__:
            value = getattr(self, name)
            if isinstance(value, np.ndarray):
                key += [value.dtype.str, value.shape, value.tobytes()]
            elif name != "solve_time":
                key.append(value)
        return tuple(key)


@dataclass(frozen=True, slots=True, eq=False)
class Projection(_Result):
    """An admissible horizon.

    Attributes:
        actions: Commands [rad, m/s], shape (H, 2), read-only.
        status: How it came about.
        correction: ``actions - nominal`` [rad, m/s], shape (H, 2), read-only; not
            finite where the nominal is not.
        max_violation: Largest violation of the limits found by the independent check, as a fraction
            of the bound it breaks. Exactly 0 unless the previous command was inadmissible.
        solve_time: Wall time of the call [s].
        reason: Empty for `NOMINAL` and for an undisturbed `PROJECTED`; else what happened.
        violations: By how much each of the caller's own constraints is broken at `actions`, in the
            units of its rows, in the order given to the projector; 0 if it holds.
    """

    actions: Array
    status: Status
    correction: Array
    max_violation: float
    solve_time: float
    reason: str
    violations: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Certificate(_Result):
    """What the safety filter did to one command.

    Attributes:
        nominal_action: Command asked for [rad, m/s], shape (2,), read-only. In `shield.gym` an
            action in the units and the shape of the space.
        safe_action: Command, or action, to execute, same shape, read-only.
        status, reason, max_violation, solve_time: As in `Projection`, for the executed command.
        correction: ``safe_action - nominal_action``, same shape, read-only.
        intervened: True when `safe_action` differs from `nominal_action`.
        flags: Assumptions of a `PredictiveFilter` that can be seen to be broken, such as "A6:
            brakes less than assumed".
    """

    nominal_action: NDArray[Any]
    safe_action: NDArray[Any]
    status: Status
    reason: str
    correction: Array
    max_violation: float
    solve_time: float
    intervened: bool
    flags: tuple[str, ...] = ()
