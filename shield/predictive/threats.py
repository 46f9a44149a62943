"""Where everything that is known may be from now on."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shield.errors import Array
from shield.predictive.assumptions import Assumptions
from shield.world.world import INTRUSION_SPEED, ROLLING, Index, Kind, Obstacles, World

__all__ = ["Threats"]

WALKING = 0.3  # [m/s] a slower person counts as standing
VEHICLE_GROWTH = 0.5  # [m/s] added to the velocity's error of a moving vehicle
BESIDE_ROOM = 0.5  # [m] beyond the corridor's edges where things that stand may still be near


@dataclass(frozen=True, slots=True)
class Threats:
    """Discs that move and grow: at time t around p + u t + w t²/2.

    The radius is min(error t + acceleration t²/2, fastest t), t from when each was last seen.

    Attributes:
        points: p (n, 2) [m].
        velocity: u (n, 2) [m/s].
        bend: w (n, 2) [m/s²], of what follows a bend.
        error, acceleration, fastest: Of the growth (n,) [m/s], [m/s²], [m/s].
        age: Time since it was seen (n,) [s].
        source: Row of the obstacle's hit (n,), -1 for unknown space.
    """

    points: Array
    velocity: Array
    bend: Array
    error: Array
    acceleration: Array
    fastest: Array
    age: Array
    source: Index

    @classmethod
    def of(cls, world: World, assumptions: Assumptions, horizon: float) -> "Threats":
        """All that a car could meet within `horizon` [m] of its rear axle."""
        known, road = world.obstacles, world.corridor
        (near,) = np.nonzero(np.hypot(*known.points.T) < horizon)
        person = known.kind[near] == Kind.PERSON
        along, aside = np.zeros((2, len(near)))
        if road is not None:
            # The body stays within the corridor: what stands beyond its edges is out of reach.
            along, aside = road.locate(known.points[near])
            room = np.where(person, horizon, BESIDE_ROOM)
            within = (aside > road.right - room) & (aside < road.left + room)
            near, person, along, aside = near[within], person[within], along[within], aside[within]
        if assumptions.level == "P1":
            fast, gone = assumptions.object_speed, known.kind[near] == Kind.GONE
            stands, moves = (near[gone], 0.0, 0.0, 0.0, 0.0, 0.0), (near[~gone], 0.0, 0.0, fast)
            parts = [cls._at(known, [stands, (*moves, 0.0, fast)])]
        else:
            parts = [cls._people(known, near[person], assumptions)] if person.any() else []
            near, along, aside = near[~person], along[~person], aside[~person]
            if len(near):
                parts.append(cls._at(known, [(near, 0.0, 0.0, 0.0, 0.0, 0.0)]))
                parts.append(cls._rolling(world, near, along, aside))
        if len(world.frontier) or not parts:
            parts.insert(0, cls._unknown(world, horizon))
        if len(parts) == 1:
            return parts[0]
        names = cls.__slots__
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    @classmethod
    def _at(cls, known: Obstacles, ways: Sequence[tuple[Index, *tuple[float, ...]]]) -> "Threats":
        """Hits that may go several ways, each way with the rows (m,) of those that may.

        Then come the shares of velocity and of its error, an error beside it, acceleration and
        largest speed of that way.
        """
        rows = np.concatenate([way[0] for way in ways])
        numbers = np.array([way[1:] for way in ways]).repeat([len(way[0]) for way in ways], axis=0)
        share, of_error, error, acceleration, fastest = numbers.T
        velocity, age = known.velocity[rows], known.age[rows]
        return cls(
            # Where it is if it has kept this share since it was seen: what is known has kept all.
            known.points[rows] - ((1.0 - share) * age)[:, None] * velocity,
            share[:, None] * velocity,
            np.zeros((len(rows), 2)),
            of_error * known.error[rows] + error,
            acceleration,
            fastest,
            age,
            rows,
        )

    @classmethod
    def _people(cls, known: Obstacles, rows: Index, assumptions: Assumptions) -> "Threats":
        """People set off, go on, or stop."""
        push, fast = assumptions.person_acceleration, assumptions.person_speed
        walk = np.hypot(*known.velocity[rows].T) > WALKING
        walks = rows[walk]
        sets_off, stops = (
            (rows[~walk], 0.0, 1.0, 0.0, push, fast),
            (walks, 0.0, 0.0, 0.0, 0.0, fast),
        )
        slows = (walks, 0.5, 0.5, 0.0, 0.5 * push, fast)
        goes_on = (walks, 1.0, 1.0, 0.0, push, 2.0 * fast)
        return cls._at(known, [sets_off, stops, slows, goes_on])

    @classmethod
    def _rolling(cls, world: World, rows: Index, along: Array, aside: Array) -> "Threats":
        """Vehicles in our lanes may go on along the road."""
        known, road = world.obstacles, world.corridor
        pace = np.hypot(*known.velocity[rows].T)
        rolls = (known.kind[rows] == Kind.VEHICLE) & (pace > ROLLING)
        rolls &= known.velocity[rows, 0] > 0.0
        if road is not None:
            rolls &= (aside > road.right) & (aside < road.left)
        error = known.error[rows] + VEHICLE_GROWTH
        paces = np.concatenate(
            [v[rolls, None] for v in (0.5 * pace, np.maximum(pace - error, 0.0), pace + error)]
        )
        rows, pace, along = (np.tile(values[rolls], 3) for values in (rows, pace, along))
        ways = known.velocity[rows] / pace[:, None]
        turn = np.zeros(len(rows)) if road is None else road.curvature_at(along)
        normal = np.stack([-ways[:, 1], ways[:, 0]], axis=1)
        bend, zero = turn[:, None] * paces * paces * normal, np.zeros(len(rows))
        return cls(known.points[rows], paces * ways, bend, zero, zero, zero, zero, rows)

    @classmethod
    def _unknown(cls, world: World, horizon: float) -> "Threats":
        """Unknown space, from where anything may come."""
        edge = world.frontier[np.hypot(*world.frontier.T) < horizon]
        count = len(edge)
        speed, zero, flat = np.full(count, INTRUSION_SPEED), np.zeros(count), np.zeros((count, 2))
        return cls(edge, flat, flat, speed, zero, speed, zero, np.full(count, -1))

    def centres(self, time: Array) -> tuple[Array, Array]:
        """Coordinates of the centres at times (m,) [s]: twice (m, n) [m]."""
        t = time[:, None]
        half = 0.5 * t * t
        x, y = self.points.T
        u, v = self.velocity.T
        return x + u * t + self.bend[:, 0] * half, y + v * t + self.bend[:, 1] * half

    def radius(self, time: Array) -> Array:
        """Radii (m, n) at times (m,) [s]."""
        t = time[:, None] + self.age
        grown = self.error * t + 0.5 * self.acceleration * t * t
        return np.minimum(grown, self.fastest * t)
