"""Which assumptions of docs/passive_safety.md can be seen to be broken, reading by reading.

A monitor takes note, and changes nothing. A2 (too thin for the beams), A8 (what comes from where
the scanner does not see) and A11 (who runs into whom) cannot be seen from the car.
"""

import math
from collections.abc import Iterator

import numpy as np

from shield.errors import Array
from shield.estimation.clusters import Track
from shield.limits.actuator_limits import ActuatorLimits
from shield.predictive.assumptions import Assumptions
from shield.world.reading import Reading
from shield.world.world import PERSON_WIDTH, World

__all__ = ["Monitors"]

OF_WORLD = {"scanner frozen": "A5", "scanner blind": "A4", "lane lost": "A9"}
SIGHTINGS, NEAR = 10, 15.0  # of a track, and [m] up to which its velocity is exact
FASTER = 0.6  # [m/s] by which it may seem faster than it is
ASIDE, AGAINST = 1.5, 1.5  # [m/s] of a vehicle: the middle of what is seen of it moves a bit
WITHIN, APART = 0.5, 1.5  # [m] within the lanes' edges; to the next hit, or it is a piece
ONE_SURFACE, TRIPLES = 0.6, 20  # [m] between neighbouring ranges; of them the noise is known
NOISE = 1.5  # deviations within `range_error`: with three it holds, with so few certainly not
ROW = 2  # periods in a row in which the car does not do as it is told
SLOWER = 0.15  # [m/s] by which a car that brakes may be faster than commanded
TURN, TURN_SHARE = 0.1, 0.3  # [rad/s] and share by which the yaw rate may differ from the model's
JUMP, JUMP_SHARE = 0.1, 1.5  # [m/s] and times what the actuators can do is no motion
OLD = 0.5  # [s] without a sighting of the lane


class Monitors:
    """Compares each reading with the last one, and with what was commanded meanwhile."""

    def __init__(self, limits: ActuatorLimits, assumptions: Assumptions) -> None:
        self._limits, self._assumed = limits, assumptions
        self.reset()

    def reset(self) -> None:
        """Forget the last reading."""
        self._last: Reading | None = None
        self._command: Array | None = None
        self._faster = self._turns = 0  # periods in a row
        self._flags: tuple[str, ...] = ()

    def watch(self, world: World, command: Array) -> tuple[str, ...]:
        """Name what the world's newest reading shows to be broken.

        Args:
            world: After its update.
            command: Executed before that reading (2,) [rad, m/s].
        """
        now = world.reading
        if now is None or now is self._last:
            return self._flags
        flags = [f"{OF_WORLD[flag]}: {flag}" for flag in world.flags]
        for track in world.tracks:
            flags += self._of_track(world, track)
        flags += [*self._of_scan(world, now), *self._of_car(now, command), *self._of_lane(now)]
        self._last, self._command = now, command
        self._flags = tuple(dict.fromkeys(flags))
        return self._flags

    def _of_track(self, world: World, track: Track) -> Iterator[str]:
        """A1."""
        if track.sightings < SIGHTINGS or math.hypot(*track.position.tolist()) > NEAR:
            return
        assumed, road, within = self._assumed, world.corridor, False
        along, aside = track.velocity.tolist()
        on_lanes = road is not None and assumed.level == "P0"
        if on_lanes and road is not None:
            (place,), (offset,) = road.locate((track.position + (world.scanner.mount, 0.0))[None])
            (way,) = road.direction(np.array([place]))
            along, aside = float(track.velocity @ way), float(way[0] * aside - way[1] * along)
            within = road.right + WITHIN < offset < road.left - WITHIN
            along = min(along, 0.0) if within else 0.0
        pace = math.hypot(along, aside)
        most = (assumed.object_speed if assumed.level == "P1" else assumed.person_speed) + FASTER
        if pace <= min(most, ASIDE, AGAINST):
            return
        known = world.obstacles
        fresh, own = known.age == 0.0, known.number == track.number
        mine, others = known.points[fresh & own], known.points[fresh & ~own]
        wide = math.dist(mine[0], mine[-1]) >= PERSON_WIDTH
        if wide and within:
            if abs(aside) > ASIDE:
                yield "A1: a vehicle leaves its lane"
            if along < -AGAINST:
                yield "A1: a vehicle comes the wrong way"
        piece = bool((((mine[:, None] - others) ** 2).sum(axis=2) < APART * APART).any())
        if pace > most and not piece and (not wide or assumed.level == "P1"):
            yield "A1: faster than assumed"

    def _of_scan(self, world: World, now: Reading) -> Iterator[str]:
        """A3 and A5."""
        if not now.age <= self._assumed.delay:
            yield "A5: late scan"
        known, error, body = world.obstacles, self._assumed.range_error, world.vehicle
        x, y = known.points[known.age == 0.0].T
        inside = (x < body.front_bumper - error) & (x > error - body.rear_overhang)
        if (inside & (np.abs(y) < 0.5 * body.width - error)).any():
            yield "A3: a hit inside the own body"
        ranges = np.asarray(now.scan)
        steps = np.diff(np.where((ranges > 0.0) & (ranges < NEAR), ranges, np.nan))
        smooth = np.abs(steps) < ONE_SURFACE
        bends = np.abs(np.diff(steps)[smooth[1:] & smooth[:-1]])
        # The median of |r''| is 0.6745 √6 σ for noise alone.
        if len(bends) >= TRIPLES and NOISE * float(np.median(bends)) > 1.652 * error:
            yield "A3: noisier than assumed"

    def _of_car(self, now: Reading, command: Array) -> Iterator[str]:
        """A6 and A7."""
        if not (math.isfinite(now.speed) and math.isfinite(now.yaw_rate)):
            yield "A7: speed or yaw rate is no number"
            return
        last, limits, dt = self._last, self._limits, self._limits.dt
        if last is None or self._command is None or not math.isfinite(last.speed):
            return
        change = max(limits.max_acceleration, limits.max_deceleration) * dt
        if abs(now.speed - last.speed) > JUMP_SHARE * change + JUMP:
            yield "A7: the speed jumps"
        slowed = abs(last.speed) - min(self._assumed.braking, limits.max_deceleration) * dt
        slow = abs(now.speed) > max(abs(float(command[1])), slowed) + SLOWER
        self._faster = self._faster + 1 if slow else 0
        bends = [math.tan(float(c[0])) / limits.wheelbase for c in (command, self._command)]
        bends += [bend / (1.0 + self._assumed.understeer * now.speed**2) for bend in bends]
        low, high = sorted((now.speed * min(bends), now.speed * max(bends)))
        room = TURN + TURN_SHARE * max(-low, high)
        off = not low - room < now.yaw_rate < high + room
        self._turns = self._turns + 1 if off else 0
        if self._faster >= ROW:
            yield "A6: brakes less than assumed"
        if self._turns >= ROW:
            yield "A6: turns otherwise than assumed"

    def _of_lane(self, now: Reading) -> Iterator[str]:
        """A9."""
        lane, last = now.lane, self._last
        if lane is None:
            return
        if lane.age > OLD:
            yield "A9: the lane is not seen"
        if abs(lane.heading_error) > self._assumed.lane_heading:
            yield "A9: the lane is out of view"
        if last is None or last.lane is None or not math.isfinite(last.speed):
            return
        aside = last.speed * self._limits.dt * math.sin(last.lane.heading_error)
        jump = lane.lateral_offset - last.lane.lateral_offset - aside
        if abs(jump) > self._assumed.lane_sigmas * (lane.offset_std + last.lane.offset_std):
            yield "A9: the lane estimate jumps"
