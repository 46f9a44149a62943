"""Between the control loop and the learner: what is stored, counted and handed on of every step."""

from __future__ import annotations

from collections import deque
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from expert.modes import Mode
from expert.replay import ReplayBuffer, Transition
from irl_dal.learning.disturbance import Disturbance
from irl_dal.learning.experience_correction import ExperienceCorrection
from irl_dal.learning.hybrid_reward import End
from irl_dal.loop import ControlLoop
from shield import Status

__all__ = ["Counts", "RecordedStep", "Recorder"]

Observation = dict[str, NDArray[Any]]


@dataclass(slots=True)
class Counts:
    """What happened so far, in numbers that only grow.

    Attributes:
        steps: Environment steps.
        episodes: Episodes that came to an end.
        successes: Of these, goal reached without any violation.
        collisions: Of these, ended by a collision.
        triggers: Steps on which the planner was used.
        plans_projected: Plans that the planner's projection changed.
        plan_fallbacks: Plans that were fallbacks.
        shield_corrections: Steps on which the shield changed the command.
        command_violations: Steps whose executed command broke a bound: must stay 0 with the shield.
        policy_violations: Steps on which the policy's own command would have broken a bound.
        reward: Sum of the environment reward.
        disagreement: Sum of mean abs(policy's own action - label) / 2 over the policy's steps.
    """

    steps: int = 0
    episodes: int = 0
    successes: int = 0
    collisions: int = 0
    triggers: int = 0
    plans_projected: int = 0
    plan_fallbacks: int = 0
    shield_corrections: int = 0
    command_violations: int = 0
    policy_violations: int = 0
    reward: float = 0.0
    disagreement: float = 0.0

    def minus(self, earlier: Counts) -> Counts:
        """What was added since `earlier`."""
        names = (entry.name for entry in fields(self))
        return Counts(**{name: getattr(self, name) - getattr(earlier, name) for name in names})


@dataclass(frozen=True, slots=True)
class RecordedStep:
    """The last step, for the rollout buffer.

    Attributes:
        reward: Environment reward.
        executed_action: (2,), normalised.
        label: The expert's action in the state acted upon (2,), normalised.
        mode: FSM state of the expert in the state acted upon.
        intervened: The planner acted.
        end: Whether and how the episode ended.
    """

    reward: float
    executed_action: NDArray[np.float32]
    label: NDArray[np.float32]
    mode: Mode
    intervened: bool
    end: End


@dataclass(slots=True)
class _Recent:
    """The newest episodes, for running means."""

    returns: deque[float] = field(default_factory=lambda: deque(maxlen=20))
    successes: deque[float] = field(default_factory=lambda: deque(maxlen=20))


