"""The real control loop with everything in it, and a schedule of a few seconds."""

import multiprocessing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from expert import ExpertConfig, FSMExpert
from irl_dal.envs import CityConfig, CityEnv
from irl_dal.learning import Driver, DriverProcesses, LearningConfig, Pipeline
from irl_dal.learning.imitation.behaviour_cloning import CloningConfig
from irl_dal.learning.imitation.diffusion_training import DiffusionTrainingConfig
from irl_dal.learning.reinforcement.discriminator import DiscriminatorConfig
from irl_dal.learning.reinforcement.ppo import PPOConfig
from irl_dal.loop import ControlLoop, Supervision
from irl_dal.perception import PerceptionConfig
from irl_dal.planner import Activation, DiffusionPlanner, PlannerConfig
from shield import ActuatorLimits, SafetyFilter, TriggerConfig

SHORT = LearningConfig(
    imitation_steps=60,
    mixed_steps=48,
    n_envs=2,
    bc_interval_imitation=30,
    bc_interval_mixed=24,
    diffusion_interval=20,
    discriminator_interval=18,
    sync_interval=20,
    checkpoint_interval=20,
    log_interval=10,
    critic_steps=5,
    ppo=PPOConfig(n_steps=32, batch_size=16, n_epochs=1),
    cloning=CloningConfig(steps_imitation=3, steps_mixed=2, batch_size=16),
    diffusion=DiffusionTrainingConfig(steps_imitation=5, steps_mixed=2, batch_size=32),
    discriminator=DiscriminatorConfig(steps=5, samples=32),
)
"""Every part of Algorithm 1 at least twice; the last rollout has 16 steps, 8 of each car."""


def new_planner(seed: int = 0, activation: Activation = "trigger") -> DiffusionPlanner:
    """A small one, without a deadline for plans, so that runs repeat."""
    config = PlannerConfig(
        activation=activation,
        width=16,
        sampling_steps=2,
        deadline=60.0,
    )
    generator = torch.Generator().manual_seed(seed)
    return DiffusionPlanner(config, ActuatorLimits(), generator=generator)


def new_loop(activation: Activation = "trigger", **supervision: Any) -> ControlLoop:
    """City, expert, small planner, shield."""
    limits, planner = ActuatorLimits(), new_planner(activation=activation)
    watch = Supervision(planner=planner, safety_filter=SafetyFilter(limits))
    city = CityEnv(CityConfig(time_limit=6.0), limits)
    expert = FSMExpert(ExpertConfig(), limits)
    return ControlLoop(city, expert, replace(watch, **supervision), TriggerConfig())


def new_driver(
    config: LearningConfig = SHORT, place: int = 0, seed: int = 0, **supervision: Any
) -> Driver:
    """One of a run's cars."""
    return Driver(new_loop(**supervision), config, np.random.SeedSequence(seed), place)


def new_drivers(
    config: LearningConfig = SHORT, seed: int = 0, *, processes: bool = False, **supervision: Any
) -> VecEnv:
    """All of them."""
    cars = [
        partial(new_driver, config, place, seed, **supervision) for place in range(config.n_envs)
    ]
    if not processes:
        return DummyVecEnv(cars)  # type: ignore[arg-type]
    multiprocessing.set_forkserver_preload(["irl_dal.build"])  # as a run does
    return DriverProcesses(cars)  # type: ignore[arg-type]


def new_pipeline(
    run_dir: Path,
    config: LearningConfig = SHORT,
    *,
    seed: int = 0,
    drivers: VecEnv | None = None,
    planner: bool = True,
    **arguments: Any,
) -> Pipeline:
    """A pipeline of its own seed on cars of the same seed."""
    return Pipeline(
        config,
        drivers or new_drivers(config, seed),
        new_planner(seed) if planner else None,
        perception=PerceptionConfig(),
        run_dir=run_dir,
        seed=seed,
        **arguments,
    )
