"""The schedule of Algorithm 1 and what belongs to it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

from irl_dal.learning.imitation.behaviour_cloning import CloningConfig
from irl_dal.learning.imitation.diffusion_training import DiffusionTrainingConfig
from irl_dal.learning.imitation.disturbance import DisturbanceConfig
from irl_dal.learning.imitation.experience_correction import CorrectionForm
from irl_dal.learning.reinforcement.discriminator import DiscriminatorConfig
from irl_dal.learning.reinforcement.hybrid_reward import HybridRewardConfig
from irl_dal.learning.reinforcement.policy import PPOConfig

__all__ = ["LearningConfig"]

Sampling = Literal["balanced", "uniform"]

INTERVALS = (
    "bc_interval_imitation",
    "bc_interval_mixed",
    "diffusion_interval",
    "discriminator_interval",
    "sync_interval",
    "checkpoint_interval",
    "log_interval",
)


@dataclass(frozen=True, slots=True)
class LearningConfig:
    """Algorithm 1 with the numbers of Table II; what is not in Table II says so.

    Attributes:
        imitation_steps: N_imitation, steps that the expert drives.
        mixed_steps: N_mixed, steps that the policy drives.
        n_envs: Cars that drive beside each other (not in the paper); in phase 2 each drives its
            share of PPO's `n_steps`.
        buffer_capacity: Transitions in the replay buffer over all modes.
        bc_interval_imitation: Steps between two behaviour cloning updates in phase 1.
        bc_interval_mixed: The same in phase 2.
        diffusion_interval: Steps between two planner updates.
        discriminator_interval: T_disc [steps].
        sync_interval: T_sync [steps].
        sampling: `balanced` over the FSM modes or `uniform` (the paper's baseline).
        saec: What is learnt from intervened steps (see `experience_correction`).
        planner_in_mixed: Go on training the planner in phase 2 (Algorithm 1 does not say).
        critic_steps: Gradient steps of the critic's warm start (not in the paper); 0 for none.
        held_out_every: One episode in so many is kept for validation (not in the paper).
        checkpoint_interval: Steps between two checkpoints in phase 1 (not in the paper); in phase 2
            every PPO update is followed by one.
        log_interval: Steps between two rows of metrics (not in the paper).
        first_seed: Smallest seed of a training episode (not in the paper); smaller ones are for
            evaluation.
        ppo: The RL backbone.
        cloning: Behaviour cloning.
        diffusion: Training of the planner.
        discriminator: The GAIL discriminator.
        reward: The hybrid reward.
        disturbance: Of the expert in phase 1 (not in the paper).

    Raises:
        ValueError: If a number or word cannot be meant.
    """

    imitation_steps: int = 20_000
    mixed_steps: int = 30_000
    n_envs: int = 2
    buffer_capacity: int = 50_000
    bc_interval_imitation: int = 1_000
    bc_interval_mixed: int = 500
    diffusion_interval: int = 500
    discriminator_interval: int = 2_000
    sync_interval: int = 1_000
    sampling: Sampling = "balanced"
    saec: CorrectionForm = "label"
    planner_in_mixed: bool = True
    critic_steps: int = 1_000
    held_out_every: int = 10
    checkpoint_interval: int = 2_000
    log_interval: int = 500
    first_seed: int = 1_000_000
    ppo: PPOConfig = field(default_factory=PPOConfig)
    cloning: CloningConfig = field(default_factory=CloningConfig)
    diffusion: DiffusionTrainingConfig = field(default_factory=DiffusionTrainingConfig)
    discriminator: DiscriminatorConfig = field(default_factory=DiscriminatorConfig)
    reward: HybridRewardConfig = field(default_factory=HybridRewardConfig)
    disturbance: DisturbanceConfig = field(default_factory=DisturbanceConfig)

    def __post_init__(self) -> None:
        for name in ("imitation_steps", "n_envs", "buffer_capacity", *INTERVALS):
            if getattr(self, name) < 1:
                raise ValueError(f"`{name}` must be at least 1. Got {getattr(self, name)}.")
        for name in ("mixed_steps", "critic_steps"):
            if getattr(self, name) < 0:
                raise ValueError(f"`{name}` must not be negative. Got {getattr(self, name)}.")
        for name, steps in (("mixed_steps", self.mixed_steps), ("ppo.n_steps", self.ppo.n_steps)):
            if steps % self.n_envs:
                raise ValueError(
                    f"`{name}` must be a multiple of n_envs {self.n_envs}. Got {steps}."
                )
        if self.held_out_every < 2:
            raise ValueError(f"`held_out_every` must be at least 2. Got {self.held_out_every}.")
        if not 0 <= self.first_seed < 2**31:
            raise ValueError(f"`first_seed` must be in [0, 2^31). Got {self.first_seed}.")
        for name, allowed in (("sampling", get_args(Sampling)), ("saec", get_args(CorrectionForm))):
            if getattr(self, name) not in allowed:
                raise ValueError(f"`{name}` must be one of {allowed}. Got {getattr(self, name)!r}.")

    @property
    def total_steps(self) -> int:
        """N_total."""
        return self.imitation_steps + self.mixed_steps

    @property
    def balanced(self) -> bool:
        """Whether samples are drawn evenly over the modes."""
        return self.sampling == "balanced"
