"""The schedule of Algorithm 1 and what belongs to it."""

import math
from dataclasses import dataclass, field, fields
from typing import Literal

from irl_dal.checks import check_choices
from irl_dal.learning.imitation.behaviour_cloning import CloningConfig
from irl_dal.learning.imitation.diffusion_training import DiffusionTrainingConfig
from irl_dal.learning.imitation.experience_correction import CorrectionForm
from irl_dal.learning.reinforcement.discriminator import DiscriminatorConfig
from irl_dal.learning.reinforcement.hybrid_reward import HybridRewardConfig
from irl_dal.learning.reinforcement.ppo import PPOConfig
from shield.errors import check_within

Sampling = Literal["balanced", "uniform"]


@dataclass(frozen=True, slots=True)
class LearningConfig:
    """Algorithm 1 with the numbers of Table II; what is not in Table II says so."""

    imitation_steps: int = 20_000  # N_imitation, steps that the expert drives
    mixed_steps: int = 30_000  # N_mixed, steps that the policy drives
    # Cars that drive beside each other (not in the paper); in phase 2 each drives its share of
    # PPO's `n_steps`. Two per core: while one waits for the policy's next action, or for a slower
    # car, another one drives (docs/decisions/rollouts.md).
    n_envs: int = 4
    buffer_capacity: int = 50_000  # transitions in the replay buffer over all modes
    bc_interval_imitation: int = 1_000  # steps between two behaviour cloning updates in phase 1
    bc_interval_mixed: int = 500  # the same in phase 2
    diffusion_interval: int = 500  # steps between two planner updates
    discriminator_interval: int = 2_000  # T_disc [steps]
    sync_interval: int = 1_000  # T_sync [steps]
    # `balanced` over the FSM modes or `uniform` (the paper's baseline).
    sampling: Sampling = "balanced"
    # What is learnt from intervened steps (see `experience_correction`).
    saec: CorrectionForm = "label"
    # Gradient steps of the critic's warm start (not in the paper); 0 for none.
    critic_steps: int = 1_000
    # Probability that a burst of wrong commands begins in a calm step of the expert (not in the
    # paper, see `disturbance`); 0 for an undisturbed expert.
    disturbance_rate: float = 0.025
    # Steps between two checkpoints in phase 1 (not in the paper); in phase 2 every PPO update is
    # followed by one.
    checkpoint_interval: int = 2_000
    log_interval: int = 500  # steps between two rows of metrics (not in the paper)
    # Smallest seed of a training episode (not in the paper); smaller ones are for evaluation.
    first_seed: int = 1_000_000
    ppo: PPOConfig = field(default_factory=PPOConfig)
    cloning: CloningConfig = field(default_factory=CloningConfig)
    diffusion: DiffusionTrainingConfig = field(default_factory=DiffusionTrainingConfig)
    discriminator: DiscriminatorConfig = field(default_factory=DiscriminatorConfig)
    reward: HybridRewardConfig = field(default_factory=HybridRewardConfig)

    def __post_init__(self) -> None:
        intervals = [entry.name for entry in fields(self) if "_interval" in entry.name]
        sizes = ("imitation_steps", "n_envs", "buffer_capacity", *intervals)
        check_within(ValueError, 1, math.inf, **{name: getattr(self, name) for name in sizes})
        counts = {"mixed_steps": self.mixed_steps, "critic_steps": self.critic_steps}
        check_within(ValueError, 0, math.inf, **counts)
        check_within(ValueError, 0.0, 1.0, disturbance_rate=self.disturbance_rate)
        check_within(ValueError, 0, 2**31 - 1, first_seed=self.first_seed)
        for name, steps in (("mixed_steps", self.mixed_steps), ("ppo.n_steps", self.ppo.n_steps)):
            rule = f"must be a multiple of n_envs {self.n_envs}"
            if steps % self.n_envs:
                raise ValueError(f"`{name}` {rule}. Got {steps}.")
        check_choices(self)

    @property
    def total_steps(self) -> int:
        """N_total."""
        return self.imitation_steps + self.mixed_steps

    @property
    def balanced(self) -> bool:
        """Whether samples are drawn evenly over the modes."""
        return self.sampling == "balanced"
