"""Driving episodes and comparing short drives from the same state."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from irl_dal.evaluation.agents import Agent, ExpertAgent
from irl_dal.evaluation.episode import Episode
from irl_dal.evaluation.statistics import Array
from irl_dal.loop import ControlLoop, Observation, Supervision

Watcher = Callable[[Observation, Mapping[str, Any]], None]


def drive_episode(
    loop: ControlLoop,
    agent: Agent,
    seed: int,
    watch: Watcher | None = None,
    options: dict[str, Any] | None = None,
) -> Episode:
    """Drive one episode; the same seed gives the same road, traffic, light and noise.

    `watch` is called after the reset, which `options` are for, and after every step.
    """
    agent.reset(seed)
    observation, info = loop.reset(seed=seed, options=options)
    infos, actions, rewards, over = [info], [], [], False
    while not over:
        if watch is not None:
            watch(observation, info)
        action = agent.act(observation, info)
        observation, reward, terminated, truncated, info = agent.drive(loop, action)
        actions.append(action)
        rewards.append(float(reward))
        infos.append(info)
        over = terminated or truncated
    if watch is not None:
        watch(observation, info)
    return Episode.of(seed, infos, actions, rewards)


def drive_expert(
    loop: ControlLoop, reference: Supervision, agent: Agent, seed: int
) -> tuple[Episode, Array]:
    """The expert's episode under `reference`, and the agent's actions in its states (T, 2)."""
    answers: list[Array] = []
    agent.reset(seed)
    with loop.under(reference):
        episode = drive_episode(
            loop, ExpertAgent(), seed, lambda seen, info: answers.append(agent.act(seen, info))
        )
    return episode, np.stack(answers[: episode.steps])


def compare_paths(
    loop: ControlLoop, reference: Supervision, agent: Agent, seed: int, step: int, pose: Array
) -> Array:
    """Distances between the agent's and the expert's path from the same state, per step (K,) [m].

    The state is restored by driving the expert's episode again, under `reference` and up to `step`,
    without the camera until the last moment. An agent whose episode ends early (collision, goal)
    stays where it is. `pose` is the expert's in that state and after each of K steps (K + 1, 3).
    """
    if len(pose) < 2:
        raise ValueError(f"`pose` must hold the state and a step after it. Got {len(pose)} rows.")
    observation, info = _restore(loop, reference, agent, seed, step)
    path = np.empty((len(pose) - 1, 2))
    over = False
    for k in range(len(path)):
        if not over:
            action = agent.act(observation, info)
            observation, _, terminated, truncated, info = agent.drive(loop, action)
            over = terminated or truncated
        path[k] = info["pose"][:2]
    return np.asarray(np.linalg.norm(path - pose[1:, :2], axis=1))


def stretches(
    drives: Mapping[int, Array], states: int, horizon: int, rng: np.random.Generator
) -> list[tuple[int, int, Array]]:
    """Draw where the expert's drives (seed: poses) are compared with: seed, step, pose.

    Equally many per drive that is long enough, each from its own equal share of the drive with
    `horizon` steps left; fewer than `states` where the drives are too short.
    """
    usable = {seed: len(pose) - horizon for seed, pose in drives.items() if len(pose) > horizon}
    drawn = []
    for place, (seed, room) in enumerate(usable.items()):
        share = states * (place + 1) // len(usable) - states * place // len(usable)
        bounds = np.linspace(0, room, min(share, room) + 1).astype(int)
        for step in rng.integers(bounds[:-1], bounds[1:]).tolist():
            drawn.append((seed, step, drives[seed][step : step + 1 + horizon]))
    return drawn


def _restore(
    loop: ControlLoop, reference: Supervision, agent: Agent, seed: int, step: int
) -> tuple[Observation, dict[str, Any]]:
    """Bring the loop into the state after `step` steps of the expert, under the agent's watch."""
    agent.reset(seed)
    try:
        with loop.under(reference):
            loop.city.camera_on = step == 0
            observation, info = loop.reset(seed=seed)
            for k in range(step):
                loop.city.camera_on = k == step - 1
                observation, _, _, _, info = loop.step_expert()
    finally:
        loop.city.camera_on = True
    loop.restart_supervision(seed)
    return observation, info
