"""Trainings of seconds, by the command."""

import sys
from pathlib import Path

import pytest

from irl_dal import train

TINY = (
    "preset=smoke",
    "env.route_length=80",
    "env.route_spread=0",
    "env.time_limit=1.6",
    "learning.imitation_steps=96",
    "learning.mixed_steps=32",
    "learning.ppo.n_steps=32",
    "learning.ppo.batch_size=32",
    "learning.bc_interval_imitation=48",
    "learning.bc_interval_mixed=16",
    "learning.diffusion_interval=48",
    "learning.discriminator_interval=16",
    "learning.sync_interval=16",
    "learning.checkpoint_interval=48",
    "learning.log_interval=16",
    "learning.critic_steps=2",
    "learning.cloning.batch_size=16",
    "learning.cloning.steps_imitation=3",
    "learning.cloning.steps_mixed=2",
    "learning.diffusion.steps_imitation=3",
    "learning.diffusion.steps_mixed=2",
    "learning.discriminator.steps=2",
    "learning.discriminator.samples=16",
    "shield.trigger.clearance=15",
    "evaluation.n_jobs=1",
    "evaluation.path_states=2",
    "evaluation.video_duration=0.3",
)
"""A training of 128 steps that triggers the planner often."""


def sweep(folder: Path, *more: str) -> None:
    """Train two tiny variants with one command."""
    arguments = ("-m", *TINY, "variant=ppo_uniform,shielded", "seed=3")
    place = "run_dir=" + str(folder / "runs") + "/${variant}-seed${seed}"
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr("irl_dal.evaluation.suite.PATH_DURATION", 1.0)
        patch.setattr(sys, "argv", ["train", *arguments, place, *more])
        train.main()
