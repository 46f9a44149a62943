"""Measure city and planner.

python -m irl_dal.bench env      steps per second beside CarRacing-v3 and racetrack-v0
python -m irl_dal.bench lane     lane measurement against the truth
python -m irl_dal.bench expert   success of the expert [--track FILE.csv]
python -m irl_dal.bench faults   success of the expert under each fault, of an agent too [--run DIR]
python -m irl_dal.bench drivers  bad drivers under the shield: whose fault whatever happens is
python -m irl_dal.bench car      step responses of the vehicle
python -m irl_dal.bench planner  how long a plan takes, and where the time goes [--run DIR]
"""

from irl_dal.cli.preflight import preflight

preflight("drive", command=__name__)

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

from rich.console import RenderableType

from irl_dal.bench.car import car_tables
from irl_dal.bench.drive import drives, lane_table, outcome_table
from irl_dal.bench.drivers import DRIVERS
from irl_dal.bench.planner import planner_tables
from irl_dal.bench.speed import speed_tables
from irl_dal.bench.trial import ADVERSARY, driver_tables
from irl_dal.cli.command import new_console, one_line_errors
from irl_dal.cli.threads import one_thread
from irl_dal.config import ConfigError, RunConfig
from irl_dal.envs import FAULTS, CityConfig
from irl_dal.evaluation.rig import AgentSpec
from irl_dal.storage.run_folder import open_run

FIRST_SEED = 20_000  # seeds from here on are for reports; nothing was tuned on them

Parts = Iterator[RenderableType]
Measure = Callable[[argparse.Namespace], Parts]


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, as the other commands do."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"error: {message}\n")


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of the command."""
    options = _parser().parse_args(arguments)
    console = new_console()
    with one_line_errors(), one_thread():
        for part in options.measure(options):
            console.print(part)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="python -m irl_dal.bench", description="Measure city and planner.")
    commands = parser.add_subparsers(required=True, dest="what")
    city, many, run, rounds = (_Parser(add_help=False) for _ in range(4))
    city.add_argument("--difficulty", default="paper", help="easy, paper or hard")
    city.add_argument("--track", help="TUM centre-line CSV file")
    city.add_argument("--route-length", type=_number(float, 1), default=300.0, help="stretch [m]")
    many.add_argument("--episodes", type=_number(int, 1), default=20)
    many.add_argument("--first-seed", type=_number(int, 0), default=FIRST_SEED)
    many.add_argument("--jobs", type=_number(int, 1), default=2, help="processes that drive")
    run.add_argument("--run", type=Path, help="folder of a trained run")
    rounds.add_argument("--rounds", type=_number(int, 1), default=7)

    def add(name: str, measure: Measure, *options: _Parser) -> _Parser:
        command = commands.add_parser(name, parents=options)
        command.set_defaults(measure=measure)
        return command

    env = add("env", lambda o: speed_tables(o.rounds, o.steps, _city(o)), rounds, city)
    env.add_argument("--steps", type=_number(int, 1), default=100, help="in one round")
    for name in ("lane", "expert", "faults"):
        add(name, _drives, many, run, city)
    drivers = add("drivers", _drivers, many, city)
    drivers.add_argument("--level", default="P0", choices=("P0", "P1", "off"), help="of the shield")
    names = [*DRIVERS, ADVERSARY]
    drivers.add_argument("--driver", nargs="+", choices=names, default=names)
    add("car", lambda o: car_tables())
    planner = add("planner", lambda o: planner_tables(o.run, o.rounds, o.contexts), rounds, run)
    planner.add_argument("--contexts", type=_number(int, 1), default=60, help="states to plan in")
    return parser


def _number(kind: type[int] | type[float], least: float) -> Callable[[str], float]:
    """Reads a number from `least` to what a seed of every library can be."""

    def read(text: str) -> float:
        with suppress(ValueError):
            if least <= kind(text) < 2**31:
                return kind(text)
        rule = "a whole number" if kind is int else "a number"
        raise argparse.ArgumentTypeError(f"must be {rule} from {least:g} on. Got {text}.")

    return read


def _city(options: argparse.Namespace) -> CityConfig:
    try:
        city = CityConfig(difficulty=options.difficulty)
        if options.track is None:
            return city
        return replace(city, track=options.track, route_length=options.route_length)
    except ValueError as error:
        raise ConfigError(str(error)) from None


def _drives(options: argparse.Namespace) -> Parts:
    """The expert, and the agent of a run if one is named, in one city or under each fault."""
    city = _city(options)
    drivers = {"expert": (RunConfig(), AgentSpec("expert"))}
    if options.run is not None:
        folder = open_run("--run", options.run)
        drivers[folder.config.variant] = (folder.config, AgentSpec("run", folder.path))
    cities = {options.difficulty if options.track is None else Path(options.track).stem: city}
    if options.what == "faults":
        cities = {name: replace(city, faults=fault) for name, fault in FAULTS.items()}
    seeds = range(options.first_seed, options.first_seed + options.episodes)
    for driver, (config, spec) in drivers.items():
        groups = {
            name: drives(replace(config, env=place), spec, seeds, options.jobs, name, new_console())
            for name, place in cities.items()
        }
        if options.what == "lane":
            yield lane_table(next(iter(groups.values())))
        yield outcome_table(driver, groups)


def _drivers(options: argparse.Namespace) -> Parts:
    config = RunConfig(env=_city(options))
    config = replace(config, shield=replace(config.shield, level=options.level))
    seeds = range(options.first_seed, options.first_seed + options.episodes)
    return driver_tables(config, options.driver, seeds, options.jobs, new_console())


if __name__ == "__main__":
    main()
