"""stable-baselines3's PPO, with steps that leave what was cloned in place.

The exploration noise is small, so that a policy that drives goes on driving. A small change of the
mean action is then a large divergence, and PPO as it comes (Table II: learning rate 3e-4, all
parameters) moves the mean by 0.2 within one update: 40 noise deviations, and the end of what was
cloned. Three things keep it near, none of them in the paper:

* its gradients stop at the shared features: those belong to behaviour cloning
  (`perception_gradient`);
* the actor's learning rate follows the divergence of the last update, as in Rudin et al., "Learning
  to walk in minutes" (2021), with Table II's rate as the ceiling; the critic keeps that rate;
* values and log-probabilities are renewed before an update (see `HybridRolloutBuffer`).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor, nn

from irl_dal.learning.reinforcement.policy import DrivingPolicy, policy_arguments
from irl_dal.learning.reinforcement.rollout_buffer import HybridRolloutBuffer
from irl_dal.perception import PerceptionConfig
from shield.errors import check_positive, check_within

SAMPLES = 256  # observations on which the divergence of an update is measured

# Where the actor's learning rate begins: the size at which the first updates have the target
# divergence (measured); it then follows.
INITIAL_ACTOR_RATE = 1e-4
LOWEST_ACTOR_RATE = 1e-7  # below it the actor stands still, and takes many updates to come back
HANDED_ON = (  # to stable-baselines3's PPO as they are
    *("learning_rate", "batch_size", "n_epochs", "gamma", "gae_lambda", "clip_range"),
    *("ent_coef", "vf_coef", "max_grad_norm"),
)
ADAM_EPSILON = 1e-5  # stable-baselines3's default for PPO


@dataclass(frozen=True, slots=True)
class PPOConfig:
    """The RL backbone (Table II unless the attribute says otherwise)."""

    n_steps: int = 2048  # steps per update, of all cars together
    batch_size: int = 64  # samples per gradient step
    n_epochs: int = 10  # passes over the steps per update
    gamma: float = 0.99  # discount factor
    gae_lambda: float = 0.95  # GAE's lambda
    learning_rate: float = 3e-4  # of Adam
    clip_range: float = 0.2  # of the probability ratio
    ent_coef: float = 0.01  # entropy coefficient c_2
    vf_coef: float = 0.5  # value loss coefficient c_1
    max_grad_norm: float = 0.5  # G_max
    # Logarithm of the initial standard deviation of the exploration noise, normalised units,
    # steering and speed. Not in the paper: small, so that exploring does not undo what was cloned;
    # white noise of 0.05 is 0.025 rad of steering in every step.
    initial_log_std: tuple[float, float] = (-3.0, -2.5)
    # Divergence of an update that the actor's learning rate is steered to (not in the paper, see
    # above); None keeps the rate at `learning_rate`.
    target_kl: float | None = 0.02
    # Let PPO's gradients into the shared features (the paper does not say); otherwise only
    # behaviour cloning trains them.
    perception_gradient: bool = False
    # Take values and probability ratios from the policy as it is when the update begins (not in the
    # paper); False from the one that acted, which behaviour cloning has moved on since.
    renew: bool = True

    def __post_init__(self) -> None:
        sizes = {name: getattr(self, name) for name in ("n_steps", "batch_size", "n_epochs")}
        check_within(ValueError, 1, math.inf, **sizes)
        rates = ("learning_rate", "clip_range", "max_grad_norm")
        check_positive(ValueError, **{name: getattr(self, name) for name in rates})
        if self.target_kl is not None:
            check_positive(ValueError, target_kl=self.target_kl)
        check_within(ValueError, 0.0, 1.0, gae_lambda=self.gae_lambda)
        if not 0.0 <= self.gamma < 1.0:
            raise ValueError(f"`gamma` must be in [0, 1). Got {self.gamma}.")


class ActorCriticAdam(torch.optim.Adam):
    """Adam whose first group, the actor, has a learning rate of its own.

    stable-baselines3 sets one rate for all groups before every update. The critic's rate is the
    actor's largest; `actor_rate` is its present one.
    """

    def __init__(
        self, actor: list[nn.Parameter], critic: list[nn.Parameter], config: PPOConfig
    ) -> None:
        groups = [{"params": actor}, {"params": critic}]
        super().__init__(groups, lr=config.learning_rate, eps=ADAM_EPSILON, fused=True)
        self._highest, self._target = config.learning_rate, config.target_kl
        self.actor_rate = self._highest if self._target is None else INITIAL_ACTOR_RATE

    def step(self, closure: Callable[[], float] | None = None) -> float | None:  # type: ignore[override]
        """A step with the actor's present rate."""
        self.param_groups[0]["lr"] = self.actor_rate
        return super().step(closure)

    def follow(self, measured: float) -> None:
        """Double or halve the actor's rate after an update whose divergence missed the target."""
        if self._target is None:
            return
        if measured > 1.5 * self._target:
            self.actor_rate = max(self.actor_rate / 2.0, LOWEST_ACTOR_RATE)
        elif measured < self._target / 1.5:
            self.actor_rate = min(self.actor_rate * 2.0, self._highest)


