"""Algorithm 1, from the first step of the expert to the trained agent.

Which line of Algorithm 1 is where: see docs/paper.md.

Several cars drive beside each other, and t counts the steps of all of them. "t mod T = 0" is read
as "after every T-th step", in phase 2 as soon as every car has driven its step. The last PPO update
may have fewer steps than the others, so that the run ends at N_total exactly.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor

from expert.replay import ReplayBuffer
from irl_dal.learning.collection.driver import demonstrations
from irl_dal.learning.collection.recorder import Recorder, StepRecord
from irl_dal.learning.config import LearningConfig
from irl_dal.learning.imitation.behaviour_cloning import BehaviourCloning
from irl_dal.learning.imitation.diffusion_training import DiffusionTraining
from irl_dal.learning.imitation.experience_correction import correct_as_printed
from irl_dal.learning.learners import Learners
from irl_dal.learning.reinforcement.critic import warm_start_critic
from irl_dal.learning.reinforcement.discriminator import Discriminator
from irl_dal.learning.reinforcement.policy import DrivingPolicy
from irl_dal.learning.reinforcement.ppo import build_ppo
from irl_dal.learning.run_log import ProgressBar, RunLog
from irl_dal.perception import PerceptionConfig
from irl_dal.planner import DiffusionPlanner
from irl_dal.storage.checkpoint import MISFITS, CheckpointError, CheckpointStore

# Independent random streams that the seed is split into.
STREAMS = ("policy", "replay", "rollout", "discriminator", "diffusion", "critic")


class Pipeline:
    """Trains policy, planner and discriminator in both phases and keeps the run folder.

    Args:
        config: Schedule and sizes.
        cars: A vector of `Driver`.
        planner: Is trained, and its weights handed on to the cars' own planners; None without one.
        seed: Everything random in learning is drawn from streams of this seed. The planner has a
            generator of its own, which is saved and restored too.
        provenance: Commit, config hash, ...: kept in each checkpoint; a checkpoint with another
            `config_hash` is refused.
    """

    def __init__(
        self,
        config: LearningConfig,
        cars: VecEnv,
        planner: DiffusionPlanner | None,
        *,
        perception: PerceptionConfig,
        run_dir: Path,
        seed: int,
        progress: ProgressBar | None = None,
        provenance: Mapping[str, str] | None = None,
    ) -> None:
        self.config = config
        self.step = 0  # environment steps so far, of all cars together
        self.cars = cars
        seeds = np.random.SeedSequence(seed).spawn(len(STREAMS))
        self._rng = {n: np.random.default_rng(s) for n, s in zip(STREAMS, seeds, strict=True)}
        self._planner = planner
        seen: Any = cars.observation_space
        self.replay = ReplayBuffer(
            config.buffer_capacity,
            horizon=1 if planner is None else planner.config.horizon,
            image_shape=seen["image"].shape,
            beams=seen["lidar"].shape[0],
        )
        keep = config.saec != "off"
        self.recorder = Recorder(self.replay, config.n_envs, keep_intervened=keep)
        self.learners = self._build(perception)
        self.log = RunLog(run_dir, self.recorder, progress)
        self._store = CheckpointStore(run_dir)
        self._provenance = dict(provenance or {})
        self._exported = 0
        self._critic_ready = False

    @property
    def policy(self) -> DrivingPolicy:
        """The policy in training."""
        return self.learners.ppo.policy

    def run(self) -> None:
        """Go on from the present step to the last one and write the final checkpoint.

        Raises:
            CheckpointError: If the training diverges; the newest checkpoint is from before.
        """
        config = self.config
        if self.step >= config.total_steps:
            return
        self.learners.ppo.set_logger(self.log.open(self.step))
        try:
            if self.step == 0:
                self.save()
            if self.step < config.imitation_steps:
                self._imitate()
            if self.step < config.total_steps:
                self._refine()
            self._finish()
        except ValueError:
            # How torch refuses a distribution of weights that are not finite.
            if all(bool(torch.isfinite(weights).all()) for weights in self.policy.parameters()):
                raise
            where = f"{self._store.run_dir}: step {self.step}"
            raise CheckpointError(f"{where}: the policy diverged, a weight is not finite") from None
        finally:
            self.log.close()

    def save(self, *, final: bool = False) -> None:
        """Write a checkpoint (see `CheckpointStore.save`)."""
        with self.log.timed("checkpoint"):
            self._store.save(
                self._state(final),
                step=self.step,
                provenance=self._provenance,
                shard=None if final else self.replay.export_since(self._exported),
                final=final,
            )
            self._exported = self.replay.counter

    def restore(self) -> None:
        """Go on from the newest checkpoint in the run folder; every car begins a new episode.

        Raises:
            CheckpointError: If there is none that can be used.
        """
        checkpoint = self._store.resume()
        theirs = checkpoint.provenance.get("config_hash")
        ours = self._provenance.get("config_hash", theirs)
        if ours != theirs:
            raise CheckpointError(f"{checkpoint.folder}: of config {theirs}, this run has {ours}")
        try:
            saved = checkpoint.state["replay"]
            self.replay.restore(self._store.shards(checkpoint), saved["live"], saved["counter"])
            self._load(checkpoint.state)
        except CheckpointError:
            raise
        except MISFITS as error:
            raise CheckpointError.misfit(checkpoint.folder, "this run", error) from None
        for car, episode in enumerate(self.recorder.upcoming):
            self.cars.env_method("begin_at", episode, indices=[car])
        self._exported = self.replay.counter
        self.step = checkpoint.step

    def _build(self, perception: PerceptionConfig) -> Learners:
        config, rng = self.config, self._rng
        streams = {"weights": rng["policy"], "order": rng["rollout"]}
        ppo = build_ppo(self.cars, config.ppo, perception, **streams)
        generator = torch.Generator().manual_seed(int(rng["discriminator"].integers(2**63)))
        diffusion = None
        if self._planner is not None:
            diffusion = DiffusionTraining(self._planner, config.diffusion, rng["diffusion"])
        return Learners(
            config,
            ppo,
            self.replay,
            BehaviourCloning(ppo.policy, config.cloning),
            diffusion,
            Discriminator(ppo.policy, config.discriminator, generator),
            rng["replay"],
        )

    def _imitate(self) -> None:
        """Phase 1: the expert drives."""
        config, learners, log = self.config, self.learners, self.log
        log.progress.begin("imitation", self.step, config.imitation_steps)
        records = demonstrations(self.cars, config.imitation_steps - self.step)
        while self.step < config.imitation_steps:
            with log.timed("driving"):
                self._take(next(records))
            if self._due(config.bc_interval_imitation):
                with log.timed("bc"):
                    learners.clone(config.cloning.steps_imitation)
            if self._due(config.diffusion_interval):
                with log.timed("planner"):
                    learners.train_planner(config.diffusion.steps_imitation)
            self._log_if_due(phase=1)
            if self._due(config.checkpoint_interval):
                self.save()

    def _refine(self) -> None:
        """Phase 2: the policy drives, one PPO update at a time."""
        config, ppo = self.config, self.learners.ppo
        self.log.progress.begin("mixed", self.step, config.total_steps)
        if not self._critic_ready:
            with self.log.timed("critic"):
                explained = warm_start_critic(
                    self.policy,
                    self.replay,
                    gamma=config.ppo.gamma,
                    scale=self.learners.reward.scale * config.reward.w_env,
                    steps=config.critic_steps,
                    rng=self._rng["critic"],
                )
            self._critic_ready = True
            ppo.logger.record("critic/explained_variance", explained)
            self.save()
        self._hand_on_planner()
        while self.step < config.total_steps:
            size = min(config.ppo.n_steps, config.total_steps - self.step)
            ppo.resize(size // config.n_envs)
            with self.log.timed("driving"):
                # One iteration, after which stable-baselines3 has nothing to log (`log_interval`).
                ppo.learn(size, _Rollout(self), log_interval=2, reset_num_timesteps=False)
            if self.step < config.total_steps:
                self.save()

    def after_step(
        self, records: Sequence[StepRecord], actions: np.ndarray, log_probs: Tensor
    ) -> None:
        """Store a step of each of the E cars, then update what is due.

        The printed correction changes `actions` (E, 2) and `log_probs` (E,) in place.
        """
        for record in records:
            self._take(record)
        self.learners.ppo.rollout_buffer.note(records)
        if self.config.saec == "paper":
            correct_as_printed(self.policy, records, actions, log_probs)
        # What is due after the very last step comes after PPO's last update, in `_finish`.
        if self.step < self.config.total_steps:
            self._mixed_updates()
            self._log_if_due(phase=2)

    def after_rollout(self, last_values: Tensor) -> None:
        """Mix the rewards; what stable-baselines3 does from here on is PPO's update."""
        self.log.switch("ppo")
        self.learners.finish_rollout(last_values)

    def _take(self, record: StepRecord) -> None:
        self.recorder.take(record)
        self.step += 1
        self.log.progress.advance(self.step)

    def _finish(self) -> None:
        """Imitation has the last word: after the last PPO update, not before it."""
        if self.config.mixed_steps:
            with self.log.timed("bc"):
                self.learners.clone(self.config.cloning.steps_mixed)
        self._log(phase=2 if self.config.mixed_steps else 1)
        self.save(final=True)

    def _mixed_updates(self) -> None:
        config, learners, log = self.config, self.learners, self.log
        if self._due(config.sync_interval):
            learners.discriminator.sync_features(self.policy)
        if self._due(config.discriminator_interval) and config.reward.w_irl > 0.0:
            with log.timed("discriminator"):
                learners.train_discriminator()
        if config.diffusion.steps_mixed and self._due(config.diffusion_interval):
            with log.timed("planner"):
                learners.train_planner(config.diffusion.steps_mixed)
                self._hand_on_planner()
        if self._due(config.bc_interval_mixed):
            with log.timed("bc"):
                learners.clone(config.cloning.steps_mixed)

    def _hand_on_planner(self) -> None:
        """Let the cars plan with the planner's weights as they are now."""
        if self._planner is not None:
            weights = {name: w.numpy() for name, w in self._planner.denoiser.state_dict().items()}
            self.cars.env_method("load_planner", weights)

    def _due(self, interval: int) -> bool:
        """Whether the newest steps, one in phase 1 and one of each car in phase 2, complete one."""
        newest = 1 if self.step <= self.config.imitation_steps else self.config.n_envs
        return self.step % interval < newest

    def _log_if_due(self, phase: int) -> None:
        # The last row of a run is written by `_finish`.
        if self._due(self.config.log_interval) and self.step < self.config.total_steps:
            self._log(phase)

    def _log(self, phase: int) -> None:
        sizes = {f"replay/{mode.name.lower()}": n for mode, n in self.replay.sizes.items()}
        self.log.row(self.step, phase, {"count/saec_marks": self.recorder.marks} | sizes)

    @property
    def _noise(self) -> torch.Generator:
        assert self.policy.generator is not None
        return self.policy.generator

    def _parts(self) -> dict[str, Any]:
        """What has a state of its own."""
        learners = self.learners
        return {
            "policy": self.policy,
            "cloning": learners.cloning,
            "discriminator": learners.discriminator,
            "diffusion": learners.diffusion,
            "recorder": self.recorder,
        }

    def _state(self, final: bool) -> dict[str, Any]:
        optimizer = self.learners.ppo.optimizer
        parts = self._parts().items()
        states = {name: None if part is None else part.state_dict() for name, part in parts}
        return states | {
            "ppo": {
                "optimizer": optimizer.state_dict(),
                "actor_rate": optimizer.actor_rate,
                "noise": self._noise.get_state(),
            },
            "replay": {
                "live": np.zeros(0, np.int64) if final else self.replay.live(),
                "counter": self.replay.counter,
            },
            "rng": {name: rng.bit_generator.state for name, rng in self._rng.items()},
            "critic_ready": self._critic_ready,
            "seconds": dict(self.log.seconds),
        }

    def _load(self, state: Mapping[str, Any]) -> None:
        for name, part in self._parts().items():
            if part is not None:
                part.load_state_dict(state[name])
        optimizer = self.learners.ppo.optimizer
        optimizer.load_state_dict(state["ppo"]["optimizer"])
        optimizer.actor_rate = state["ppo"]["actor_rate"]
        self._noise.set_state(state["ppo"]["noise"])
        for name, rng in self._rng.items():
            rng.bit_generator.state = state["rng"][name]
        self._critic_ready = state["critic_ready"]
        self.log.seconds = dict(state["seconds"])


class _Rollout(BaseCallback):
    """Hands the steps that stable-baselines3 collects to the pipeline."""

    def __init__(self, pipeline: Pipeline) -> None:
        super().__init__()
        self._pipeline = pipeline

    def _on_step(self) -> bool:
        records = [info["record"] for info in self.locals["infos"]]
        self._pipeline.after_step(records, self.locals["actions"], self.locals["log_probs"])
        return True

    def _on_rollout_end(self) -> None:
        self._pipeline.after_rollout(self.locals["values"])
