"""What the sensors say in one period."""

from dataclasses import dataclass

from numpy.typing import ArrayLike

from shield.estimation.lane import LaneEstimate

__all__ = ["Reading"]


@dataclass(frozen=True, slots=True)
class Reading:
    """One period's readings, as they came.

    Attributes:
        scan: Ranges [m] of the scanner's beams (n,), as of `World.update`.
        speed: Own speed [m/s].
        yaw_rate: Own yaw rate [rad/s].
        lane: Where the car is in its lane; None where it is not known, or where there are none.
        age: Of the scan when the command that answers it begins to act [s].
    """

    scan: ArrayLike
    speed: float
    yaw_rate: float
    lane: LaneEstimate | None = None
    age: float = 0.0
