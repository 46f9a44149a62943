"""What one process needs to drive: the loop, the agent, and the expert's own supervision."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from irl_dal.build import (
    build_loop,
    build_planner,
    expert_supervision,
    load_run,
    supervision,
)
from irl_dal.config import RunConfig
from irl_dal.evaluation.agents import Agent, ExpertAgent, PolicyAgent, RandomAgent
from irl_dal.evaluation.episode import Episode
from irl_dal.evaluation.measurements import HeldOutActions, PathPair
from irl_dal.evaluation.rollout import compare_paths, drive_episode, drive_expert
from irl_dal.loop import ControlLoop, Supervision

__all__ = ["AgentSpec", "Bench", "PolicyName"]

PolicyName = Literal["run", "expert", "random"]


@dataclass(frozen=True, slots=True)
class AgentSpec:
    """Who is evaluated; small enough to be sent to another process.

    Attributes:
        policy: A trained run, the expert, or uniformly drawn actions.
        run_dir: Folder of the run, for `run`.
    """

    policy: PolicyName
    run_dir: Path | None = None

    def __post_init__(self) -> None:
        if (self.policy == "run") != (self.run_dir is not None):
            raise ValueError(
                f"`run_dir` belongs to the policy 'run'. Got {self.policy!r} and {self.run_dir}."
            )


@dataclass(slots=True)
class Bench:
    """A loop with an agent in it.

    Attributes:
        loop: The city under the agent's supervision.
        agent: Who is evaluated.
        reference: Supervision of the expert and of the random reference.
    """

    loop: ControlLoop
    agent: Agent
    reference: Supervision

    @classmethod
    def build(cls, config: RunConfig, spec: AgentSpec, render_mode: str | None = None) -> Bench:
        """Build everything from a configuration.

        Raises:
            CheckpointError: The run has no checkpoint that can be used.
        """
        planner = build_planner(config) if spec.policy == "run" else None
        loop = build_loop(config, supervision(config, planner), render_mode=render_mode)
        agent: Agent = ExpertAgent() if spec.policy == "expert" else RandomAgent()
        if spec.run_dir is not None:
            agent = PolicyAgent(load_run(config, spec.run_dir, loop, planner))
        return cls(loop, agent, expert_supervision(config))

    def drive(self, seed: int) -> Episode:
        """One episode of the agent."""
        return drive_episode(self.loop, self.agent, seed)

    def probe(self, seed: int) -> tuple[Episode, HeldOutActions]:
        """One episode of the expert, the agent answering in each state."""
        return drive_expert(self.loop, self.reference, self.agent, seed)

    def random_return(self, seed: int) -> float:
        """What uniformly drawn actions earn, under the same shield as the expert's."""
        own, self.loop.supervision = self.loop.supervision, self.reference
        try:
            return drive_episode(self.loop, RandomAgent(), seed).total_reward
        finally:
            self.loop.supervision = own

    def compare(self, stretch: tuple[Episode, list[int], int]) -> list[PathPair]:
        """Paths from the given steps of an expert's episode, over a horizon [steps]."""
        expert, steps, horizon = stretch
        return [
            compare_paths(self.loop, self.reference, self.agent, expert, step, horizon)
            for step in steps
        ]

    def close(self) -> None:
        """Leave the simulator."""
        self.loop.close()
