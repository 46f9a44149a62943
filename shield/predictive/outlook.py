"""What becomes of a driver who goes on: whether the shield would be needed before long."""

import numpy as np

from shield.errors import Array
from shield.limits.actuator_limits import ActuatorLimits
from shield.predictive.assumptions import Assumptions
from shield.predictive.backups import BACKUPS, BackupLibrary, Start
from shield.predictive.certification import Certification
from shield.vehicle import VehicleGeometry
from shield.world.world import World

__all__ = ["Outlook"]


class Outlook:
    """Rolls commands out and asks whether they leave the car where a backup is certified.

    Args:
        limits: Limits of the vehicle.
        geometry: Outline of the car.
        assumptions: What the shield's promise rests on.
        scanner_clearance: As of `PredictiveFilter`.
    """

    def __init__(
        self,
        limits: ActuatorLimits,
        geometry: VehicleGeometry,
        assumptions: Assumptions,
        scanner_clearance: float = 0.0,
    ) -> None:
        self._dt, self._geometry, self._assumptions = limits.dt, geometry, assumptions
        self._scanner_clearance = scanner_clearance
        self._library = BackupLibrary(limits, assumptions)
        self.reset()

    def reset(self) -> None:
        """Forget which backup was the last that could follow."""
        self._last = 0

    @np.errstate(all="ignore")
    def refusal(self, world: World, commands: Array, previous: Array) -> str:
        """Why commands (n, 2) [rad, m/s] that go on from `previous` (2,) cannot be certified.

        Empty where they can: then the car could still stop after the last one, clear of everything
        and in its lanes, and would be on all the way.
        """
        checks = Certification(
            world,
            self._assumptions,
            self._geometry,
            self._dt,
            self._library.braking,
            self._scanner_clearance,
            lead=len(commands),
        )
        start, reason = Start.of(world, previous), ""
        for backup in sorted(range(len(BACKUPS)), key=lambda number: number != self._last):
            motions = self._library.roll_out(start, commands[None], backup)
            if checks.check(motions)[0]:
                self._last = backup
                return ""
            reason = reason or checks.refusal(motions)
        return reason
