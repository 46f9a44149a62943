"""One control step, from the sensors to the actuators.

    CityEnv ── camera, LiDAR, speed ──► estimation ──► trigger ───────────┐
       ▲                                    │                             ▼ risky
       │                        policy ─────┴─► nominal action       planner: denoise,
       │                                              │              guide, project
       │                                              ▼                   │
       │                                            blend ◄─ first action ┘
       │                                              │
       └────── actuators ◄── SHIELD ◄─────────────────┘

The shield is always there and always last, whatever the source of the command.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from expert import ExpertDecision, FSMExpert
from irl_dal.envs import CityEnv, Overlay
from irl_dal.planner import ActionBlend, Activation, DiffusionPlanner, Plan, PlanningContext
from shield import (
    ActuatorLimits,
    BarrierConfig,
    Certificate,
    ClearanceTracker,
    CommandBounds,
    LaneTracker,
    ObstacleBarrier,
    RiskTrigger,
    SafetyFilter,
    TriggerConfig,
)

Array = NDArray[np.float64]
Observation = dict[str, NDArray[Any]]
Info = dict[str, Any]

CREEP = 2.0
"""Speed that a stalled car asks of its shield [m/s]: walking pace, fast enough to be under way."""

SOURCES = ("policy", "planner", "blend", "expert")
"""Where a command can come from before the shield."""


@dataclass(frozen=True, slots=True)
class Supervision:
    """Who watches over the nominal action.

    Attributes:
        planner: Proposes a horizon in risky states; None leaves the nominal action alone.
        blend: Mixes the plan's first action with the nominal one.
        activation: When the planner is asked: on the trigger, always or never.
        without_lane: On the trigger, ask it also where no lane is seen and nothing is near. It
            plans by the lane estimate; the policy has the camera.
        safety_filter: The shield; None lets every command pass (for comparisons only).
        expert_reference: Give the planner the expert's command as a reference (E_expert). The
            expert is there while learning, not in an evaluation.
    """

    planner: DiffusionPlanner | None = None
    blend: ActionBlend | None = None
    activation: Activation = "trigger"
    without_lane: bool = True
    safety_filter: SafetyFilter | None = None
    expert_reference: bool = False

    def __post_init__(self) -> None:
        if self.activation not in ("trigger", "always", "never"):
            raise ValueError(
                f"`activation` must be trigger, always or never. Got {self.activation!r}."
            )
        if (self.planner is None) != (self.blend is None):
            raise ValueError("`planner` and `blend` come together: give both or neither.")


class ControlLoop(gymnasium.Wrapper[Observation, Array, Observation, NDArray[Any]]):
    """The city with estimation, trigger, planner, blend and shield around it.

    The action given to `step` is the *nominal* one; what reaches the actuators is in `info`:

    | key | meaning |
    |---|---|
    | expert, expert_action, mode | the expert's decision for the observation just returned |
    | risk, lane, clearance_estimate, context | the estimates behind that observation |
    | nominal_action, nominal_command | what was asked for, before blending and after it |
    | previous_command, executed_command, executed_action | what the actuators had and got |
    | triggered, plan, blend_weight | what the planner did in this step |
    | certificate | what the shield says of this step (None without a shield) |
    | bounds | what the surroundings bounded this step to |
    | nominal_violations | per source, whether its command broke a bound before the shield |

    Args:
        env: The city.
        expert: Labels every state.
        supervision: Who watches over the nominal action.
        trigger: When a state is risky.
        barrier: How what is around the car bounds the shield's command; None for the limits alone.
    """

    def __init__(
        self,
        env: CityEnv | gymnasium.Env[Observation, NDArray[Any]],
        expert: FSMExpert,
        supervision: Supervision,
        trigger: TriggerConfig,
        barrier: BarrierConfig | None = None,
    ) -> None:
        super().__init__(env)
        city = env.unwrapped
        if not isinstance(city, CityEnv):
            raise TypeError(f"`env` must be a CityEnv. Got {type(city).__name__}.")
        self.city: CityEnv = city
        self.limits: ActuatorLimits = city.limits
        self.supervision = supervision
        self._expert = expert
        self._clearance = ClearanceTracker(self.limits.dt, max_range=city.config.lidar_range)
        self._lane = LaneTracker(self.limits.dt)
        self._trigger = RiskTrigger(trigger, self.limits.dt)
        self._centres = trigger.lane_centres
        self._barrier: ObstacleBarrier | None = None
        if barrier is not None and barrier.enabled:
            self._barrier = ObstacleBarrier(barrier, self.limits)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Info]:
        """Begin an episode; every memory of the last one is gone."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._previous: Array = np.array([0.0, self.city.config.initial_speed])
        watch = self.supervision
        for part in (self._clearance, self._lane, self._trigger, self._expert):
            part.reset()
        if watch.planner is not None and watch.blend is not None:
            watch.planner.reset()
            watch.blend.reset()
        if watch.safety_filter is not None:
            watch.safety_filter.reset(self._previous)
        if self._barrier is not None:
            self._barrier.reset()
        info.update(self._assess(observation, info))
        return observation, info

    def step(self, action: NDArray[Any]) -> tuple[Observation, float, bool, bool, Info]:
        """Drive one step from a normalised nominal action (2,)."""
        nominal = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0)
        own = self.limits.to_command(nominal)
        violations = {"policy": self.limits.violated(own, self._previous)}
        plan, weight, command = self._supervise(own)
        if plan is not None:
            violations["planner"] = self.limits.violated(plan.actions[0], self._previous)
            violations["blend"] = self.limits.violated(command, self._previous)
        record = {
            "nominal_action": nominal,
            "plan": plan,
            "triggered": plan is not None,
            "blend_weight": weight,
            "nominal_violations": violations,
        }
        return self._execute(command, plan, record)

    def step_expert(
        self, disturbance: Array | None = None
    ) -> tuple[Observation, float, bool, bool, Info]:
        """Drive one step with the expert's own command, under the same shield.

        Args:
            disturbance: Added to the command (2,) [rad, m/s], for demonstrations of recovery.
        """
        command = self._decision.command
        if disturbance is not None:
            command = np.clip(command + disturbance, self.limits.low, self.limits.high)
        record = {
            "nominal_action": self.limits.to_action(command),
            "plan": None,
            "triggered": False,
            "blend_weight": 0.0,
            "nominal_violations": {"expert": self.limits.violated(command, self._previous)},
        }
        return self._execute(command, None, record)

    def _supervise(self, own: Array) -> tuple[Plan | None, float, Array]:
        """Trigger → plan → blend: the plan, its weight and what is to be executed."""
        watch = self.supervision
        if watch.planner is None or watch.blend is None or watch.activation == "never":
            return None, 0.0, own
        plan: Plan | None = None
        weight, command = 0.0, own
        if watch.activation == "always" or self._planner_can_help():
            stalled = "stalled" in self._risk.reasons
            plan = watch.planner.plan(self._context)
            weight = watch.blend.weight(
                self._distance.clearance, self._risk.lane_deviation, stalled=stalled
            )
            # A plan's first action is one step away, a policy's may be many: of a far one even a
            # small share holds the wheels at the angle where it pulls as hard as the plan turns.
            own = watch.planner.project_command(own, self._previous)
            command = watch.blend.blend(plan.actions[0], own, weight)
            if stalled and watch.safety_filter is not None:
                # Plans that begin at rest may stay there; the shield stops what must not go on.
                going = np.array([command[0], max(command[1], CREEP)])
                command = watch.planner.project_command(going, self._previous)
        else:
            watch.blend.reset()
        if watch.safety_filter is None:  # with a shield, this is the shield's work
            command = watch.planner.project_command(command, self._previous)
        return plan, weight, command

    def _planner_can_help(self) -> bool:
        """Whether the state is risky, and something is known that a plan can go by."""
        risk = self._risk
        seen = self._context.lane.valid or bool({"clearance", "lidar_lost"} & set(risk.reasons))
        return risk.risky and (seen or self.supervision.without_lane)

    def _execute(
        self, command: Array, plan: Plan | None, record: Info
    ) -> tuple[Observation, float, bool, bool, Info]:
        """Shield the command, drive it and assess what comes of it."""
        certificate: Certificate | None = None
        executed, bounds, shield = command, CommandBounds(), self.supervision.safety_filter
        if shield is not None:
            if self._barrier is not None:
                bounds = self._barrier.bounds(command, float(self._previous[0]))
            certificate = shield.filter(
                command, plan=None if plan is None else plan.actions, bounds=bounds
            )
            executed = certificate.safe_action
        before, self._previous = self._previous, np.array(executed, dtype=np.float64)
        observation, reward, terminated, truncated, info = self.city.execute(self._previous)
        info.update(record)
        info.update(
            nominal_command=command,
            previous_command=before,
            executed_command=self._previous,
            executed_action=self.limits.to_action(self._previous),
            certificate=certificate,
            bounds=bounds,
        )
        info.update(self._assess(observation, info))
        return observation, reward, terminated, truncated, info

    def _assess(self, observation: Observation, info: Info) -> Info:
        """Estimate, weigh the risk and ask the expert, all from sensors."""
        scan = observation["lidar"].astype(np.float64)
        speed = float(observation["speed"][0])
        yaw_rate = speed * float(np.tan(self._previous[0])) / self.limits.wheelbase
        self._distance = self._clearance.update(scan, speed)
        lane = self._lane.update(info["lane_measurement"], speed, yaw_rate)
        if self._barrier is not None and self.supervision.safety_filter is not None:
            self._barrier.update(scan, speed, yaw_rate)
        self._risk = self._trigger.update(self._distance, lane, speed)
        self._decision: ExpertDecision = self._expert.act(scan, lane, speed, self._previous)
        self.city.overlay = Overlay(
            self._risk.risky,
            f"{self._decision.mode.name.lower().replace('_', ' ')}"
            + (f"   trigger: {', '.join(self._risk.reasons)}" if self._risk.risky else ""),
        )
        self._context = PlanningContext(
            scan=scan,
            clearance=self._distance,
            lane=lane,
            speed=speed,
            previous=self._previous,
            expert_reference=self._reference() if self.supervision.expert_reference else None,
            lane_centres=self._centres,
        )
        label = self.limits.to_action(self._decision.setpoint)
        return {
            "expert": self._decision,
            "expert_action": label.astype(np.float32),
            "mode": int(self._decision.mode),
            "risk": self._risk,
            "lane": lane,
            "clearance_estimate": self._distance,
            "context": self._context,
        }

    def _reference(self) -> Array:
        """The expert's set-point over the horizon, slew-limited from the last command (H, 2)."""
        planner = self.supervision.planner
        horizon = 1 if planner is None else planner.config.horizon
        return self._expert.approach(self._decision.setpoint, self._previous, horizon)
