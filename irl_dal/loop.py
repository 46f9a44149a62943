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

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker
from numpy.typing import NDArray

from expert import ExpertDecision, FSMExpert
from irl_dal.envs import CityEnv, Overlay
from irl_dal.planner import DiffusionPlanner, Plan, PlanningContext
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

__all__ = ["SOURCES", "ControlLoop", "Info", "Observation", "Supervision"]

Array = NDArray[np.float64]
Observation = dict[str, NDArray[Any]]
Info = dict[str, Any]

CREEP_SPEED = 2.0  # [m/s] least speed of a stalled car's command: walking pace, enough to get away
SOURCES = ("policy", "planner", "blend", "expert")  # of commands before the shield
TRANSPARENT = (
    OrderEnforcing,
    PassiveEnvChecker,
)  # wrappers of `gymnasium.make` that change nothing


@dataclass(frozen=True, slots=True)
class Supervision:
    """What stands between the nominal action and the actuators.

    Attributes:
        planner: Proposes a horizon, when its configuration says so; None leaves the nominal action
            alone.
        safety_filter: The shield; None lets every command pass (for comparisons only).
        training: Whether there is an expert to lend the planner its command (E_expert).
    """

    planner: DiffusionPlanner | None = None
    safety_filter: SafetyFilter | None = None
    training: bool = False


