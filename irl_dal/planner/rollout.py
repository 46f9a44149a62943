"""Roll-outs of plans through the kinematic bicycle, with their derivatives.

Compiled, because the energies roll a plan out in every reverse step. The arc of a step is driven
along its middle heading; `shield/vehicle.py` is the same bicycle in CasADi.
"""

import math
from typing import NamedTuple

import numpy as np

from irl_dal.arrays import Array
from irl_dal.shortcuts import compiled


class BrakingTail(NamedTuple):
    """What comes after the last command of a plan: braking to a stop with the steering held."""

    deceleration: float  # [m/s^2]
    points: int = 4  # Poses on the way, evenly spaced

    def driven(self, speed: float, others: Array) -> Array:
        """Time (points, P) [s] that times a velocity gives the way of others that brake as hard.

        The car begins to brake at `speed` [m/s], the others at theirs (P,).
        """
        share = np.arange(1, self.points + 1)[:, None] / self.points
        time = abs(speed) / self.deceleration * (1.0 - np.sqrt(1.0 - share))
        stop = others / self.deceleration
        braked = np.minimum(time, stop)
        return braked * (1.0 - 0.5 * braked / np.maximum(stop, 1e-9))


NO_TAIL = BrakingTail(1.0, 0)  # Nothing comes after the plan


class EgoRollout(NamedTuple):
    """Poses of the rear axle in the frame in which it now stands at the origin, heading along x.

    N is H plus the points of the braking tail. `cos` and `sin` of the middle heading of each step,
    and the rest, are for the derivative.
    """

    x: Array  # Position after each step (B, N) [m]
    y: Array  # Position after each step (B, N) [m], left
    heading: Array  # Heading after each step (B, N) [rad]
    cos: Array
    sin: Array
    along: Array  # Arc driven in each step (B, N) [m]
    per_speed: Array  # Its derivative with respect to the commanded speed (B, N) [s]
    bend: Array  # Curvature driven in each step (B, N) [1/m]
    wheelbase: float
    horizon: int


@compiled
def ego_rollout(
    commands: Array, wheelbase: float, dt: float, tail: BrakingTail = NO_TAIL
) -> EgoRollout:
    """Roll commands (B, H, 2) [rad, m/s] out in the ego frame, in steps of `dt` [s]."""
    batch, horizon, _ = commands.shape
    shape = (batch, horizon + tail.points)
    x, y, heading = np.empty(shape), np.empty(shape), np.empty(shape)
    cos, sin = np.empty(shape), np.empty(shape)
    along, per_speed, bend = np.empty(shape), np.empty(shape), np.empty(shape)
    for b in range(batch):
        east = north = turned = 0.0
        for i in range(shape[1]):
            steering, speed = commands[b, min(i, horizon - 1)]
            per_speed[b, i], along[b, i] = dt, dt * speed
            if i >= horizon:
                per_speed[b, i] = abs(speed) / (tail.deceleration * tail.points)
                along[b, i] = 0.5 * speed * per_speed[b, i]
            bend[b, i] = math.tan(steering) / wheelbase
            turn = bend[b, i] * along[b, i]
            cos[b, i], sin[b, i] = math.cos(turned + 0.5 * turn), math.sin(turned + 0.5 * turn)
            turned += turn
            east += along[b, i] * cos[b, i]
            north += along[b, i] * sin[b, i]
            x[b, i], y[b, i], heading[b, i] = east, north, turned
    return EgoRollout(x, y, heading, cos, sin, along, per_speed, bend, wheelbase, horizon)


