"""Steps per second, side by side with environments that people know, and where the time goes."""

import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from rich.table import Table

from irl_dal.bench.drive import expert_drives
from irl_dal.bench.stopwatch import time_parts
from irl_dal.envs import CityConfig, CityEnv
from irl_dal.envs.lane_camera import LaneCamera
from irl_dal.envs.scenery import Scenery
from irl_dal.envs.sensors import Camera, Lidar
from irl_dal.envs.traffic import Traffic
from irl_dal.envs.world import World
from irl_dal.figures.table import terminal_table

PEERS = {"CarRacing-v3": "box2d", "racetrack-v0": "highway-env"}
"""Environments beside ours and the package that brings each."""

PARTS: dict[str, list[tuple[type, str]]] = {
    "camera": [(Camera, "measure")],
    "physics": [(World, "step")],
    "LiDAR": [(Lidar, "scan")],
    "lane measurement": [(LaneCamera, "measure")],
    "traffic": [(Traffic, "step")],
    "road and houses": [(Scenery, "show_around")],
}
"""Methods that are timed."""

SEED = 7  # of the city's episode

Step = Callable[[], object]


def speed_tables(rounds: int, steps: int, config: CityConfig) -> Iterator[Table | str]:
    """Everything that the benchmark prints."""
    rates = compare_speed(rounds, steps, config)
    own = rates["IRLDAL/City-v0"]
    rows = [
        [name, f"{rate:.0f}", "" if rate == own else f"{own / rate:.2f} x"]
        for name, rate in rates.items()
    ]
    headings = ["environment", "steps/s", "city is faster by"]
    yield terminal_table("steps per second of one core (processor time)", headings, rows)
    for name in PEERS.keys() - rates.keys():
        yield f"{name} is not installed: pip install {PEERS[name]}"
    yield parts_table(rounds * steps, config)


def compare_speed(rounds: int, steps: int, config: CityConfig) -> dict[str, float]:
    """Steps per second of processor time of the city and of each peer that is installed.

    The environments take turns, so that a busy machine slows all of them; medians over the rounds.
    The city drives an expert's episode again, so that traffic is met and resets are rare; the
    peers get random actions, which do not change what a step costs them.
    """
    environments = {"IRLDAL/City-v0": _city(config)}
    for name in PEERS:
        with suppress(gymnasium.error.Error, ImportError):
            environments[name] = _random(name)
    rates: dict[str, list[float]] = {name: [] for name in environments}
    for step, _ in environments.values():
        _repeat(step, min(20, steps))  # warms up
    for _ in range(rounds):
        for name, (step, _) in environments.items():
            begun = time.process_time()
            _repeat(step, steps)
            rates[name].append(steps / (time.process_time() - begun))
    for _, close in environments.values():
        close()
    return {name: float(np.median(values)) for name, values in rates.items()}


def parts_table(steps: int, config: CityConfig) -> Table:
    """Milliseconds of each part of a step of the city."""
    step, close = _city(config)
    spent = time_parts(PARTS, partial(_repeat, step, steps))
    close()
    total = sum(spent.values())
    rows = [
        [name, f"{1e3 * seconds / steps:.2f}", f"{seconds / total:.0%}"]
        for name, seconds in sorted(spent.items(), key=lambda item: -item[1])
    ]
    return terminal_table("where a step of the city spends its time", ["part", "ms", "share"], rows)


def _repeat(step: Step, times: int) -> None:
    for _ in range(times):
        step()


def _city(config: CityConfig) -> tuple[Step, Step]:
    """Steps the city on an expert's commands, from the start whenever they end; and closes it."""
    (drive,) = expert_drives(config, [SEED])
    commands = drive.commands
    env = CityEnv(config)
    position = len(commands)

    def step() -> None:
        nonlocal position
        if position == len(commands):
            env.reset(seed=SEED, options={"stretch": 0})
            position = 0
        env.execute(commands[position])
        position += 1

    return step, env.close


def _random(name: str) -> tuple[Step, Step]:
    """Steps an environment on random actions; and closes it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if name == "racetrack-v0":
            import highway_env

            gymnasium.register_envs(highway_env)
        env: gymnasium.Env[Any, Any] = gymnasium.make(name)
    env.reset(seed=0)
    env.action_space.seed(0)

    def step() -> None:
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()

    return step, env.close
