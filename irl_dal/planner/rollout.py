r"""Where a plan takes the car: the kinematic bicycle for a batch, with its exact gradients.

The batched twin of `shield.vehicle.KinematicBicycle`, without a Python loop over the horizon.
Within a step the heading is taken at the step's middle, which bends the chord by at most
:math:`\Delta\psi^2 / 24` of its length (0.1 mm at 8 m/s and 4 m/s²).

| variable  | meaning                                                              |
|-----------|----------------------------------------------------------------------|
| `turn`    | heading change of each step, v dt (tan(delta) / L - kappa) [rad]     |
| `heading` | heading after each step, its start plus cumsum(turn) [rad]           |
| `middle`  | heading at the middle of each step [rad]                             |
| `along`   | advance of each step, v dt [m]                                       |

All arrays are (B, H). Gradients are pulled back with reversed cumulative sums.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class BrakingTail:
    """What comes after the last command of a plan: braking to a stop with the steering held.

    Attributes:
        deceleration: [m/s^2].
        points: Poses on the way, evenly spaced.
    """

    deceleration: float
    points: int = 4

    def driven(self, speed: float, others: Array) -> Array:
        """How far others get that brake as hard, in seconds of their own speed.

        Args:
            speed: Speed of the car when it begins to brake [m/s].
            others: Speeds of the others (P,) [m/s].

        Returns:
            (points, P) [s]: times a velocity, the way driven when the car is at each pose.
        """
        share = np.arange(1, self.points + 1)[:, None] / self.points
        time = abs(speed) / self.deceleration * (1.0 - np.sqrt(1.0 - share))
        stop = others / self.deceleration
        braked = np.minimum(time, stop)
        return braked * (1.0 - 0.5 * braked / np.maximum(stop, 1e-9))


@dataclass(frozen=True, slots=True, eq=False)
class EgoRollout:
    """Poses of the rear axle in the frame in which it now stands at the origin, heading along x.

    N is H, or H + points with a braking tail.

    Attributes:
        x: Position after each step (B, N) [m].
        y: Position after each step (B, N) [m], left.
        heading: Heading after each step (B, N) [rad].
    """

    x: Array
    y: Array
    heading: Array
    _cos: Array
    _sin: Array
    _along: Array
    _bend: Array
    _last_speed: Array
    _wheelbase: float
    _dt: float
    _tail: BrakingTail | None

    @classmethod
    def of(
        cls, commands: Array, wheelbase: float, dt: float, tail: BrakingTail | None = None
    ) -> EgoRollout:
        """Roll commands (B, H, 2) [rad, m/s] out.

        Args:
            commands: (B, H, 2) [rad, m/s].
            wheelbase: L [m].
            dt: Step [s].
            tail: What follows the last command; None for nothing.
        """
        along = commands[..., 1] * dt
        bend = np.tan(commands[..., 0]) / wheelbase
        last = commands[:, -1:, 1]
        if tail is not None:
            stretch = last * np.abs(last) / (2.0 * tail.deceleration * tail.points)
            along = np.concatenate([along, *[stretch] * tail.points], axis=1)
            bend = np.concatenate([bend, *[bend[:, -1:]] * tail.points], axis=1)
        turn = bend * along
        heading = turn.cumsum(axis=1)
        middle = heading - 0.5 * turn
        cos, sin = np.cos(middle), np.sin(middle)
        x, y = (along * cos).cumsum(axis=1), (along * sin).cumsum(axis=1)
        return cls(x, y, heading, cos, sin, along, bend, last, wheelbase, dt, tail)

    def pull_back(self, dx: Array, dy: Array, dheading: Array) -> Array:
        """Gradient with respect to the commands from that with respect to the poses.

        Args:
            dx: Derivative with respect to `x` (B, N).
            dy: Derivative with respect to `y` (B, N).
            dheading: Derivative with respect to `heading` (B, N).

        Returns:
            (B, H, 2), per radian and per m/s.
        """
        later_x, later_y = _later(dx), _later(dy)
        dmiddle = self._along * (later_y * self._cos - later_x * self._sin)
        dturn = _later(dmiddle + dheading) - 0.5 * dmiddle
        dalong = later_x * self._cos + later_y * self._sin + dturn * self._bend
        dbend = dturn * self._along
        horizon = dx.shape[1] if self._tail is None else dx.shape[1] - self._tail.points
        bend = self._bend[:, :horizon]
        gradient = np.empty((len(dx), horizon, 2))
        gradient[..., 0] = dbend[:, :horizon]
        gradient[..., 1] = dalong[:, :horizon] * self._dt
        if self._tail is not None:
            stretch = np.abs(self._last_speed[:, 0]) / (self._tail.deceleration * self._tail.points)
            gradient[:, -1, 0] += dbend[:, horizon:].sum(axis=1)
            gradient[:, -1, 1] += dalong[:, horizon:].sum(axis=1) * stretch
        gradient[..., 0] *= 1.0 / self._wheelbase + self._wheelbase * bend * bend
        return gradient


@dataclass(frozen=True, slots=True, eq=False)
class RoadRollout:
    """Lateral offset and heading error along the lane, to first order in offset * curvature.

    The lane bends as a clothoid: kappa(s) = curvature + curvature_rate * s, with s the driven arc.

    Attributes:
        offset: Lateral offset after each step (B, H) [m], positive left of the home lane's centre.
        heading: Heading error after each step (B, H) [rad].
    """

    offset: Array
    heading: Array
    _cos: Array
    _sin: Array
    _along: Array
    _dt: float
    _bend: Array
    _stretch: Array
    _curvature_rate: float

    @classmethod
    def of(
        cls,
        commands: Array,
        wheelbase: float,
        dt: float,
        *,
        offset: float,
        heading: float,
        curvature: float,
        curvature_rate: float = 0.0,
    ) -> RoadRollout:
        """Roll commands out from a lane pose.

        Args:
            commands: (B, H, 2) [rad, m/s].
            wheelbase: L [m].
            dt: Step [s].
            offset: Lateral offset now [m].
            heading: Heading error now [rad].
            curvature: Of the lane here [1/m], positive left.
            curvature_rate: Its change along the lane [1/m^2].
        """
        along = commands[..., 1] * dt
        steer = np.tan(commands[..., 0]) / wheelbase
        lane = curvature + curvature_rate * (along.cumsum(axis=1) - 0.5 * along)
        bend = steer - lane
        turn = bend * along
        after = heading + turn.cumsum(axis=1)
        middle = after - 0.5 * turn
        cos, sin = np.cos(middle), np.sin(middle)
        return cls(
            offset=offset + (along * sin).cumsum(axis=1),
            heading=after,
            _cos=cos,
            _sin=sin,
            _along=along,
            _dt=dt,
            _bend=bend,
            _stretch=along * (1.0 / wheelbase + wheelbase * steer * steer),
            _curvature_rate=curvature_rate,
        )

    def pull_back(self, doffset: Array, dheading: Array | None = None) -> Array:
        """Gradient with respect to the commands from that with respect to offset and heading.

        Args:
            doffset: Derivative with respect to `offset` (B, H).
            dheading: Derivative with respect to `heading` (B, H); None for zero.

        Returns:
            (B, H, 2), per radian and per m/s.
        """
        later = _later(doffset)
        dmiddle = later * self._along * self._cos
        dturn = _later(dmiddle if dheading is None else dmiddle + dheading) - 0.5 * dmiddle
        dalong = later * self._sin + dturn * self._bend
        if self._curvature_rate != 0.0:
            dlane = -dturn * self._along * self._curvature_rate
            dalong += _later(dlane) - 0.5 * dlane
        gradient = np.empty((*doffset.shape, 2))
        gradient[..., 0] = dturn * self._stretch
        gradient[..., 1] = self._dt * dalong
        return gradient


def _later(values: Array) -> Array:
    """Sum over this and all later steps (B, H)."""
    return values[:, ::-1].cumsum(axis=1)[:, ::-1]
