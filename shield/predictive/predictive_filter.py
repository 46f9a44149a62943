"""The filter: a command is executed only if it can be followed by a backup that ends at rest."""

import math
import time
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from shield.errors import Array, InvalidLimits, as_array, as_horizon, check_numbers, check_within
from shield.estimation.lane import LaneEstimate, LaneGeometry
from shield.estimation.scan import DEFAULT_SCANNER, ScannerGeometry
from shield.limits.actuator_limits import ActuatorLimits
from shield.predictive.assumptions import Assumptions
from shield.predictive.backups import BACKUPS, REST, BackupLibrary, Motions, Start
from shield.predictive.certification import Certification
from shield.predictive.detour import Detour
from shield.predictive.monitors import Monitors
from shield.projection.certificate import Certificate, Status
from shield.projection.projector import HorizonProjector
from shield.projection.solvers import SolverFactory
from shield.safety_filter import SafetyFilter
from shield.vehicle import VehicleGeometry
from shield.world.world import World

__all__ = ["PredictiveFilter"]

STEERING_SHARES = np.array([0.0, 0.25, -0.25, 0.5, -0.5, 1.0, -1.0])  # of a step, from the nominal
SLOW = 1.5  # [m/s] below which a candidate that speeds up may be what leads out


class PredictiveFilter:
    """Certifies commands against the world; everything passes G1-G3 last.

    Args:
        limits: Limits of the vehicle.
        geometry: Outline of the car.
        scanner: Where the scanner is and where its beams point.
        assumptions: What the promise rests on.
        lanes: The lanes that the car may use; None for a car without lanes.
        scanner_clearance: Distance from the scanner that counts as a contact [m]; 0: none does.
        solver: As of `SafetyFilter`.
        deadline: Time after which the search ends, and the committed backup is the answer [s].

    Attributes:
        world: What is around the car.
        checks: Those of the last call of `filter`, for pictures of it; None before.
        motion: The committed motion of that call; None where an earlier one went on.
        refused: The motion of its nominal that the first backup did not certify, if any.

    Raises:
        InvalidLimits: An argument is out of range.
    """

    def __init__(
        self,
        limits: ActuatorLimits,
        geometry: VehicleGeometry | None = None,
        scanner: ScannerGeometry = DEFAULT_SCANNER,
        assumptions: Assumptions | None = None,
        *,
        lanes: LaneGeometry | None = None,
        scanner_clearance: float = 0.0,
        solver: str | SolverFactory = "osqp",
        deadline: float = 0.05,
    ) -> None:
        self.limits = limits
        self.geometry = VehicleGeometry() if geometry is None else geometry
        self.assumptions = Assumptions() if assumptions is None else assumptions
        self.world = World(limits.dt, scanner, self.geometry, lanes)
        self.checks: Certification | None = None
        self.motion: Motions | None = None
        self.refused: Motions | None = None
        check_within(InvalidLimits, 0.0, math.inf, scanner_clearance=scanner_clearance)
        self._deadline, self._scanner_clearance = deadline, scanner_clearance
        self._library = BackupLibrary(limits, self.assumptions)
        self._detour = Detour(limits)
        self._monitors = Monitors(limits, self.assumptions)
        self._projector = HorizonProjector(limits, 1, solver, deadline=deadline)
        self._filter = SafetyFilter(limits, solver, deadline=deadline)
        self.reset()

    @property
    def previous(self) -> Array:
        """The last executed command [rad, m/s], shape (2,), read-only."""
        return self._filter.previous

    @property
    def committed(self) -> Array:
        """What is left of the committed motion [rad, m/s], shape (n, 2): it ends at rest."""
        return self._tail

    def reset(self, command: ArrayLike | None = None) -> None:
        """Forget world and commitment, and set the last executed command.

        Args:
            command: As of `SafetyFilter.reset`.

        Raises:
            InvalidProblem: The shape is not (2,).
        """
        self.world.reset()
        self.restart(command, self.world)

    def restart(self, command: ArrayLike | None, world: World) -> None:
        """Forget the commitment, but keep a world, which its owner updates."""
        self.world = world
        self._filter.reset(command)
        self._tail: Array = np.zeros((0, 2))
        self._backup = 0
        self._detour.reset()
        self._monitors.reset()

    def record(self, command: ArrayLike) -> None:
        """Correct what was executed, as `SafetyFilter.record`."""
        self._filter.record(command)

    def update(
        self,
        scan: ArrayLike,
        speed: float,
        yaw_rate: float,
        lane: LaneEstimate | None = None,
        age: float = 0.0,
    ) -> None:
        """Take a scan and a lane estimate; arguments and errors are those of `World.update`.

        A scan whose `age` [s] at the next command exceeds the assumed delay says nothing (A5).
        """
        check_numbers(age=age)
        ranges = as_array("scan", scan)
        late = not age <= self.assumptions.delay
        self.world.update(np.full_like(ranges, np.nan) if late else ranges, speed, yaw_rate, lane)
        if late and self.world.reading is not None:
            self.world.reading = replace(self.world.reading, age=age)

    @np.errstate(all="ignore")
    def filter(self, nominal: ArrayLike, plan: ArrayLike | None = None) -> Certificate:
        """Return the command to execute, and remember it as executed.

        Args:
            nominal: Command asked for [rad, m/s], shape (2,), any values.
            plan: As of `SafetyFilter.filter`; a driver who stands and whose plan goes on is led
                around what blocks the way.

        Returns:
            The certificate. `NOMINAL`: the nominal is certified, bit by bit. `PROJECTED`: the
            nearest certified candidate. `FALLBACK`: nothing certifies, and the committed backup
            goes on. The reason says which check of the nominal failed, by how much and when.

        Raises:
            InvalidProblem: A shape or a type does not fit.
        """
        begin = time.perf_counter()
        nominal_action = as_array("nominal", nominal, (2,)).copy()
        self.checks = checks = self._look()
        self.motion = self.refused = None
        flags = self._monitors.watch(self.world, self.previous)
        reason, command = f"nominal {nominal_action.tolist()} is not finite", None
        if np.isfinite(nominal_action).all():
            horizon = nominal_action[None] if plan is None else as_horizon("plan", plan)
            going = horizon[horizon[:, 1].argmax()]
            detour = self._detour.suggest(checks, going, self.previous, self.world.speed)
            asked = nominal_action if detour is None else detour
            asked = self._projector.project(asked[None], self.previous).actions[0]
            start = Start.of(self.world, self.previous)
            command, reason = self._certify(checks, start, asked)
            if command is None:
                command = self._nearest(checks, start, asked, begin + self._deadline)
        status = Status.PROJECTED
        if command is None:
            if not len(self._tail) and abs(self.world.speed) > REST:
                flags += ("A10: moves, and nothing is certified",)
            status, command = Status.FALLBACK, self._go_on()
            reason += "; the committed backup goes on"
        certificate = self._filter.filter(command, plan)
        changed = not np.array_equal(certificate.safe_action, nominal_action)
        nominal_action.flags.writeable = False
        return replace(
            certificate,
            nominal_action=nominal_action,
            correction=certificate.safe_action - nominal_action,
            status=status if changed else Status.NOMINAL,
            reason=reason or certificate.reason,
            intervened=changed,
            flags=flags,
            solve_time=time.perf_counter() - begin,
        )

    def _look(self) -> Certification:
        """The checks of this step."""
        return Certification(
            self.world,
            self.assumptions,
            self.geometry,
            self.limits.dt,
            self._library.braking,
            self._scanner_clearance,
        )

    def _order(self) -> list[int]:
        """The backups, the committed one first."""
        return sorted(range(len(BACKUPS)), key=lambda backup: backup != self._backup)

    def _certify(
        self, checks: Certification, start: Start, command: Array
    ) -> tuple[Array | None, str]:
        """Commit to a command with the first backup that certifies it, or say what the first lacks.

        A command that cannot be certified is None.
        """
        refusal, roomy = "", not self._detour.active
        for backup in self._order():
            motions = self._library.roll_out(start, command[None], backup)
            if checks.check(motions, roomy=roomy)[0]:
                self._commit(motions, 0, backup)
                return command, ""
            if self.refused is None:
                self.refused = motions
                name = f"backup {backup + 1} of {len(BACKUPS)} ({BACKUPS[backup]})"
                refusal = f"{name} {checks.refusal(motions)}"
        return None, refusal

    def _nearest(
        self, checks: Certification, start: Start, command: Array, deadline: float
    ) -> Array | None:
        """Commit to the certified candidate nearest to a command, in steps of the actuators."""
        candidates = self._candidates(command)
        best, chosen = len(candidates), None
        for backup in self._order():
            if best == 0 or time.perf_counter() > deadline:
                break
            # Of the further backups only what would be nearer is of interest.
            motions = self._library.roll_out(start, candidates[:best], backup)
            certified = checks.check(motions, roomy=not self._detour.active)
            if certified.any():
                best = int(certified.argmax())
                chosen = motions, best, backup
        if chosen is None:
            return None
        self._commit(*chosen)
        return np.asarray(candidates[best])

    def _candidates(self, command: Array) -> Array:
        """Up to 28 commands (n, 2) that the limits let follow on the last, the nearest first."""
        limits, (steering, speed) = self.limits, self.previous.tolist()
        low = max(limits.min_speed, speed - limits.deceleration_step)
        high = min(limits.max_speed, speed + limits.acceleration_step)
        between = high if abs(speed) < SLOW else 0.5 * (speed + low)
        speeds = np.array([float(command[1]), min(max(speed, low), high), between, low])
        left = min(steering + limits.steering_step, limits.max_steering)
        right = max(steering - limits.steering_step, -limits.max_steering)
        angles = np.clip(command[0] + STEERING_SHARES * limits.steering_step, right, left)
        pairs = np.stack(np.meshgrid(angles, speeds), axis=-1).reshape(-1, 2)
        if (most := limits.certain_bound) < math.inf:
            # Where the bound on the lateral acceleration is out of reach, the last one is held.
            sharpest = np.arctan(most * (1.0 - 1e-9) / np.maximum(pairs[:, 1] ** 2, 1e-6))
            bent = np.clip(pairs[:, 0], -sharpest, sharpest)
            reachable = (bent >= right) & (bent <= left)
            pairs = np.where(reachable[:, None], np.stack([bent, pairs[:, 1]], axis=1), command)
        pairs = np.array(list(dict.fromkeys(map(tuple, pairs.tolist()))))
        distance = (((pairs - command) / limits.step) ** 2).sum(axis=1)
        return np.asarray(pairs[np.argsort(distance, kind="stable")])

    def _commit(self, motions: Motions, row: int, backup: int) -> None:
        self._tail, self._backup = motions.commands[row, 1:].copy(), backup
        self.motion = motions.where(row)

    def _go_on(self) -> Array:
        """The next command of the committed motion; braking where there is none."""
        if len(self._tail):
            command, self._tail = self._tail[0], self._tail[1:]
            return np.array(command)
        steering, speed = self.previous.tolist()
        slower = max(0.0, speed - self.limits.deceleration_step)
        return np.array([steering, max(slower, self.limits.min_speed)])
