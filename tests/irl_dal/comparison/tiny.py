"""A run folder that nobody trained, and a comparison on it that takes seconds."""

from dataclasses import replace
from pathlib import Path

import torch
from gymnasium import spaces

from irl_dal.build import build_loop, build_planner, supervision
from irl_dal.comparison.config import ComparisonConfig
from irl_dal.comparison.drive import ComparisonJob
from irl_dal.config import RunConfig
from irl_dal.learning import build_policy
from irl_dal.storage.checkpoint import CheckpointStore
from irl_dal.storage.run_folder import create_run
from shield import TriggerConfig

TINY = ComparisonConfig(
    episodes=2,
    projections=("none", "x0"),
    activations=("trigger", "alone"),
    candidates=3,
    film_duration=0.4,
    n_jobs=1,
)


def tiny_config() -> RunConfig:
    """Drives of a second and a half; the planner is triggered by anything within 30 m."""
    config = RunConfig()
    return replace(
        config,
        env=replace(config.env, route_length=80.0, route_spread=0.0, time_limit=1.4),
        planner=replace(config.planner, width=8, sampling_steps=4),
        shield=replace(config.shield, trigger=TriggerConfig(form="printed", clearance=30.0)),
    )


def untrained_run(folder: Path, config: RunConfig | None = None) -> Path:
    """A run folder with first weights in its checkpoint."""
    config = tiny_config() if config is None else config
    create_run(folder, config)
    planner = build_planner(config)
    loop = build_loop(config, supervision(config, planner))
    seen, acted = loop.observation_space, loop.action_space
    loop.close()
    assert isinstance(seen, spaces.Dict) and isinstance(acted, spaces.Box)
    torch.manual_seed(0)
    policy = build_policy(seen, acted, config.perception)
    state = {
        "policy": policy.state_dict(),
        "diffusion": None if planner is None else {"network": planner.denoiser.state_dict()},
    }
    CheckpointStore(folder).save(state, step=0, final=True)
    return folder


def tiny_job(run: Path, out: Path, comparison: ComparisonConfig = TINY) -> ComparisonJob:
    """That run in that comparison."""
    return ComparisonJob(tiny_config(), run, comparison, out)