class Recorder(gymnasium.Wrapper[Observation, NDArray[Any], Observation, NDArray[Any]]):
    """Writes every step into the replay buffer and keeps `info` small for stable-baselines3.

    Each episode's seed is drawn from `rng`, from `first_seed` on, so that evaluations with smaller
    seeds drive in places that training never saw.

    Args:
        loop: The control loop.
        replay: D_s.
        correction: Says whether intervened steps are stored.
        rng: Source of episode seeds.
        first_seed: Smallest seed of a training episode.
        disturbance: Pushes the expert aside now and then.
    """

    def __init__(
        self,
        loop: ControlLoop,
        replay: ReplayBuffer,
        correction: ExperienceCorrection,
        rng: np.random.Generator,
        first_seed: int,
        disturbance: Disturbance,
    ) -> None:
        super().__init__(loop)
        self.loop = loop
        self.counts = Counts()
        self.last: RecordedStep | None = None
        self._replay = replay
        self._correction = correction
        self._rng = rng
        self._first_seed = first_seed
        self._disturbance = disturbance
        self._recent = _Recent()
        self._episode = -1

    @property
    def episode_return(self) -> float:
        """Mean undiscounted environment reward of the newest 20 episodes; NaN before the first."""
        returns = self._recent.returns
        return float(np.mean(returns)) if returns else float("nan")

    @property
    def success_rate(self) -> float:
        """Share of successes in the newest 20 episodes; NaN before the first."""
        successes = self._recent.successes
        return float(np.mean(successes)) if successes else float("nan")

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode with the next seed (or the given one)."""
        drawn = int(self._rng.integers(self._first_seed, 2**31)) if seed is None else seed
        self._observation, self._info = self.loop.reset(seed=drawn, options=options)
        self._disturbance.reset()
        self._episode += 1
        self._step = 0
        self._return = 0.0
        return self._observation, {}

    def step(self, action: NDArray[Any]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive with the policy's normalised action."""
        error = np.abs(np.clip(action, -1.0, 1.0) - self._info["expert_action"]).mean() / 2.0
        self.counts.disagreement += float(error)
        return self._record(self.loop.step(action), expert_drove=False)

    def step_expert(self) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive with the expert's command; a disturbed step is not part of a demonstration."""
        offset = self._disturbance.step()
        return self._record(self.loop.step_expert(offset), expert_drove=offset is None)

    def state_dict(self) -> dict[str, Any]:
        """Counts and random state; the episode in progress is not kept."""
        return {
            "counts": asdict(self.counts),
            "episode": self._episode,
            "rng": self._rng.bit_generator.state,
            "returns": list(self._recent.returns),
            "successes": list(self._recent.successes),
            "marks": self._correction.marks,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take over the state of `state_dict`; the next thing must be a `reset`."""
        self.counts = Counts(**state["counts"])
        self._episode = state["episode"]
        self._rng.bit_generator.state = state["rng"]
        self._recent.returns.extend(state["returns"])
        self._recent.successes.extend(state["successes"])
        self._correction.marks = state["marks"]

    def _record(
        self,
        result: tuple[Observation, float, bool, bool, dict[str, Any]],
        *,
        expert_drove: bool,
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = result
        label = np.asarray(self._info["expert_action"], np.float32)
        executed = np.asarray(info["executed_action"], np.float32)
        mode, intervened = Mode(self._info["mode"]), bool(info["triggered"])
        if self._correction.keeps(intervened):
            self._replay.add(
                Transition(
                    image=self._observation["image"],
                    lidar=self._observation["lidar"],
                    speed=self._observation["speed"],
                    context=self._info["context"].encode(),
                    label=label,
                    command=executed,
                    mode=mode,
                    episode=self._episode,
                    step=self._step,
                    reward=reward,
                    terminated=terminated,
                    intervened=intervened,
                    expert_drove=expert_drove,
                )
            )
        end = _end(terminated, truncated, bool(info["success"]))
        self.last = RecordedStep(reward, executed, label, mode, intervened, end)
        self._count(reward, info, end)
        self._observation, self._info = observation, info
        self._step += 1
        small = {} if end is End.GOES_ON else {"is_success": bool(info["success"])}
        return observation, reward, terminated, truncated, small

    def _count(self, reward: float, info: dict[str, Any], end: End) -> None:
        counts, plan, certificate = self.counts, info["plan"], info["certificate"]
        counts.steps += 1
        counts.reward += reward
        counts.triggers += bool(info["triggered"])
        if plan is not None:
            counts.plans_projected += plan.status in (Status.PROJECTED, Status.REPAIRED)
            counts.plan_fallbacks += plan.status is Status.FALLBACK
        counts.shield_corrections += certificate is not None and certificate.intervened
        counts.command_violations += self.loop.limits.violated(
            info["executed_command"], info["previous_command"]
        )
        counts.policy_violations += bool(info["nominal_violations"].get("policy", False))
        self._return += reward
        if end is not End.GOES_ON:
            counts.episodes += 1
            counts.successes += end is End.SUCCESS
            counts.collisions += bool(info["collision"])
            self._recent.returns.append(self._return)
            self._recent.successes.append(float(end is End.SUCCESS))


def _end(terminated: bool, truncated: bool, success: bool) -> End:
    if terminated:
        return End.SUCCESS if success else End.FAILURE
    return End.TIME_LIMIT if truncated else End.GOES_ON
