"""Obstacle avoidance, E_lidar."""

import math

import numpy as np

from irl_dal.arrays import Array
from irl_dal.planner.context import PlanningContext
from irl_dal.planner.energy.base import Energy, risk_adaptive
from irl_dal.planner.rollout import NO_TAIL, BrakingTail, ego_gradient, ego_rollout
from irl_dal.shortcuts import compiled
from shield import VehicleGeometry

DISCS = 3  # Discs that cover the car, one for each third of its length
OBJECT_SIZE = 3.0  # Returns within this distance of the nearest one move with it [m]; about a car


class ClearanceEnergy(Energy):
    r"""Mean over the roll-out of :math:`w_{lidar} \max(0, (d_{safe} - d_i) / s_{lidar})^2`.

    d_i is the distance from the car's outline, three discs, to the nearest of the scan's points at
    that time; :math:`w_{lidar} = w_{base} (1 + h_t)`. The object that the tracked clearance
    belongs to moves along its line of sight with the speed that explains the closing speed; the
    other points rest. With `braking`, the roll-out goes on until the car stands, and the object
    brakes as hard. Points that no plan can come near to are left out.
    """

    def prepare(self) -> None:
        """Set the weight, the discs, and where the points will be."""
        context, braking = self.context, self.config.braking
        self.weight = risk_adaptive(self.config.clearance_weight, context)
        self._centres, self._radius = cover(context.vehicle)
        self._tail = NO_TAIL if braking is None else BrakingTail(braking)
        points, velocities = self._reachable(*scan_points(context))
        driven = self.limits.dt * np.arange(1, self.horizon + 1)[:, None] * np.ones(len(points))
        if self._tail.points:
            speeds = np.linalg.norm(velocities, axis=1)
            rest = self._tail.driven(float(context.previous[1]), speeds)
            driven = np.concatenate([driven, driven[-1] + rest])
        moving = points + driven[..., None] * velocities  # (N, P, 2)
        self._east, self._north = moving[..., 0].copy(), moving[..., 1].copy()

    @property
    def active(self) -> bool:
        """Whether any point can come near."""
        return self._east.size > 0 and self.weight > 0

    def evaluate(self, actions: Array) -> tuple[Array, Array]:
        """Energies (B,) and gradients (B, H, 2)."""
        value, gradient = _nearness(
            self.scale.to_command(actions),
            self._east,
            self._north,
            self._centres,
            self._radius + self.config.safe_clearance,
            self.weight / self.config.clearance_scale**2,
            self.limits.wheelbase,
            self.limits.dt,
            self._tail,
        )
        return value, gradient * self.scale.half

    def _reachable(self, points: Array, velocities: Array) -> tuple[Array, Array]:
        """The points that can come within the safe clearance during the horizon."""
        reach = self._centres[-1] + self._radius + self.config.safe_clearance
        own = max(abs(self.limits.max_speed), abs(self.limits.min_speed))
        speed = own + np.linalg.norm(velocities, axis=1)
        longest = self.horizon * self.limits.dt
        if self.config.braking is not None:
            longest += own / self.config.braking
        near = np.linalg.norm(points, axis=1) < reach + speed * longest
        return points[near], velocities[near]


@compiled
def _nearness(
    commands: Array,
    east: Array,
    north: Array,
    centres: Array,
    safe: float,
    weight: float,
    wheelbase: float,
    dt: float,
    tail: BrakingTail,
) -> tuple[Array, Array]:
    """`weight` times the mean over N of max(0, safe - d_i)^2, and its derivative per command.

    d_i is the distance from the nearest disc's centre to the nearest point. Points are where they
    are at each of the N poses, (N, P).
    """
    ego = ego_rollout(commands, wheelbase, dt, tail)
    batch, count = ego.x.shape
    value = np.zeros(batch)
    dx, dy = np.zeros((batch, count)), np.zeros((batch, count))
    dheading = np.zeros((batch, count))
    for b in range(batch):
        for i in range(count):
            cos, sin = math.cos(ego.heading[b, i]), math.sin(ego.heading[b, i])
            least, point, disc = math.inf, 0, 0.0
            for centre in centres:
                x, y = ego.x[b, i] + centre * cos, ego.y[b, i] + centre * sin
                for p in range(east.shape[1]):
                    squared = (x - east[i, p]) ** 2 + (y - north[i, p]) ** 2
                    if squared < least:
                        least, point, disc = squared, p, centre
            distance = math.sqrt(least)
            gap = safe - distance
            if gap > 0.0:
                value[b] += weight / count * gap * gap
                # d(value) / d(distance) along the unit vector from the point to the disc.
                pull = -2.0 * weight / count * gap / max(distance, 1e-9)
                dx[b, i] = pull * (ego.x[b, i] + disc * cos - east[i, point])
                dy[b, i] = pull * (ego.y[b, i] + disc * sin - north[i, point])
                dheading[b, i] = disc * (dy[b, i] * cos - dx[b, i] * sin)
    return value, ego_gradient(ego, dx, dy, dheading)


def cover(vehicle: VehicleGeometry) -> tuple[Array, float]:
    """Discs over the car: their centres (DISCS,) from the rear axle [m], and their radius [m]."""
    third = vehicle.length / DISCS
    centres = np.asarray(third * (np.arange(DISCS) + 0.5) - vehicle.rear_overhang, np.float64)
    return centres, math.hypot(0.5 * third, 0.5 * vehicle.width)


def scan_points(context: PlanningContext) -> tuple[Array, Array]:
    """The scan's returns in the rear axle's frame (P, 2) [m], and their velocities (P, 2) [m/s]."""
    scanner = context.geometry
    returned = scanner.returned(context.scan)
    ranges, angles = context.scan[returned], scanner.angles[returned]
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points = ranges[:, None] * rays
    velocities = np.zeros_like(points)
    if len(points) and context.clearance.valid:
        nearest = int(np.argmin(ranges))
        # closing = own speed along the line of sight - the object's speed along it
        away = context.speed * rays[nearest, 0] - float(context.clearance.closing_speed)
        together = np.linalg.norm(points - points[nearest], axis=1) < OBJECT_SIZE
        velocities[together] = away * rays[nearest]
    points[:, 0] += scanner.mount
    return points, velocities
