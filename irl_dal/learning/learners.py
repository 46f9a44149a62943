"""Everything that learns, one method for each update of Algorithm 1."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from expert.replay import ReplayBatch, ReplayBuffer
from irl_dal.cli.threads import GRADIENT_THREADS, threads
from irl_dal.learning.collection.recorder import EpisodeEnd
from irl_dal.learning.config import LearningConfig
from irl_dal.learning.imitation.behaviour_cloning import BehaviourCloning
from irl_dal.learning.imitation.diffusion_training import DiffusionTraining
from irl_dal.learning.reinforcement.discriminator import Discriminator, Seen
from irl_dal.learning.reinforcement.hybrid_reward import HybridReward
from irl_dal.learning.reinforcement.policy import appraise, observation_tensors
from irl_dal.learning.reinforcement.ppo import DrivingPPO
from irl_dal.learning.reinforcement.rollout_buffer import HybridRolloutBuffer, flat


@dataclass
class Learners:
    """Policy, planner and discriminator with the data that they learn from.

    What an update has to report goes into PPO's logger, and from there into the next row of
    metrics.
    """

    config: LearningConfig
    ppo: DrivingPPO  # owns the policy
    replay: ReplayBuffer  # D_s
    cloning: BehaviourCloning
    diffusion: DiffusionTraining | None  # trains the planner; None without one
    discriminator: Discriminator
    rng: np.random.Generator  # draws from the replay buffer
    threads: int = GRADIENT_THREADS  # on which an update computes

    @property
    def reward(self) -> HybridReward:
        """Mixes the rewards of a rollout."""
        return HybridReward(self.config.reward, self.config.ppo.gamma)

    def clone(self, steps: int) -> None:
        """TrainBC(D_buffer): gradient steps, then the held-out loss and the plateau scheduler."""
        if self.replay.count() == 0:
            return
        record = self.ppo.logger.record
        with threads(self.threads):
            loss = self.cloning.update(self._cloning_batch, steps)
            held_out = self.cloning.validate(self.replay, self.rng)
        record("bc/train_loss", loss)
        if held_out:
            mean = float(np.mean(list(held_out.values())))
            self.cloning.plateau(mean)
            record("bc/loss", mean)
            for mode, loss in held_out.items():
                record(f"bc/loss_{mode.name.lower()}", loss)
        record("bc/learning_rate", self.cloning.learning_rate)
        for name, parameter in self.ppo.policy.features_extractor.named_parameters():
            if "alpha" in name:
                record(f"mask/{name.rpartition('.')[2]}", parameter.item())

    def train_planner(self, steps: int) -> None:
        """TrainDiffusion(D_buffer), if there is a planner and any stretch of expert driving."""
        if self.diffusion is None or self.replay.count(source="chunk") == 0:
            return
        record = self.ppo.logger.record
        with threads(self.threads):
            loss = self.diffusion.update(self.replay, steps, balanced=self.config.balanced)
            held_out = self.diffusion.validate(self.replay)
        record("planner/train_loss", loss)
        if held_out is not None:
            record("planner/loss", held_out)
        record("planner/learning_rate", self.diffusion.learning_rate)

    def train_discriminator(self) -> None:
        """TrainDiscriminator(D_buffer): expert pairs against those of the rollout in progress."""
        buffer = self.ppo.rollout_buffer
        if buffer.pos == 0 or self.replay.count(source="expert") == 0:
            return
        size, balanced = self.config.discriminator.samples, self.config.balanced
        with threads(self.threads):
            batch = self.replay.sample(self.rng, size, balanced=balanced, source="expert")
            expert = observation_tensors(batch), torch.from_numpy(batch.commands)
            report = self.discriminator.update(expert, self._agent_pairs(buffer))
        for name, value in report.items():
            self.ppo.logger.record(f"discriminator/{name}", value)

    def finish_rollout(self, last_values: Tensor) -> None:
        """Give the complete rollout its mixed rewards, returns and advantages.

        `last_values` (E, 1) are of what each car sees after its last step.
        """
        ppo, buffer = self.ppo, self.ppo.rollout_buffer
        seen, logits, renewed = buffer.seen(), None, None
        if self.discriminator.updates:
            actions = torch.from_numpy(flat(buffer.executed_actions))
            logits = self.discriminator.judge(_tensors(seen), actions).numpy()
        if self.config.ppo.renew:
            renewed = appraise(ppo.policy, seen, flat(buffer.actions))
        buffer.finish(self.reward, logits, renewed, last_values)
        for name, rewards in (("env", buffer.env_rewards), ("imitation", buffer.imitation_rewards)):
            ppo.logger.record(f"reward/{name}", float(rewards.mean()))
        ppo.logger.record("reward/failures", int((buffer.ends == EpisodeEnd.FAILURE).sum()))

    def _cloning_batch(self) -> ReplayBatch:
        config, replay = self.config.cloning, self.replay
        balanced = self.config.balanced
        marked = int(config.corrected_share * config.batch_size)
        if marked == 0 or replay.count(source="corrected") == 0:
            return replay.sample(self.rng, config.batch_size, balanced=balanced)
        return ReplayBatch.join(
            replay.sample(self.rng, config.batch_size - marked, balanced=balanced),
            replay.sample(self.rng, marked, balanced=balanced, source="corrected"),
        )

    def _agent_pairs(self, buffer: HybridRolloutBuffer) -> Seen:
        modes = flat(buffer.modes[: buffer.pos])
        size = min(self.config.discriminator.samples, len(modes))
        # Both sides alike: otherwise the modes alone tell them apart, whatever the actions.
        rows = _evenly(self.rng, modes if self.config.balanced else 0 * modes, size)
        seen = {k: flat(values[: buffer.pos])[rows] for k, values in buffer.observations.items()}
        return _tensors(seen), torch.from_numpy(flat(buffer.executed_actions)[rows])


def _evenly(rng: np.random.Generator, modes: NDArray[np.int8], size: int) -> NDArray[np.int64]:
    """Draw rows with replacement, each of the modes that occur as often as the others."""
    present = np.unique(modes)
    share = np.bincount(np.arange(size) % len(present), minlength=len(present))
    drawn = [
        rng.choice(np.flatnonzero(modes == mode), size=count)
        for mode, count in zip(present, share, strict=True)
    ]
    return np.concatenate(drawn)


def _tensors(observations: dict[str, NDArray[np.generic]]) -> dict[str, Tensor]:
    return {key: torch.from_numpy(np.ascontiguousarray(v)) for key, v in observations.items()}
