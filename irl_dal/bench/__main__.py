"""Measure city, planner and learners.

python -m irl_dal.bench env     steps per second beside CarRacing-v3 and racetrack-v0
python -m irl_dal.bench lane    lane measurement against the truth
python -m irl_dal.bench expert  success of the expert [--track FILE.csv]
python -m irl_dal.bench faults  success of the expert under each fault, of an agent too [--run DIR]
python -m irl_dal.bench car     step responses of the vehicle
python -m irl_dal.bench planner how long a plan takes, and where the time goes [--run DIR]
python -m irl_dal.bench learning how long gradient steps take on one thread and on two
"""

from __future__ import annotations

from irl_dal.cli.preflight import preflight

preflight("drive")

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from irl_dal.bench.car import car_tables
from irl_dal.bench.drive import Drive, drives
from irl_dal.bench.lane import lane_table
from irl_dal.bench.learning import learning_tables
from irl_dal.bench.planner import planner_tables
from irl_dal.bench.speed import compare_speed, missing_peers, parts_table, speed_table
from irl_dal.cli.command import new_console, one_line_errors
from irl_dal.cli.threads import one_thread
from irl_dal.config import ConfigError, RunConfig
from irl_dal.envs import FAULTS, CityConfig
from irl_dal.evaluation.rig import AgentSpec
from irl_dal.storage.checkpoint import CheckpointError
from irl_dal.storage.run_folder import open_run

__all__ = ["main"]

FIRST_SEED = 20_000
"""Seeds from here on are for reports; nothing was tuned on them."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the command.

    Args:
        arguments: Command line; None takes the process's.

    Returns:
        Exit code: 2 for a mistake in what was asked for.
    """
    asked = _parser().parse_args(arguments)
    with one_line_errors():
        try:
            _bench(asked, new_console())
        except (ConfigError, CheckpointError, ValueError) as error:
            print(f"error: {error}", file=sys.stderr)
            return 2
    return 0


def _bench(asked: argparse.Namespace, console: Console) -> None:
    """Measure what was asked for and print it."""
    if asked.what == "planner":
        with one_thread():
            for part in planner_tables(asked.run, asked.rounds, asked.contexts):
                console.print(part)
        return
    if asked.what == "learning":
        with one_thread():
            for table in learning_tables(RunConfig(), asked.rounds):
                console.print(table)
        return
    if asked.what == "car":
        console.print(*car_tables())
        return
    city = CityConfig(difficulty=asked.difficulty)
    if asked.track is not None:
        city = replace(city, track=asked.track, route_length=asked.route_length)
    if asked.what == "env":
        _speed(console, city, asked.rounds, asked.steps)
        return
    subjects = {"expert": (RunConfig(), AgentSpec("expert"))}
    if asked.run is not None:
        folder = open_run("--run", asked.run)
        subjects[folder.config.variant] = (folder.config, AgentSpec("run", folder.path))
    if asked.episodes < 1:
        raise ValueError(f"--episodes must be at least 1. Got {asked.episodes}.")
    seeds = range(asked.first_seed, asked.first_seed + asked.episodes)
    cities = {asked.difficulty if asked.track is None else Path(asked.track).stem: city}
    if asked.what == "faults":
        cities = {name: replace(city, faults=fault) for name, fault in FAULTS.items()}
    for who, (config, spec) in subjects.items():
        found = {
            name: drives(
                replace(config, env=place), spec, seeds, jobs=asked.jobs, what=name, console=console
            )
            for name, place in cities.items()
        }
        if asked.what == "lane":
            console.print(lane_table(next(iter(found.values()))))
        console.print(_outcomes(found, who))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m irl_dal.bench",
        description="Measure the city, the planner and the learners.",
    )
    subjects = ("env", "lane", "expert", "faults", "car", "planner", "learning")
    parser.add_argument("what", choices=subjects)
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--difficulty", default="paper", help="easy, paper or hard")
    parser.add_argument("--track", default=None, help="TUM centre-line CSV file")
    parser.add_argument("--route-length", type=float, default=300.0, help="of a stretch of it [m]")
    parser.add_argument("--run", type=Path, default=None, help="folder of a trained run")
    parser.add_argument("--jobs", type=int, default=2, help="processes that drive")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--contexts", type=int, default=60, help="states to plan in")
    parser.add_argument("--steps", type=int, default=100, help="in one round")
    return parser


def _speed(console: Console, config: CityConfig, rounds: int, steps: int) -> None:
    console.print(speed_table(compare_speed(rounds, steps, config)))
    for name, package in missing_peers().items():
        console.print(f"{name} is not installed: pip install {package}")
    console.print(parts_table(rounds * steps, config))


def _outcomes(groups: dict[str, list[Drive]], title: str) -> Table:
    """Success and its opposites, and how often the driver's own command broke a bound."""
    table = Table(title=title, box=SIMPLE_HEAD, pad_edge=False)
    ends = ("success", "collision", "off_road", "timeout")
    for name in ("", "episodes", *ends, "own violations"):
        table.add_column(name, justify="right" if name else "left")
    for name, driven in groups.items():
        count = Counter(drive.outcome for drive in driven)
        steps = sum(drive.steps for drive in driven)
        share = sum(drive.violations for drive in driven) / steps
        shares = (f"{count[end] / len(driven):.1%}" for end in ends)
        table.add_row(name, str(len(driven)), *shares, f"{share:.2%}")
    return table


if __name__ == "__main__":
    sys.exit(main())
