"""Driving episodes and comparing short drives from the same state."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from irl_dal.evaluation.agents import Agent, ExpertAgent
from irl_dal.evaluation.episode import Episode, EpisodeRecorder
from irl_dal.evaluation.measurements import ExpertPath, HeldOutActions, PathPair
from irl_dal.loop import ControlLoop, Observation, Supervision

__all__ = ["Watcher", "compare_paths", "drive_episode", "drive_expert", "spread_steps"]

Array = NDArray[np.float64]

Watcher = Callable[[Observation, Mapping[str, Any]], None]
"""Looks at the observation and `info` of the reset and of every step."""


def drive_episode(
    loop: ControlLoop, agent: Agent, seed: int, watch: Watcher | None = None
) -> Episode:
    """Drive one episode; the same seed gives the same episode.

    Args:
        loop: The city with its supervision.
        agent: Who drives.
        seed: Of the episode: road, traffic, light, noise of sensors and planner.
        watch: Called after the reset and after every step.
    """
    observation, info = _begin(loop, agent, seed)
    recorder = EpisodeRecorder(seed, info)
    over = False
    while not over:
        if watch is not None:
            watch(observation, info)
        action = agent.act(observation, info)
        observation, reward, terminated, truncated, after = agent.drive(loop, action)
        recorder.add(info, action, float(reward), after)
        info = after
        over = terminated or truncated
    if watch is not None:
        watch(observation, info)
    return recorder.finish()


def drive_expert(
    loop: ControlLoop, reference: Supervision, agent: Agent, seed: int
) -> tuple[Episode, HeldOutActions]:
    """Let the expert drive, and ask the agent in every state what it would have done.

    Args:
        loop: The city.
        reference: Supervision that the expert drives under, whatever the agent's is.
        agent: Who is asked; it never drives here.
        seed: Of the episode.
    """
    answers: list[tuple[int, Array, Array]] = []

    def ask(observation: Observation, info: Mapping[str, Any]) -> None:
        label = np.asarray(info["expert_action"], np.float64)
        answers.append((info["mode"], agent.act(observation, info), label))

    agent.reset(seed)
    own, loop.supervision = loop.supervision, reference
    try:
        episode = drive_episode(loop, ExpertAgent(), seed, ask)
    finally:
        loop.supervision = own
    modes, actions, labels = zip(*answers[: episode.steps], strict=True)
    return episode, HeldOutActions(
        seed=np.full(episode.steps, seed),
        mode=np.array(modes, np.int64),
        agent_action=np.stack(actions),
        expert_action=np.stack(labels),
    )


def compare_paths(
    loop: ControlLoop,
    reference: Supervision,
    agent: Agent,
    expert: Episode | ExpertPath,
    step: int,
    horizon: int,
) -> PathPair:
    """Put the agent into a state of an expert's episode and let it drive.

    The state is restored by driving the expert's episode again up to `step`, without the camera
    until the last moment. An agent whose episode ends early (collision, goal) stays where it is.

    Args:
        loop: The city with the agent's supervision.
        reference: Supervision that the expert drove under.
        agent: Who drives from the state on.
        expert: The expert's episode, or its path.
        step: Control step of the state in it; `step + horizon` must not exceed its length.
        horizon: Control steps K to drive.

    Returns:
        Both paths over the K steps.
    """
    if not 0 <= step <= expert.steps - horizon:
        raise ValueError(
            f"`step` must lie in [0, {expert.steps - horizon}] for an episode of {expert.steps} "
            f"steps and a horizon of {horizon}. Got {step}."
        )
    observation, info = _restore(loop, reference, agent, expert.seed, step)
    path = np.empty((horizon, 2))
    over = False
    for k in range(horizon):
        if not over:
            action = agent.act(observation, info)
            observation, _, terminated, truncated, info = agent.drive(loop, action)
            over = terminated or truncated
        path[k] = info["pose"][:2]
    driven = expert.pose[step + 1 : step + 1 + horizon, :2].copy()
    return PathPair(expert.seed, step, path, driven)


def spread_steps(
    lengths: Sequence[int], states: int, horizon: int, rng: np.random.Generator
) -> list[list[int]]:
    """Draw the states that paths are compared from: equally many per episode, spread over it.

    Args:
        lengths: Number of steps of each episode.
        states: How many in all; fewer where episodes are too short.
        horizon: Steps that must remain after a state.
        rng: Random source; each state is drawn from its own equal share of the episode.

    Returns:
        For each episode its steps, increasing.
    """
    usable = [max(0, length - horizon + 1) for length in lengths]
    long_enough = [i for i, room in enumerate(usable) if room > 0]
    steps: list[list[int]] = [[] for _ in lengths]
    for position, episode in enumerate(long_enough):
        share = states * (position + 1) // len(long_enough) - states * position // len(long_enough)
        bounds = np.linspace(0, usable[episode], min(share, usable[episode]) + 1).astype(int)
        steps[episode] = rng.integers(bounds[:-1], bounds[1:]).tolist()
    return steps


def _begin(loop: ControlLoop, agent: Agent, seed: int) -> tuple[Observation, dict[str, Any]]:
    agent.reset(seed)
    planner = loop.supervision.planner
    if planner is not None:
        planner.generator.manual_seed(seed)
    return loop.reset(seed=seed)


def _restore(
    loop: ControlLoop, reference: Supervision, agent: Agent, seed: int, step: int
) -> tuple[Observation, dict[str, Any]]:
    """Bring the loop into the state after `step` steps of the expert, under the agent's watch."""
    own, loop.supervision = loop.supervision, reference
    try:
        loop.city.camera_on = step == 0
        observation, info = _begin(loop, agent, seed)
        for k in range(step):
            loop.city.camera_on = k == step - 1
            observation, _, _, _, info = loop.step_expert()
    finally:
        loop.city.camera_on = True
        loop.supervision = own
    if own.planner is not None and own.blend is not None:
        own.planner.generator.manual_seed(seed)
        own.planner.reset()
        own.blend.reset()
    if own.safety_filter is not None:
        own.safety_filter.reset(info["context"].previous)
    return observation, info
