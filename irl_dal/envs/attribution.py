"""Whose fault a contact or a departure is: the simulator sees everything, so it can tell.

`at_fault` is the rule; the exceptions are few, and the strictest reading of each is taken:

| verdict | when |
|---|---|
| at_rest | the ego stood before the step and was told to stand in it |
| hit_by_other | a body that moves faster along the ego's heading came from behind its rear bumper |
| assumption:A1 | the body itself moved in the last `MEMORY` as nobody may: see `keeps_a1` |
| assumption:A3 | contact; bursts of noise, or three deviations of a range above its error |
| assumption:A5 | observations are late |
| assumption:A6 | actuators lag, or the servo is slower than the steering limit |
| assumption:A9 | departure; the camera has stood still |

Nothing else is excused. Dead and stuck beams are no assumption of the shield's but its work (A4);
what comes unseen from outside the field of view (A8) and a lane estimate that is wrong although the
camera works (A9) count as the ego's fault, so that the default city knows no excuse at all.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from irl_dal.arrays import Array, Info
from irl_dal.envs.config import CityConfig
from irl_dal.envs.faults import SensorFaults
from irl_dal.envs.road import HALF_WIDTH, LANE_WIDTH, Road, RoadPoint
from irl_dal.envs.traffic import Obstacle
from irl_dal.envs.vehicle import VehicleState
from shield import ActuatorLimits, Assumptions, VehicleGeometry

REST = 0.1  # [m/s] a slower car is at rest
MEMORY = 3.0  # [s] for which a broken assumption explains what happens: longer than any stop takes
BEHIND = 0.2  # [m] by which a body behind the ego may overlap it before the step: rounded corners
ASIDE = 0.1  # [m/s] and [m] by which a vehicle that keeps its lane may move in it, and out of it
ROUNDING = 1e-6  # Of differences of positions [m/s]
SIGMAS = 3.0  # Deviations of a range within `range_error`: all but one in 370 readings

PROMISED = Assumptions()  # What the shield counts on by default


@dataclass(frozen=True, slots=True)
class Event:
    """What the physics engine says of a step."""

    before: VehicleState  # Of the ego before the step
    command: float  # Speed that its motors were told [m/s]
    touched: frozenset[int]  # Bodies that it touches after the step
    departed: bool  # Whether a corner is beyond the edges of its lanes after the step


def departs(road: Road, state: VehicleState, at: RoadPoint, vehicle: VehicleGeometry) -> bool:
    """Whether a corner of the body is beyond the yellow line or the right-hand edge."""
    cos, sin = float(np.cos(state.yaw)), float(np.sin(state.yaw))
    for ahead in (vehicle.front_bumper, -vehicle.rear_overhang):
        for left in (0.5 * vehicle.width, -0.5 * vehicle.width):
            x, y = state.x + cos * ahead - sin * left, state.y + sin * ahead + cos * left
            if not -HALF_WIDTH <= road.locate(x, y, at.index).d <= 0.0:
                return True
    return False


def keeps_a1(body: Obstacle, velocity: Array, before: Array, dt: float) -> bool:
    """Whether a body moves as A1 allows; velocities (2,) along the road and to its left [m/s].

    Pedestrians and barrels are slower than `person_speed` and gain speed by no more than
    `person_acceleration`; they may stop at once. Vehicles stay in their lane and go its way.
    """
    if body.kind != "car":
        speed, most = math.hypot(*velocity), math.hypot(*before) + PROMISED.person_acceleration * dt
        return speed <= min(PROMISED.person_speed, most) + ROUNDING
    lane = (math.floor(body.d / LANE_WIDTH) + 0.5) * LANE_WIDTH
    inside = abs(body.d - lane) + 0.5 * body.size[1] <= 0.5 * LANE_WIDTH + ASIDE
    way = -1.0 if body.d > 0.0 else 1.0
    return bool(inside and abs(velocity[1]) <= ASIDE and way * velocity[0] >= -ROUNDING)


class Attribution:
    """Watches the traffic and judges each step; one for each episode."""

    def __init__(
        self,
        config: CityConfig,
        limits: ActuatorLimits,
        road: Road,
        bodies: Sequence[Obstacle],
        sensors: SensorFaults,
    ) -> None:
        self._config, self._limits, self._dt = config, limits, limits.dt
        self._road, self._bodies, self._sensors = road, bodies, sensors
        self._places = self._place()
        self._velocity = np.zeros_like(self._places)
        self._moved_wrongly = np.full(len(bodies), np.inf)  # Time since each broke A1 [s]
        self._since = {"burst": np.inf, "frozen": np.inf}  # Likewise since a sensor's fault
        self._contact = self._departure = False

    def judge(self, event: Event) -> Info:
        """`contact`, `departure` and, where one begins, `fault`, after a step of everything."""
        behind, self._places = self._places, self._place()
        self._watch(behind)
        verdicts = []
        contact, departure = bool(event.touched), event.departed
        if contact and not self._contact:
            verdicts += [
                self._of_contact(event, number, behind[number])
                for number, body in enumerate(self._bodies)
                if event.touched & {part[0] for part in body.bodies}
            ] or ["at_fault"]
        if departure and not self._departure:
            verdicts.append(self._excuse("A5", "A6", "A9") or "at_fault")
        self._contact, self._departure = contact, departure
        fault = min(verdicts, key=_severity) if verdicts else None
        return {"contact": contact, "departure": departure, "fault": fault}

    def _place(self) -> Array:
        return np.array([(body.s, body.d) for body in self._bodies]).reshape(-1, 2)

    def _watch(self, behind: Array) -> None:
        """Take note of what breaks an assumption in this step."""
        before, self._velocity = self._velocity, (self._places - behind) / self._dt
        self._moved_wrongly += self._dt
        rows = zip(self._bodies, self._velocity, before, strict=True)
        for number, row in enumerate(rows):
            if not keeps_a1(*row, self._dt):
                self._moved_wrongly[number] = 0.0
        now = {"burst": self._sensors.bursting, "frozen": self._sensors.frozen}
        self._since = {
            name: 0.0 if now[name] else age + self._dt for name, age in self._since.items()
        }

    def _of_contact(self, event: Event, number: int, place: Array) -> str:
        """The verdict on touching a body that was at `place` (s, d) [m] before the step."""
        ego, vehicle = event.before, self._config.vehicle
        if abs(ego.speed) < REST and abs(event.command) < REST:
            return "at_rest"
        x, y, yaw = self._road.pose(*place)
        cos, sin = np.cos(ego.yaw), np.sin(ego.yaw)
        front = cos * (x - ego.x) + sin * (y - ego.y) + 0.5 * self._bodies[number].size[0]
        along, aside = self._velocity[number]
        pace = along * np.cos(yaw - ego.yaw) - aside * np.sin(yaw - ego.yaw)
        if front < BEHIND - vehicle.rear_overhang and pace > max(ego.speed, REST):
            return "hit_by_other"
        if self._moved_wrongly[number] <= MEMORY:
            return "assumption:A1"
        return self._excuse("A3", "A5", "A6") or "at_fault"

    def _excuse(self, *relevant: str) -> str | None:
        """The first of these assumptions that sensors and actuators break."""
        config, faults = self._config, self._config.faults
        noisy = SIGMAS * config.lidar_noise > PROMISED.range_error
        lame = faults.actuator_lag > 0.0 or faults.servo_rate < self._limits.max_steering_rate
        broken = {
            "A3": noisy or self._since["burst"] <= MEMORY,
            "A5": faults.latency * self._dt > PROMISED.delay,
            "A6": lame,
            "A9": self._since["frozen"] <= MEMORY,
        }
        return next((f"assumption:{name}" for name in relevant if broken[name]), None)


def _severity(verdict: str) -> int:
    """The worst first: a body that is hit by others may be at fault with one of them."""
    return ("at_fault", "assumption", "hit_by_other", "at_rest").index(verdict.split(":")[0])
