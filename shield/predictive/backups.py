r"""Manoeuvres that end at rest, rolled out from a candidate command.

Each backup brakes with the guaranteed deceleration and steers by a law of its own: with lane
feedback to one of three offsets, with the steering held, or with the wheels straightened. Each is
rolled out by a CasADi function, in the frame of the car (rear axle, x ahead, y to the left) and in
the lane (offset e, heading error ψ_e, curvature κ):

.. math:: \dot\psi = \frac{v\tan\delta}{L(1 + Kv^2)},\quad \dot e = v\sin\psi_e,\quad
          \dot\psi_e = \dot\psi - \frac{κ v\cos\psi_e}{1 - κe}

Steering and speed keep the limits G1-G3 by construction.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi
import numpy as np
from numpy.typing import ArrayLike

from shield.errors import Array
from shield.limits.actuator_limits import ActuatorLimits
from shield.predictive.assumptions import Assumptions
from shield.world.world import World

__all__ = ["BACKUPS", "BackupLibrary", "Motions", "Start"]

BACKUPS = ("keep the offset", "keep the first lane", "keep the second lane", "hold", "straighten")
"""Names of the backups, in the order of the roll-outs."""

OFFSET_TIME, HEADING_TIME = 0.8, 0.35  # [s] time constants of the lane feedback
LEAST_FEEDBACK_SPEED = 2.5  # [m/s] below which its gains stop growing
MAX_APPROACH = 0.4  # [rad] angle at which an offset is approached
MAX_CURVATURE = 0.1  # [1/m] of a lane that can be driven: a clothoid is not extrapolated further
SIDESTEP = 1.5  # [m] beside the present offset: where a car without lanes may stop
REST = 0.05  # [m/s] at which a car stands
INSIDE = 1.0 - 1e-9  # of a rate, so that rounding breaks no bound
SHORTEST = 6  # [periods] of the shortest roll-out
FIELDS = 8  # x, y, yaw, offset, heading error, curvature, steering, speed


@dataclass(frozen=True, slots=True)
class Start:
    """The state that motions begin in.

    Attributes:
        speed: Measured speed [m/s].
        previous: Last executed command (2,) [rad, m/s].
        lane: Offset from the first lane's centre [m], heading error [rad], curvature [1/m] and its
            rate along the lane [1/m²].
        offsets: The three offsets that backups keep [m].
    """

    speed: float
    previous: Array
    lane: tuple[float, float, float, float]
    offsets: tuple[float, float, float]

    @classmethod
    def of(cls, world: World, previous: Array) -> "Start":
        """The present state, where `previous` (2,) was executed last [rad, m/s]."""
        road = world.corridor
        if road is None:
            lane, offsets = (0.0, 0.0, 0.0, 0.0), (0.0, SIDESTEP, -SIDESTEP)
        else:
            lane, low, high = road.lane, road.centres[0], road.centres[-1]
            offsets = (min(max(lane[0], low), high), low, high)
        return cls(world.speed, previous, lane, offsets)


@dataclass(frozen=True, slots=True)
class Motions:
    """Roll-outs (B, N) of B candidates with one backup, at the N ends of control periods.

    Attributes:
        x, y, yaw: Pose of the rear axle [m], [m], [rad].
        offset, heading_error, curvature: In the lane [m], [rad], [1/m].
        commands: Steering and speed (B, N, 2) [rad, m/s]: those of the candidate first.
    """

    x: Array
    y: Array
    yaw: Array
    offset: Array
    heading_error: Array
    curvature: Array
    commands: Array

    @property
    def periods_to_rest(self) -> int:
        """Periods until all of them are at rest."""
        return int((np.abs(self.commands[..., 1]) > REST).any(axis=0).sum()) + 1

    def where(self, row: int) -> "Motions":
        """One of them alone."""
        one = slice(row, row + 1)
        return Motions(*(getattr(self, name)[one] for name in type(self).__slots__))


class BackupLibrary:
    """Rolls out backups from candidate commands.

    Attributes:
        braking: Deceleration of the backups [m/s²].
    """

    def __init__(self, limits: ActuatorLimits, assumptions: Assumptions) -> None:
        self._limits, self._assumptions = limits, assumptions
        self.braking = min(assumptions.braking, limits.max_deceleration)
        self._step = self.braking * limits.dt
        fastest = max(abs(limits.min_speed), abs(limits.max_speed))
        self._longest = self._periods(fastest)
        for backup in range(len(BACKUPS)):  # now, and not in the first steps that need them
            for periods in (SHORTEST * 2**k for k in range(32)):
                if periods <= self._longest:
                    _function(limits, assumptions, backup, 1, periods)

    def roll_out(self, start: Start, candidates: ArrayLike, backup: int) -> Motions:
        """Return the motions of candidates with a backup of `BACKUPS` after each.

        A candidate is a command, (B, 2) of them, or some in a row, (B, n, 2) [rad, m/s].
        """
        given = np.asarray(candidates, dtype=np.float64)
        given = np.ascontiguousarray(given.reshape(len(given), -1, 2))
        lead = given.shape[1]
        fastest = max(abs(start.speed), float(np.abs(given[..., 1]).max()))
        periods = min(self._periods(fastest), self._longest) + lead - 1
        target = start.offsets[backup] if backup < len(start.offsets) else 0.0
        state = np.array([start.speed, float(start.previous[0]), *start.lane, target])
        candidate, motion = np.empty((lead, 2)), np.empty((periods, FIELDS))
        # Buffers spare the conversions of arguments, which take longer than the roll-out.
        buffer: Any
        function = _function(self._limits, self._assumptions, backup, lead, periods)
        buffer, evaluate = function.buffer()
        buffer.set_arg(0, candidate.data)
        buffer.set_arg(1, state.data)
        buffer.set_res(0, motion.data)
        values = np.empty((len(given), periods, FIELDS))
        for row, commands in enumerate(given):
            candidate[:] = commands
            evaluate()
            values[row] = motion
        x, y, yaw, offset, heading, curvature = np.moveaxis(values[..., :6], -1, 0)
        return Motions(x, y, yaw, offset, heading, curvature, values[..., 6:])

    def _periods(self, speed: float) -> int:
        """Periods in which a car of this speed [m/s] comes to rest, and one at rest, in octaves."""
        backwards = self._limits.min_speed < 0.0
        step = min(self._step, self._limits.acceleration_step) if backwards else self._step
        needed = math.ceil(speed / step) + 2
        return int(SHORTEST * 2 ** max(0, math.ceil(math.log2(needed / SHORTEST))))


@lru_cache(maxsize=256)
def _function(
    limits: ActuatorLimits, assumptions: Assumptions, backup: int, lead: int, periods: int
) -> casadi.Function:
    """The roll-out (FIELDS, periods) of a candidate (2, lead) and a state (7,)."""
    given, state = casadi.SX.sym("given", 2, lead), casadi.SX.sym("state", 7)
    columns = _Law(limits, assumptions, backup).motion(given, state, periods)
    return casadi.Function("motion", [given, state], [casadi.densify(casadi.horzcat(*columns))])


class _Law:
    """A backup as a law, in CasADi's symbols."""

    def __init__(self, limits: ActuatorLimits, assumptions: Assumptions, backup: int) -> None:
        self._limits, self._assumptions, self._backup = limits, assumptions, backup
        self._step = min(assumptions.braking, limits.max_deceleration) * limits.dt

    def motion(self, given: casadi.SX, state: casadi.SX, periods: int) -> list[casadi.SX]:
        """One column (FIELDS,) for each period."""
        backup = self._backup
        dt, wheelbase = self._limits.dt, self._limits.wheelbase
        assumptions = self._assumptions
        actual, last = state[0], state[1]
        x, y, yaw = casadi.SX(0.0), casadi.SX(0.0), casadi.SX(0.0)
        offset, heading = state[2], state[3]
        lag = min(assumptions.steering_lag / dt, 1.0)
        along, columns = casadi.SX(0.0), []
        for period in range(periods):
            curvature = casadi.fmin(
                casadi.fmax(state[4] + state[5] * along, -MAX_CURVATURE), MAX_CURVATURE
            )
            if period < given.shape[1]:
                steering, speed = given[0, period], given[1, period]
            else:
                speed = self._brake(speed)
                if backup < 3:
                    pose = (offset, heading, curvature, state[6])
                    steering = self._steer(steering, speed, self._feedback(actual, *pose))
                elif backup == 3:
                    steering = self._steer(steering, speed, steering)
                else:
                    steering = self._steer(steering, speed, casadi.SX(0.0))
            mean = 0.5 * (actual + speed)
            angle = steering - lag * (steering - last)
            turn = mean * casadi.tan(angle) / (wheelbase * (1.0 + assumptions.understeer * mean**2))
            x += dt * mean * casadi.cos(yaw + 0.5 * dt * turn)
            y += dt * mean * casadi.sin(yaw + 0.5 * dt * turn)
            yaw += dt * turn
            progress = mean * casadi.cos(heading) / casadi.fmax(1.0 - curvature * offset, 0.2)
            relative = turn - curvature * progress
            offset += dt * mean * casadi.sin(heading + 0.5 * dt * relative)
            heading += dt * relative
            along += dt * progress
            actual, last = speed, steering
            column = (x, y, yaw, offset, heading, curvature, steering, speed)
            columns.append(casadi.vertcat(*column))
        return columns

    def _brake(self, speed: casadi.SX) -> casadi.SX:
        step = self._step * INSIDE
        slower = casadi.fmax(speed - step, 0.0)
        if self._limits.min_speed >= 0.0:
            return casadi.fmax(slower, self._limits.min_speed)
        back = casadi.fmin(speed + self._limits.acceleration_step * INSIDE, 0.0)
        return casadi.if_else(speed >= 0.0, slower, back)

    def _steer(self, now: casadi.SX, speed: casadi.SX, target: casadi.SX) -> casadi.SX:
        """The steering nearest to the target that G1-G3 allow."""
        limits = self._limits
        largest = casadi.SX(limits.max_steering)
        if limits.max_lateral_acceleration is not None:
            most = limits.max_lateral_acceleration * limits.wheelbase * (1.0 - 1e-6)
            tightest = casadi.atan(most / casadi.fmax(speed**2, 1e-3))
            largest = casadi.fmin(largest, tightest)
        step = limits.steering_step * INSIDE
        reached = casadi.fmin(casadi.fmax(target, now - step), now + step)
        return casadi.fmin(casadi.fmax(reached, -largest), largest)

    def _feedback(
        self,
        speed: casadi.SX,
        offset: casadi.SX,
        heading: casadi.SX,
        curvature: casadi.SX,
        target: casadi.SX,
    ) -> casadi.SX:
        """Steering that brings the car to an offset and along it."""
        v = casadi.fmax(speed, LEAST_FEEDBACK_SPEED)
        approach = (target - offset) / (OFFSET_TIME * v)
        reference = casadi.fmin(casadi.fmax(approach, -MAX_APPROACH), MAX_APPROACH)
        parallel = curvature / casadi.fmax(1.0 - curvature * offset, 0.4)
        return casadi.atan(
            self._limits.wheelbase * (parallel + (reference - heading) / (HEADING_TIME * v))
        )
