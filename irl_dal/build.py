"""From a configuration to the objects that it describes; training and evaluation build alike."""

import multiprocessing
import signal
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from expert import FSMExpert
from irl_dal.cli.threads import stay_on_one_thread
from irl_dal.config import RunConfig
from irl_dal.envs import CityConfig, CityEnv
from irl_dal.envs.road import LANES
from irl_dal.learning import Driver, DriverProcesses, DrivingPolicy, build_policy
from irl_dal.loop import CLEARANCE_MARGIN, ControlLoop, Supervision
from irl_dal.planner import DiffusionPlanner
from irl_dal.planner.planner import SIMULATED_TIME_DEADLINE
from irl_dal.storage.checkpoint import MISFITS, CheckpointError, CheckpointStore
from shield import Assumptions, PredictiveFilter, SafetyFilter

# Spawn keys of the planner's random stream and of the training episodes': none of those that
# learning splits the seed into.
_PLANNER, _EPISODES = (1_000,), (1_001,)


def build_planner(config: RunConfig) -> DiffusionPlanner | None:
    """The planner with its own random stream of the run's seed; None where it is switched off."""
    if not config.planner.enabled:
        return None
    stream = np.random.SeedSequence(config.seed, spawn_key=_PLANNER).generate_state(1, np.uint64)
    generator = torch.Generator().manual_seed(int(stream[0] >> 1))
    solver = config.shield.solver
    return DiffusionPlanner(config.planner, config.limits, generator=generator, solver=solver)


def supervision(
    config: RunConfig, planner: DiffusionPlanner | None, *, training: bool = False
) -> Supervision:
    """Planner and shield as far as the configuration has them; `training`: the expert is there."""
    shield = _safety_filter(config) if config.shield.enabled else None
    return Supervision(planner=planner, safety_filter=shield, training=training)


def expert_supervision(config: RunConfig) -> Supervision:
    """What the expert drives under when it is the reference: the shield, whatever the variant."""
    return Supervision(safety_filter=_safety_filter(config))


def build_loop(
    config: RunConfig, supervision: Supervision, *, render_mode: str | None = None
) -> ControlLoop:
    """The city, the expert and the control loop around them."""
    city = CityEnv(config.env, config.limits, render_mode)
    expert = FSMExpert(config.expert, config.limits)
    return ControlLoop(city, expert, supervision, config.shield.trigger)


def shielded_city(render_mode: str | None = None, **fields: Any) -> ControlLoop:
    """`gymnasium.make("IRLDAL/ShieldedCity-v0")`: the city with the default shield inside `step`.

    Args:
        render_mode: As of `CityEnv`.
        **fields: Fields of `CityConfig` that differ from its defaults.
    """
    config = RunConfig(env=CityConfig(**fields))
    return build_loop(config, supervision(config, None), render_mode=render_mode)


def build_drivers(config: RunConfig, *, processes: bool) -> VecEnv:
    """The cars of a training, each in a process of its own or not; they drive the same."""
    cars: Any = [
        partial(_driver, config, place, processes) for place in range(config.learning.n_envs)
    ]
    if not processes:
        return DummyVecEnv(cars)
    # Imports take a process 3.5 s: here once, in the server from which the cars' are forked.
    multiprocessing.set_forkserver_preload([__name__])
    return DriverProcesses(cars)


def load_run(
    config: RunConfig, run_dir: Path, loop: ControlLoop, planner: DiffusionPlanner | None
) -> DrivingPolicy:
    """The policy of a run's newest checkpoint; the planner's weights go into `planner`.

    `CheckpointError` if there is none, or it is of another version, damaged, truncated, of another
    configuration, or its weights are not finite.
    """
    state = CheckpointStore(run_dir).load().state
    seen, acted = loop.observation_space, loop.action_space
    assert isinstance(seen, spaces.Dict) and isinstance(acted, spaces.Box)
    policy = build_policy(seen, acted, config.perception)
    try:
        policy.load_state_dict(state["policy"])
        if planner is not None:
            planner.load_state_dict(state["diffusion"]["network"])
    except MISFITS as error:
        raise CheckpointError.misfit(run_dir, "the configuration", error) from None
    policy.set_training_mode(False)
    return policy


def _safety_filter(config: RunConfig) -> PredictiveFilter | SafetyFilter:
    solver, deadline = config.shield.solver, SIMULATED_TIME_DEADLINE
    if config.shield.level == "off":
        return SafetyFilter(config.limits, solver, deadline=deadline)
    return PredictiveFilter(
        config.limits,
        config.env.vehicle,
        config.env.scanner,
        Assumptions(level=config.shield.level),
        lanes=LANES,
        scanner_clearance=config.env.collision_distance + CLEARANCE_MARGIN,
        solver=solver,
        deadline=deadline,
    )


def _driver(config: RunConfig, place: int, alone: bool) -> Driver:
    if alone:  # in a process that does nothing else, and that ends when its parent says so
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        stay_on_one_thread()
    loop = build_loop(config, supervision(config, build_planner(config), training=True))
    seeds = np.random.SeedSequence(config.seed, spawn_key=_EPISODES)
    return Driver(loop, config.learning, seeds, place)
