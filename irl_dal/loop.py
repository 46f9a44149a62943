"""One control step, from the sensors to the actuators.

    CityEnv ── camera, LiDAR, speed ──► estimation: lane, clearance, world
       ▲                                    │
       │                                 policy: nominal action
       │                                    ├──► trigger: where would it lead? ─ risky ─┐
       │                                    ▼                                           ▼
       │                                  blend ◄───────────── planner: denoise, guide, project
       │                                    │ set-point
       └── actuators ◄── SHIELD ◄── command ── set-point follower

Expert, policy and blend give set-points, which the one follower makes commands. The shield is
always there and always last, whatever the source of the command.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker
from numpy.typing import NDArray

from expert import ExpertDecision, FSMExpert
from irl_dal.arrays import Array, Info, Observation
from irl_dal.envs import CityEnv
from irl_dal.envs.road import LANES
from irl_dal.planner import DiffusionPlanner, Plan, PlanningContext
from irl_dal.planner.context import CONTEXT_SIZE, LARGEST
from shield import (
    ActuatorLimits,
    Assumptions,
    Certificate,
    ClearanceTracker,
    LaneTracker,
    Outlook,
    PredictiveFilter,
    Risk,
    RiskTrigger,
    SafetyFilter,
    SetpointFollower,
    TriggerConfig,
    World,
)
from shield.vehicle import yaw_rate_between

__all__ = ["SOURCES", "ControlLoop", "Observation", "Supervision"]

CREEP_SPEED = 2.0  # [m/s] least set-point of a stalled car: walking pace, enough to get away
CLEARANCE_MARGIN = 0.1  # [m] that the shield keeps beyond the distance that counts as a collision
HORIZON = 8  # [periods] of a set-point's commands: wheels turn from lock to lock, the car sets out
SOURCES = ("policy", "planner", "blend", "expert")  # of commands before the shield
TRANSPARENT = OrderEnforcing, PassiveEnvChecker  # wrappers of `gymnasium.make`: change nothing


@dataclass(frozen=True, slots=True)
class Supervision:
    """What stands between the nominal action and the actuators."""

    planner: DiffusionPlanner | None = None  # None leaves the nominal action alone
    # None lets every command pass (comparisons only)
    safety_filter: PredictiveFilter | SafetyFilter | None = None
    training: bool = False  # whether there is an expert to lend the planner its command (E_expert)


class ControlLoop(gymnasium.Wrapper[Observation, Array, Observation, NDArray[Any]]):
    """The city with estimation, trigger, planner, blend and shield around it.

    Observations are the city's and `context`, the estimates in 64 numbers (`PlanningContext`).
    The action given to `step` is the *nominal* one, a set-point; what reaches the actuators is in
    `info`:

    | key | meaning |
    |---|---|
    | expert, expert_action, mode | the expert's decision for the observation just returned |
    | lane, clearance_estimate, context | the estimates behind that observation |
    | risk | whether and why what was asked for was risky, by the estimates before this step |
    | nominal_action, nominal_command | what was asked for, and the command before the shield |
    | previous_command, executed_command, executed_action | what the actuators had and got |
    | triggered, plan, blend_weight | what the planner did in this step |
    | certificate | what the shield says of this step (None without a shield) |
    | nominal_violations | per source, whether its command broke a bound before the shield |

    Commands go to the city in physical units, past `step` of anything between the loop and the
    city. Wrappers belong around the loop, not around the city; those that `gymnasium.make` adds and
    that change nothing are accepted. `TypeError` if `env` is no city, or another wrapper is around
    it.
    """

    def __init__(
        self,
        env: CityEnv | gymnasium.Env[Observation, NDArray[Any]],
        expert: FSMExpert,
        supervision: Supervision,
        trigger: TriggerConfig,
    ) -> None:
        super().__init__(env)
        self.city: CityEnv = _unwrapped(env)
        code = gymnasium.spaces.Box(-LARGEST, LARGEST, (CONTEXT_SIZE,), np.float32)
        seen: Any = self.env.observation_space
        self.observation_space: Any = gymnasium.spaces.Dict({**seen.spaces, "context": code})
        self.limits: ActuatorLimits = self.city.limits
        self.supervision = supervision
        self._expert = expert
        self._follower = SetpointFollower(self.limits)
        self._scanner = self.city.config.scanner
        self._clearance = ClearanceTracker(self.limits.dt, self._scanner.max_range)
        self._lane = LaneTracker(self.limits.dt)
        self._centres = LANES.centres if trigger.passing_lane else LANES.centres[:1]
        self._trigger = RiskTrigger(trigger, self.limits.dt, self._centres)
        vehicle = self.city.config.vehicle
        self.world = World(self.limits.dt, self._scanner, vehicle, LANES)
        apart = self.city.config.collision_distance + CLEARANCE_MARGIN
        self._outlook = Outlook(self.limits, vehicle, Assumptions(), apart)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Info]:
        """Begin an episode; every memory of the last one is gone.

        `seed` decides road, traffic, light, noise of the sensors and of the planner.
        """
        observation, info = self.env.reset(seed=seed, options=options)
        self._previous: Array = np.array([0.0, self.city.config.initial_speed])
        self._before = self._previous
        self._risk = Risk(risky=False, reasons=(), lane_deviation=0.0)
        estimation = self._clearance, self._lane, self.world
        for part in (*estimation, self._trigger, self._outlook, self._expert):
            part.reset()
        self.restart_supervision(seed)
        info.update(self._assess(observation, info))
        return observation, info

    def restart_supervision(self, seed: int | None = None) -> None:
        """Let planner and shield forget the past, and go on from the last command.

        Without a seed the planner's random stream stays where it is.
        """
        planner, shield = self.supervision.planner, self.supervision.safety_filter
        if planner is not None:
            if seed is not None:
                planner.generator.manual_seed(seed)
            planner.reset()
        if isinstance(shield, PredictiveFilter):
            shield.restart(self._previous, self.world)
        elif shield is not None:
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
        """Drive one step from a normalised nominal action (2,), the set-point."""
        nominal = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0)
        setpoint, planner = self.limits.to_command(nominal), self.supervision.planner
        commands = self._approach(setpoint, HORIZON)
        own = command = commands[0]
        self._risk = self._judge(commands)
        plan, weight = (None, 0.0) if planner is None else self._plan(planner)
        sources = {"policy": own}
        if planner is not None and plan is not None:
            command = self.follow(self._blend(planner, plan, setpoint, weight))
            commands = plan.actions
            if self.supervision.safety_filter is None and planner.config.projection == "none":
                # Nothing at all keeps a plan within bounds: that is what is compared.
                command = planner.blend.blend(plan.actions[0], own, weight)
            sources |= {"planner": plan.actions[0], "blend": command}
        return self._execute(nominal, command, sources, commands, plan, weight)

    def step_expert(
        self, disturbance: Array | None = None
    ) -> tuple[Observation, float, bool, bool, Info]:
        """Drive one step to the expert's set-point, under the same shield.

        A disturbance (2,) [rad, m/s] is added to it, for demonstrations of recovery.
        """
        setpoint = self._decision.setpoint
        if disturbance is not None:
            setpoint = np.clip(setpoint + disturbance, self.limits.low, self.limits.high)
        commands = self._approach(setpoint, HORIZON)
        self._risk = self._judge(commands)
        action, command = self.limits.to_action(setpoint), commands[0]
        return self._execute(action, command, {"expert": command}, commands)

    def step_command(self, command: Array) -> tuple[Observation, float, bool, bool, Info]:
        """Drive one step with a command (2,) [rad, m/s] past planner and follower."""
        self._risk = self._judge(None)
        return self._execute(self.limits.to_action(command), command, {"policy": command})

    def follow(self, setpoint: Array) -> Array:
        """The command (2,) with which the follower goes on to a set-point (2,) [rad, m/s]."""
        return self._follower.follow(setpoint, self._previous, self._before)

    def _judge(self, commands: Array | None) -> Risk:
        """Whether commands (H, 2) are risky; without any only what is known counts."""
        needs_shield = False
        if commands is not None and self._trigger.config.form == "predicted":
            needs_shield = bool(self._outlook.refusal(self.world, commands, self._previous))
        speed = self._context.speed
        return self._trigger.update(self._distance, self._context.lane, speed, needs_shield)

    def _plan(self, planner: DiffusionPlanner) -> tuple[Plan | None, float]:
        """Trigger → plan, with its weight in the blend."""
        risk = self._risk
        # A plan needs a lane to go by; as printed it is asked for all the same.
        seen = self._context.lane.valid or self._trigger.config.form == "printed"
        needed = risk.risky and seen
        if not needed and planner.config.activation != "always":
            planner.blend.reset()
            return None, 0.0
        weight = planner.blend.weight(
            self._distance.clearance, risk.lane_deviation, stalled="stalled" in risk.reasons
        )
        return planner.plan(self._context), weight

    def _blend(self, planner: DiffusionPlanner, plan: Plan, own: Array, weight: float) -> Array:
        """The set-point (2,) of a plan, which is of commands, and the policy's own.

        Of a plan it is the command as far ahead as the follower is late: so the plan is driven.
        """
        late = np.minimum(self._follower.lead, len(plan.actions)) - 1
        setpoint = planner.blend.blend(plan.actions[late, [0, 1]], own, weight)
        if "stalled" in self._risk.reasons:
            # Plans that begin at rest may stay there; the shield stops what must not go on.
            setpoint[1] = max(setpoint[1], CREEP_SPEED)
        return setpoint

    def _execute(
        self,
        action: Array,
        command: Array,
        sources: dict[str, Array],
        horizon: Array | None = None,
        plan: Plan | None = None,
        weight: float = 0.0,
    ) -> tuple[Observation, float, bool, bool, Info]:
        """Shield the command, drive it and assess the state that follows.

        `horizon` (H, 2) is what is to follow, as far as it is known.
        """
        certificate: Certificate | None = None
        shield, executed = self.supervision.safety_filter, command
        if shield is not None:
            certificate = shield.filter(executed, plan=horizon)
            executed = certificate.safe_action
        before, self._previous = self._previous, np.array(executed, dtype=np.float64)
        # What the shield changed is not gone on with: the follower sets out from there.
        led = certificate is not None and certificate.intervened
        self._before = self._previous if led else before
        observation, reward, terminated, truncated, info = self.city.execute(self._previous)
        info.update(
            nominal_action=action,
            nominal_command=command,
            nominal_violations={
                name: bool(self.limits.violated(asked, before)) for name, asked in sources.items()
            },
            plan=plan,
            triggered=plan is not None,
            blend_weight=weight,
            previous_command=before,
            executed_command=self._previous,
            executed_action=self.limits.to_action(self._previous),
            certificate=certificate,
        )
        info.update(self._assess(observation, info))
        return observation, reward, terminated, truncated, info

    def _assess(self, observation: Observation, info: Info) -> Info:
        """Estimate, weigh the risk and ask the expert, all from sensors."""
        scan = observation["lidar"].astype(np.float64)
        speed = float(observation["speed"][0])
        before = info.get("previous_command", self._previous)
        ends, wheelbase = (before[0], self._previous[0]), self.limits.wheelbase
        yaw_rate = yaw_rate_between(*ends, speed, wheelbase)
        lane = self._lane.update(info["lane_measurement"], speed, yaw_rate)
        self.world.update(scan, speed, yaw_rate, lane)
        self._distance = self._clearance.update(self.world.clean)
        self._decision: ExpertDecision = self._expert.act(self.world, lane, self._previous)
        if self.render_mode is not None:
            risk, text = self._risk, self._decision.mode.name.lower().replace("_", " ")
            if risk.risky:
                text += f"   trigger: {', '.join(risk.reasons)}"
            self.city.overlay = risk.risky, text
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
        observation["context"] = self._context.encode()
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

    def _approach(self, setpoint: Array, horizon: int) -> Array:
        """The commands (horizon, 2) that follow a set-point (2,) [rad, m/s] from here."""
        return self._follower.approach(setpoint, self._previous, self._before, horizon)

    def _reference(self) -> Array | None:
        """The commands (H, 2) that follow the expert's set-point, in training."""
        planner = self.supervision.planner
        if planner is None or not self.supervision.training:
            return None
        return self._approach(self._decision.setpoint, planner.config.horizon)


def _unwrapped(env: gymnasium.Env[Any, Any]) -> CityEnv:
    """The city inside of wrappers that change nothing."""
    while isinstance(env, gymnasium.Wrapper):
        if type(env) not in TRANSPARENT:
            remedy = "which the loop would drive past: put that wrapper around the loop"
            raise TypeError(f"`env` is wrapped in {type(env).__name__}, {remedy}.")
        env = env.env
    if not isinstance(env, CityEnv):
        raise TypeError(f"`env` must be a CityEnv. Got {type(env).__name__}.")
    return env
