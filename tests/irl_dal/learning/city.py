"""The real control loop with everything in it, and a schedule of a few seconds."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from expert import ExpertConfig, FSMExpert
from irl_dal.envs import CityConfig, CityEnv
from irl_dal.learning import (
    CloningConfig,
    DiffusionTrainingConfig,
    DiscriminatorConfig,
    LearningConfig,
    Pipeline,
    PPOConfig,
)
from irl_dal.loop import ControlLoop, Supervision
from irl_dal.perception import PerceptionConfig
from irl_dal.planner import DenoiserConfig, DiffusionPlanner, PlannerConfig
from shield import ActuatorLimits, SafetyFilter, TriggerConfig

SHORT = LearningConfig(
    imitation_steps=120,
    mixed_steps=80,
    bc_interval_imitation=60,
    bc_interval_mixed=40,
    diffusion_interval=40,
    discriminator_interval=30,
    sync_interval=20,
    checkpoint_interval=40,
    log_interval=20,
    critic_steps=5,
    held_out_every=2,
    ppo=PPOConfig(n_steps=32, batch_size=16, n_epochs=1),
    cloning=CloningConfig(steps_imitation=3, steps_mixed=2, batch_size=16, validation_size=16),
    diffusion=DiffusionTrainingConfig(
        steps_imitation=5, steps_mixed=2, batch_size=32, validation_size=16
    ),
    discriminator=DiscriminatorConfig(steps=5, batch_size=16, samples=32),
)
"""Every part of Algorithm 1 at least twice; the last rollout has 16 steps."""


def new_loop(seed: int = 0, **supervision: Any) -> ControlLoop:
    """City, expert, small planner, shield; no deadline for plans, so that runs repeat."""
    limits = ActuatorLimits()
    config = PlannerConfig(
        denoiser=DenoiserConfig(width=16, embedding=16, condition=32),
        sampling_steps=2,
        deadline=60.0,
    )
    planner = DiffusionPlanner(config, limits, generator=torch.Generator().manual_seed(seed))
    watch = Supervision(planner=planner, blend=planner.blend, safety_filter=SafetyFilter(limits))
    city = CityEnv(CityConfig(time_limit=6.0), limits)
    expert = FSMExpert(ExpertConfig(), limits)
    return ControlLoop(city, expert, replace(watch, **supervision), TriggerConfig())


def new_pipeline(
    run_dir: Path,
    config: LearningConfig = SHORT,
    *,
    seed: int = 0,
    loop: ControlLoop | None = None,
    **arguments: Any,
) -> Pipeline:
    """A pipeline of its own seed on a loop of the same seed."""
    return Pipeline(
        config,
        loop or new_loop(seed),
        perception=PerceptionConfig(),
        run_dir=run_dir,
        seed=seed,
        **arguments,
    )


if __name__ == "__main__":
    torch.set_num_threads(1)
    new_pipeline(Path(os.environ["RUN_DIR"])).run()