@compiled
def ego_gradient(ego: EgoRollout, dx: Array, dy: Array, dheading: Array) -> Array:
    """Gradient per command (B, H, 2), per radian and per m/s, from those per pose (B, N)."""
    batch, count = ego.x.shape
    gradient = np.zeros((batch, ego.horizon, 2))
    for b in range(batch):
        later_x = later_y = later_turn = 0.0
        for i in range(count - 1, -1, -1):
            cos, sin, along, bend = ego.cos[b, i], ego.sin[b, i], ego.along[b, i], ego.bend[b, i]
            later_x += dx[b, i]
            later_y += dy[b, i]
            dmiddle = along * (later_y * cos - later_x * sin)
            later_turn += dmiddle + dheading[b, i]
            dturn = later_turn - 0.5 * dmiddle
            dalong = later_x * cos + later_y * sin + dturn * bend
            per_radian = 1.0 / ego.wheelbase + ego.wheelbase * bend * bend
            command = min(i, ego.horizon - 1)
            gradient[b, command, 0] += dturn * along * per_radian
            gradient[b, command, 1] += dalong * ego.per_speed[b, i]
    return gradient


class LanePose(NamedTuple):
    """Where the car is in its lane, which bends as a clothoid."""

    offset: float  # Lateral offset [m], positive left of the home lane's centre
    heading: float  # Heading error [rad]
    curvature: float  # Of the lane here [1/m], positive left
    curvature_rate: float = 0.0  # Its change along the driven arc [1/m^2]


class RoadRollout(NamedTuple):
    """Lateral offset and heading error along the lane, to first order in offset * curvature.

    `cos` and `sin` of the middle heading error of each step, and the rest, are for the derivative.
    """

    # Lateral offset after each step (B, H) [m], positive left of the home lane's centre
    offset: Array
    heading: Array  # Heading error after each step (B, H) [rad]
    cos: Array
    sin: Array
    along: Array  # Arc driven in each step (B, H) [m]
    steer: Array  # Curvature driven in each step (B, H) [1/m]
    bend: Array  # The same relative to the lane (B, H) [1/m]
    wheelbase: float
    dt: float
    curvature_rate: float


@compiled
def road_rollout(commands: Array, wheelbase: float, dt: float, start: LanePose) -> RoadRollout:
    """Roll commands (B, H, 2) [rad, m/s] out along the lane from `start`, in steps of `dt` [s]."""
    batch, horizon, _ = commands.shape
    shape = (batch, horizon)
    offset, heading = np.empty(shape), np.empty(shape)
    cos, sin = np.empty(shape), np.empty(shape)
    along, steer, bend = np.empty(shape), np.empty(shape), np.empty(shape)
    for b in range(batch):
        aside, turned, driven = start.offset, start.heading, 0.0
        for i in range(horizon):
            steering, speed = commands[b, i]
            along[b, i] = dt * speed
            steer[b, i] = math.tan(steering) / wheelbase
            middle = driven + 0.5 * along[b, i]
            bend[b, i] = steer[b, i] - (start.curvature + start.curvature_rate * middle)
            turn = bend[b, i] * along[b, i]
            cos[b, i], sin[b, i] = math.cos(turned + 0.5 * turn), math.sin(turned + 0.5 * turn)
            driven += along[b, i]
            turned += turn
            aside += along[b, i] * sin[b, i]
            offset[b, i], heading[b, i] = aside, turned
    return RoadRollout(
        offset, heading, cos, sin, along, steer, bend, wheelbase, dt, start.curvature_rate
    )


@compiled
def road_gradient(road: RoadRollout, doffset: Array, dheading: Array) -> Array:
    """Gradient per command (B, H, 2), per radian and per m/s, from those per pose (B, H)."""
    batch, horizon = road.offset.shape
    gradient = np.empty((batch, horizon, 2))
    for b in range(batch):
        later_offset = later_turn = later_lane = 0.0
        for i in range(horizon - 1, -1, -1):
            along, steer = road.along[b, i], road.steer[b, i]
            later_offset += doffset[b, i]
            dmiddle = later_offset * along * road.cos[b, i]
            later_turn += dmiddle + dheading[b, i]
            dturn = later_turn - 0.5 * dmiddle
            dlane = -dturn * along * road.curvature_rate
            later_lane += dlane
            dalong = later_offset * road.sin[b, i] + dturn * road.bend[b, i]
            dalong += later_lane - 0.5 * dlane
            per_radian = 1.0 / road.wheelbase + road.wheelbase * steer * steer
            gradient[b, i, 0] = dturn * along * per_radian
            gradient[b, i, 1] = dalong * road.dt
    return gradient
