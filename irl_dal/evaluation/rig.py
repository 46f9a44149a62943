"""What one process needs to drive: the loop, the agent, and the expert's own supervision."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

from irl_dal.build import build_loop, build_planner, expert_supervision, load_run, supervision
from irl_dal.config import RunConfig
from irl_dal.evaluation.agents import Agent, ExpertAgent, PolicyAgent, RandomAgent
from irl_dal.evaluation.episode import Episode
from irl_dal.evaluation.metrics import cloning_row, episode_record
from irl_dal.evaluation.rollout import compare_paths, drive_episode, drive_expert
from irl_dal.evaluation.statistics import Array
from irl_dal.loop import ControlLoop, Supervision

PolicyName = Literal["run", "expert", "random"]


@dataclass(frozen=True, slots=True)
class AgentSpec:
    """Who is evaluated, for `run` with its folder; small enough to be sent to another process."""

    policy: PolicyName
    run_dir: Path | None = None

    def __post_init__(self) -> None:
        if (self.policy == "run") != (self.run_dir is not None):
            raise ValueError(
                f"`run_dir` belongs to the policy 'run'. Got {self.policy!r} and {self.run_dir}."
            )


@dataclass(slots=True)
class Rig:
    """A loop with an agent in it, and what can be measured with it; results are ready for JSON."""

    loop: ControlLoop  # the city under the agent's supervision
    agent: Agent
    reference: Supervision  # of the expert and of the random reference

    @classmethod
    def build(cls, config: RunConfig, spec: AgentSpec, render_mode: str | None = None) -> Self:
        """Build everything; a CheckpointError if the run has no checkpoint that can be used."""
        planner = build_planner(config) if spec.policy == "run" else None
        loop = build_loop(config, supervision(config, planner), render_mode=render_mode)
        agent: Agent = ExpertAgent() if spec.policy == "expert" else RandomAgent()
        if spec.run_dir is not None:
            agent = PolicyAgent(load_run(config, spec.run_dir, loop, planner))
        return cls(loop, agent, expert_supervision(config))

    def drive(self, seed: int) -> Episode:
        """One episode of the agent."""
        return drive_episode(self.loop, self.agent, seed)

    def episode(self, seed: int) -> dict[str, Any]:
        """What is kept of one episode of the agent: `episode_record`."""
        return episode_record(self.drive(seed), self.loop.limits)

    def expert(self, seed: int) -> dict[str, Any]:
        """One episode of the expert, the agent answering in each state: return, path, cloning."""
        episode, answers = drive_expert(self.loop, self.reference, self.agent, seed)
        return {
            "seed": seed,
            "return": episode.total_reward,
            "pose": episode.pose.tolist(),
            "cloning": cloning_row(episode, answers),
        }

    def expert_return(self, seed: int) -> dict[str, Any]:
        """What the expert earns."""
        return self._return(ExpertAgent(), seed)

    def random_return(self, seed: int) -> dict[str, Any]:
        """What uniformly drawn actions earn, under the same shield as the expert's."""
        return self._return(RandomAgent(), seed)

    def path(self, stretch: tuple[int, int, Array]) -> dict[str, Any]:
        """Distances from the expert's path; a stretch is the seed, step and pose of it."""
        distances = compare_paths(self.loop, self.reference, self.agent, *stretch)
        return {"distances": distances.tolist()}

    def close(self) -> None:
        """Leave the simulator."""
        self.loop.close()

    def _return(self, agent: Agent, seed: int) -> dict[str, Any]:
        with self.loop.under(self.reference):
            return {"return": drive_episode(self.loop, agent, seed).total_reward}
