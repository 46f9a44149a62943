"""Steps per second, side by side with environments that people know, and where the time goes."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any
from unittest.mock import patch

import gymnasium
import numpy as np
from rich.table import Table

from irl_dal.bench.drive import expert_drives
from irl_dal.envs import CityConfig, CityEnv
from irl_dal.envs.lane_camera import LaneCamera
from irl_dal.envs.scenery import Scenery
from irl_dal.envs.sensors import Camera, Lidar
from irl_dal.envs.traffic import Traffic
from irl_dal.envs.world import World

__all__ = ["PEERS", "compare_speed", "missing_peers", "parts_table", "speed_table"]

PEERS = {"CarRacing-v3": "box2d", "racetrack-v0": "highway-env"}
"""Environments beside ours and the package that brings each."""

PARTS: dict[str, tuple[type, str]] = {
    "camera": (Camera, "measure"),
    "physics": (World, "step"),
    "LiDAR": (Lidar, "scan"),
    "lane measurement": (LaneCamera, "measure"),
    "traffic": (Traffic, "step"),
    "road and houses": (Scenery, "show_around"),
}
"""Methods that are timed; what is left is called the rest."""

SEED = 7
"""Of the city's episode."""


@dataclass(slots=True)
class _Runner:
    """Steps one environment, resets included, and remembers how long each chunk took."""

    step: Callable[[], None]
    close: Callable[[], None]
    rates: list[float] = field(default_factory=list)

    def run(self, steps: int) -> None:
        begun = time.process_time()
        for _ in range(steps):
            self.step()
        self.rates.append(steps / (time.process_time() - begun))


def missing_peers() -> dict[str, str]:
    """Peers that cannot be made here, and the package that each one needs."""
    missing = {}
    for name, package in PEERS.items():
        try:
            _peer(name).close()
        except (gymnasium.error.Error, ImportError):
            missing[name] = package
    return missing


def compare_speed(rounds: int, steps: int, config: CityConfig | None = None) -> dict[str, float]:
    """Steps per second of processor time of the city and of each peer that is installed.

    The environments take turns, so that a busy machine slows all of them; medians over the rounds.
    The city drives an expert's episode again, so that traffic is met and resets are rare; the
    peers get random actions, which do not change what a step costs them.

    Args:
        rounds: How often they take turns.
        steps: Steps of each in one round.
        config: The city.
    """
    absent = missing_peers()
    runners = {"IRLDAL/City-v0": _city(config or CityConfig())}
    runners |= {name: _random(_peer(name)) for name in PEERS if name not in absent}
    for runner in runners.values():
        runner.run(min(20, steps))
        runner.rates.clear()
    for _ in range(rounds):
        for runner in runners.values():
            runner.run(steps)
    for runner in runners.values():
        runner.close()
    return {name: float(np.median(runner.rates)) for name, runner in runners.items()}


def speed_table(rates: dict[str, float]) -> Table:
    """Rates and the city's ratio to each."""
    table = Table(title="steps per second of one core (processor time)")
    for title in ("environment", "steps/s", "city is faster by"):
        table.add_column(title, justify="left" if title == "environment" else "right")
    own = next(iter(rates.values()))
    for name, rate in rates.items():
        table.add_row(name, f"{rate:.0f}", "" if rate == own else f"{own / rate:.2f} x")
    return table


def parts_table(steps: int, config: CityConfig | None = None) -> Table:
    """Milliseconds of each part of a step of the city."""
    spent: dict[str, float] = {}
    runner = _city(config or CityConfig())
    with _timed(spent):
        begun = time.process_time()
        for _ in range(steps):
            runner.step()
        total = time.process_time() - begun
    runner.close()
    spent["rest"] = total - sum(spent.values())
    table = Table(title="where a step of the city spends its time")
    for title in ("part", "ms", "share"):
        table.add_column(title, justify="left" if title == "part" else "right")
    for name, seconds in sorted(spent.items(), key=lambda item: -item[1]):
        table.add_row(name, f"{1e3 * seconds / steps:.2f}", f"{seconds / total:.0%}")
    return table


@contextmanager
def _timed(spent: dict[str, float]) -> Iterator[None]:
    with ExitStack() as stack:
        for name, (owner, method) in PARTS.items():
            original = getattr(owner, method)
            stack.enter_context(patch.object(owner, method, _stopwatch(original, name, spent)))
        yield


def _stopwatch(call: Callable[..., Any], name: str, spent: dict[str, float]) -> Callable[..., Any]:
    def timed(*args: Any, **kwargs: Any) -> Any:
        begun = time.process_time()
        result = call(*args, **kwargs)
        spent[name] = spent.get(name, 0.0) + time.process_time() - begun
        return result

    return timed


def _city(config: CityConfig) -> _Runner:
    """The city on an expert's commands, from the start again whenever they end."""
    commands = next(iter(expert_drives(config, [SEED]))).commands
    env = CityEnv(config)
    position = len(commands)

    def step() -> None:
        nonlocal position
        if position == len(commands):
            env.reset(seed=SEED, options={"stretch": 0})
            position = 0
        env.execute(commands[position])
        position += 1

    return _Runner(step, env.close)


def _random(env: gymnasium.Env[Any, Any]) -> _Runner:
    env.reset(seed=0)
    env.action_space.seed(0)

    def step() -> None:
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()

    return _Runner(step, env.close)


def _peer(name: str) -> gymnasium.Env[Any, Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if name == "racetrack-v0":
            import highway_env

            gymnasium.register_envs(highway_env)
        return gymnasium.make(name)