class DrivingPPO(PPO):
    """PPO on a `DrivingPolicy`, an `ActorCriticAdam` and a `HybridRolloutBuffer`."""

    policy: DrivingPolicy
    rollout_buffer: HybridRolloutBuffer

    @property
    def optimizer(self) -> ActorCriticAdam:
        """The policy's."""
        assert isinstance(self.policy.optimizer, ActorCriticAdam)
        return self.policy.optimizer

    def resize(self, steps: int) -> None:
        """Let the next update have so many steps of each car: the last one may have fewer."""
        self.n_steps = self.rollout_buffer.buffer_size = steps
        self.rollout_buffer.reset()

    def train(self) -> None:
        """Update actor and critic from the rollout; then let the actor's rate follow."""
        policy, buffer = self.policy, self.rollout_buffer
        steps = buffer.buffer_size * self.n_envs
        rows = np.linspace(0, steps - 1, min(SAMPLES, steps)).astype(int)
        seen = {key: torch.from_numpy(values[rows]) for key, values in buffer.seen().items()}
        before = _gaussian(policy, seen)
        if not policy.perception_gradient:
            # No epoch needs the images again.
            shape = (buffer.buffer_size, buffer.n_envs)
            features = policy.perceive(buffer.seen())
            buffer.observations = {k: v.reshape(*shape, -1) for k, v in features.items()}
        super().train()
        measured = divergence(before, _gaussian(policy, seen))
        self.logger.record("train/divergence", measured)
        self.logger.record("train/actor_rate", self.optimizer.actor_rate)
        self.optimizer.follow(measured)


def divergence(before: tuple[Tensor, Tensor], after: tuple[Tensor, Tensor]) -> float:
    """Mean KL(before || after) of diagonal Gaussians: means (N, 2), standard deviations (2,)."""
    (old, old_std), (new, new_std) = before, after
    ratio = (old_std.square() + (old - new).square()) / (2.0 * new_std.square())
    return float((torch.log(new_std / old_std) + ratio - 0.5).sum(dim=1).mean())


def build_ppo(
    env: VecEnv,
    config: PPOConfig,
    perception: PerceptionConfig,
    *,
    weights: np.random.Generator,
    order: np.random.Generator,
) -> DrivingPPO:
    """PPO around our policy and rollout buffer; the cars share `n_steps` evenly.

    `weights` draws the first weights and the exploration noise, `order` that of minibatches.
    """
    # The networks draw their first weights from torch's global generator: lend it a seed of ours.
    with torch.random.fork_rng():
        torch.manual_seed(int(weights.integers(2**63)))
        ppo = DrivingPPO(
            DrivingPolicy,
            env,
            n_steps=config.n_steps // env.num_envs,
            **{name: getattr(config, name) for name in HANDED_ON},
            rollout_buffer_class=HybridRolloutBuffer,
            rollout_buffer_kwargs={"rng": order},
            policy_kwargs=policy_arguments(perception),
            device="cpu",
        )
    _prepare(ppo.policy, config)
    ppo.policy.generator = torch.Generator().manual_seed(int(weights.integers(2**63)))
    return ppo


@torch.no_grad()
def _prepare(policy: DrivingPolicy, config: PPOConfig) -> None:
    """Our exploration noise, gradients and optimiser in place of stable-baselines3's."""
    policy.perception_gradient = config.perception_gradient
    policy.log_std.copy_(torch.tensor(config.initial_log_std))
    critic = [*policy.mlp_extractor.value_net.parameters(), *policy.value_net.parameters()]
    known = {id(parameter) for parameter in critic}
    actor = [parameter for parameter in policy.parameters() if id(parameter) not in known]
    policy.optimizer = ActorCriticAdam(actor, critic, config)


@torch.no_grad()
def _gaussian(policy: DrivingPolicy, seen: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    return policy.get_distribution(seen).mode(), policy.log_std.exp().clone()