@dataclass(frozen=True, slots=True)
class _Nominal:
    """What a step asks for before the shield, as the keys of `info` call it."""

    action: Array
    command: Array
    violations: dict[str, bool]
    plan: Plan | None = None
    weight: float = 0.0


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

    Commands go to the city in physical units, past `step` of anything between the loop and the
    city. Wrappers belong around the loop, not around the city; those that `gymnasium.make` adds and
    that change nothing are accepted.

    Args:
        env: The city.
        expert: Labels every state.
        supervision: What stands between the nominal action and the actuators.
        trigger: When a state is risky.
        barrier: How what is around the car bounds the shield's command; None for the limits alone.

    Raises:
        TypeError: `env` is no city, or a wrapper is around it.
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
        self.city: CityEnv = _unwrapped(env)
        self.limits: ActuatorLimits = self.city.limits
        self.supervision = supervision
        self._expert = expert
        self._scanner = self.city.config.scanner
        self._clearance = ClearanceTracker(self.limits.dt, self._scanner.max_range)
        self._lane = LaneTracker(self.limits.dt)
        centres = self.city.config.lanes.centres
        self._centres = centres if trigger.passing_lane else centres[:1]
        self._trigger = RiskTrigger(trigger, self.limits.dt, self._centres)
        self._barrier: ObstacleBarrier | None = None
        if barrier is not None and barrier.enabled:
            self._barrier = ObstacleBarrier(
                barrier, self.limits, self._scanner, self.city.config.vehicle
            )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Info]:
        """Begin an episode; every memory of the last one is gone.

        Args:
            seed: Of the episode: road, traffic, light, noise of the sensors and of the planner.
            options: As in `CityEnv.reset`.
        """
        observation, info = self.env.reset(seed=seed, options=options)
        self._previous: Array = np.array([0.0, self.city.config.initial_speed])
        for part in (self._clearance, self._lane, self._trigger, self._expert):
            part.reset()
        if self._barrier is not None:
            self._barrier.reset()
        self.restart_supervision(seed)
        info.update(self._assess(observation, info))
        return observation, info

    def restart_supervision(self, seed: int | None = None) -> None:
        """Let planner, blend and shield forget the past, and go on from the last command.

        Args:
            seed: Of the planner's noise; None leaves its random stream where it is.
        """
        planner, shield = self.supervision.planner, self.supervision.safety_filter
        if planner is not None:
            if seed is not None:
                planner.generator.manual_seed(seed)
            planner.reset()
            planner.blend.reset()
        if shield is not None:
            shield.reset(self._previous)

    @contextmanager
    def under(self, supervision: Supervision) -> Iterator[None]:
        """Drive under another supervision for a while."""
        own, self.supervision = self.supervision, supervision
        try:
            yield
        finally:
            self.supervision = own

    def step(self, action: NDArray[Any]) -> tuple[Observation, float, bool, bool, Info]:
        """Drive one step from a normalised nominal action (2,)."""
        nominal = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0)
        own = self.limits.to_command(nominal)
        violations = {"policy": self._is_violated(own)}
        plan, weight, command = self._supervise(own)
        if plan is not None:
            violations["planner"] = self._is_violated(plan.actions[0])
            violations["blend"] = self._is_violated(command)
        return self._execute(_Nominal(nominal, command, violations, plan, weight))

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
        violations = {"expert": self._is_violated(command)}
        return self._execute(_Nominal(self.limits.to_action(command), command, violations))

    def _is_violated(self, command: Array) -> bool:
        """Whether a command (2,) breaks a bound after the last executed one."""
        return bool(self.limits.violated(command, self._previous))

    def _supervise(self, own: Array) -> tuple[Plan | None, float, Array]:
        """Trigger → plan → blend: the plan, its weight and the command (2,) [rad, m/s]."""
        planner, unshielded = self.supervision.planner, self.supervision.safety_filter is None
        if planner is None or planner.config.activation == "never":
            return None, 0.0, own
        plan, weight, command = None, 0.0, own
        if planner.config.activation == "always" or self._planner_can_help(planner):
            stalled = "stalled" in self._risk.reasons
            plan = planner.plan(self._context)
            weight = planner.blend.weight(
                self._distance.clearance, self._risk.lane_deviation, stalled=stalled
            )
            # A plan's first action is one step away, a policy's may be many: of a far one even a
            # small share holds the wheels at the angle where it pulls as hard as the plan turns.
            own = planner.project_command(own, self._previous)
            command = planner.blend.blend(plan.actions[0], own, weight)
            if stalled and not unshielded:
                # Plans that begin at rest may stay there; the shield stops what must not go on.
                moving = np.array([command[0], max(command[1], CREEP_SPEED)])
                command = planner.project_command(moving, self._previous)
        else:
            planner.blend.reset()
        if unshielded:  # with a shield, this is the shield's work
            command = planner.project_command(command, self._previous)
        return plan, weight, command

    def _planner_can_help(self, planner: DiffusionPlanner) -> bool:
        """Whether the state is risky, and a plan has something to go by."""
        risk = self._risk
        seen = self._context.lane.valid or bool({"clearance", "lidar_lost"} & set(risk.reasons))
        return risk.risky and (seen or planner.config.without_lane)

    def _execute(self, nominal: _Nominal) -> tuple[Observation, float, bool, bool, Info]:
        """Shield the command, drive it and assess the state that follows."""
        certificate: Certificate | None = None
        bounds, shield, plan = CommandBounds(), self.supervision.safety_filter, nominal.plan
        executed = nominal.command
        if shield is not None:
            if self._barrier is not None:
                bounds = self._barrier.bounds(executed, float(self._previous[0]))
            certificate = shield.filter(
                executed, plan=None if plan is None else plan.actions, bounds=bounds
            )
            executed = certificate.safe_action
        before, self._previous = self._previous, np.array(executed, dtype=np.float64)
        observation, reward, terminated, truncated, info = self.city.execute(self._previous)
        info.update(
            nominal_action=nominal.action,
            nominal_command=nominal.command,
            nominal_violations=nominal.violations,
            plan=plan,
            triggered=plan is not None,
            blend_weight=nominal.weight,
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
        if self.render_mode is not None:
            self.city.overlay = self._overlay()
        self._context = PlanningContext(
            scan=scan,
            clearance=self._distance,
            lane=lane,
            speed=speed,
            previous=self._previous,
            expert_reference=self._reference(),
            lane_centres=self._centres,
            scanner=self._scanner,
            vehicle=self.city.config.vehicle,
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

    def _overlay(self) -> Overlay:
        """The expert's mode and the trigger's reasons, for the rendered view."""
        text = self._decision.mode.name.lower().replace("_", " ")
        if self._risk.risky:
            text += f"   trigger: {', '.join(self._risk.reasons)}"
        return Overlay(self._risk.risky, text)

    def _reference(self) -> Array | None:
        """The expert's set-point over the horizon, slew-limited from the last command (H, 2)."""
        planner = self.supervision.planner
        if planner is None or not (self.supervision.training and planner.config.expert_reference):
            return None
        horizon = planner.config.horizon
        return self._expert.approach(self._decision.setpoint, self._previous, horizon)


def _unwrapped(env: gymnasium.Env[Any, Any]) -> CityEnv:
    """The city inside of wrappers that change nothing."""
    layer: gymnasium.Env[Any, Any] = env
    while isinstance(layer, gymnasium.Wrapper):
        if type(layer) not in TRANSPARENT:
            raise TypeError(
                f"`env` is wrapped in {type(layer).__name__}, which the loop would drive past: "
                "put that wrapper around the loop."
            )
        layer = layer.env
    if not isinstance(layer, CityEnv):
        raise TypeError(f"`env` must be a CityEnv. Got {type(layer).__name__}.")
    return layer
