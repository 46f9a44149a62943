"""The lanes that the car may use, as far as the lane estimate knows them."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from shield.errors import Array
from shield.estimation.lane import LaneEstimate, LaneGeometry

__all__ = ["Corridor"]

LOST = 0.1  # share of a lane's width: with a larger deviation the lane is lost
STRAIGHT = 1e-6  # [1/m] a straighter lane counts as one of this curvature


@dataclass(frozen=True, slots=True)
class Corridor:
    """Own lanes around the car.

    Attributes:
        lane: Offset from the first lane's centre [m], heading error [rad], curvature [1/m] and its
            rate along the lane [1/m²].
        right, left: Offsets of its edges [m].
        std: Deviation of the offset [m].
        centres: Offsets of the lanes' centres [m].
    """

    lane: tuple[float, float, float, float]
    right: float
    left: float
    std: float
    centres: tuple[float, ...]

    @classmethod
    def around(cls, lane: LaneEstimate | None, lanes: LaneGeometry) -> Self | None:
        """The corridor of a lane estimate; None where the lane is lost.

        An old estimate is one whose deviation has grown, and no worse than that.
        """
        if lane is None or not lane.offset_std < LOST * lanes.width or math.isinf(lane.age):
            return None
        pose = lane.lateral_offset, lane.heading_error, lane.curvature, lane.curvature_rate
        half = 0.5 * lanes.width
        return cls(
            pose, lanes.centres[0] - half, lanes.centres[-1] + half, lane.offset_std, lanes.centres
        )

    def locate(self, points: Array) -> tuple[Array, Array]:
        """Distance along the lane and offset (n,) [m] of points (n, 2) in the car's frame."""
        offset, heading, curvature, rate = self.lane
        cos, sin = math.cos(heading), math.sin(heading)
        ahead = cos * points[:, 0] - sin * points[:, 1]
        aside = offset + sin * points[:, 0] + cos * points[:, 1]
        bend = curvature + rate * ahead / 3.0  # the circle that a clothoid's offset is that of
        bend = np.where(np.abs(bend) < STRAIGHT, STRAIGHT, bend)
        along, across = bend * ahead, 1.0 - bend * aside
        return np.arctan2(along, across) / bend, (1.0 - np.hypot(along, across)) / bend

    def direction(self, along: Array) -> Array:
        """Direction (n, 2) of the lane at distances along it (n,) [m], in the car's frame."""
        _, heading, curvature, rate = self.lane
        angle = curvature * along + 0.5 * rate * along * along - heading
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def curvature_at(self, along: Array) -> Array:
        """Curvature (n,) of the lane at distances along it (n,) [1/m]."""
        return self.lane[2] + self.lane[3] * along

    def advance(self, distance: float) -> float:
        """How far along the first lane a car gets that drives a distance [m]."""
        offset, heading, curvature, _ = self.lane
        return distance * math.cos(heading) / max(1.0 - curvature * offset, 0.2)
