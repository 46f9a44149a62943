"""Trials of bad drivers: whatever they ask for, nothing may happen through the car's fault.

A drive ends at the goal, at a contact, when a corner of the car leaves its lanes, at the time limit
or when the car has stood for `PATIENCE`.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from rich.console import Console, RenderableType
from rich.text import Text

from irl_dal.arrays import Array
from irl_dal.bench.drivers import DRIVERS, Driver
from irl_dal.config import RunConfig
from irl_dal.evaluation.rig import AgentSpec, Rig
from irl_dal.evaluation.workers import Workers
from irl_dal.figures.table import terminal_table
from irl_dal.loop import ControlLoop

STREAM = (2_000,)  # spawn key of a driver's random stream: the city has others of the same seed
PATIENCE = 20.0  # [s] of standing still after which a drive ends
STANDS = 0.05  # [m/s] a slower car stands
TRACE = 10  # steps up to an event whose reasons are shown
EVENTS = ("at fault", "departures", "assumption", "hit", "at rest", "arrived", "stood")
PRICE = ("distance driven [m]", "steps changed", "shield p50 [ms]", "p99 [ms]")
ADVERSARY = "adversary"  # who searches over many drives
SEARCHES = 6  # drives in which it looks for the worst commands of a seed
PIECE, REWIND = 1.0, 5.0  # [s] its commands are held; redrawn from so long before the worst moment


@dataclass(frozen=True, slots=True)
class Trial:
    """How one drive of T steps went."""

    seed: int
    end: str  # goal, contact, departure, timeout or stood
    fault: str | None  # verdict on the contact or departure
    distance: float  # driven [m]
    changed: float  # share of steps whose command the shield changed
    shield_time: Array  # of each call (T,) [s]
    clearance: Array  # smallest distance to anything (T,) [m], infinite where the car stands
    reasons: Sequence[str]  # of the last certificates

    @property
    def badness(self) -> tuple[bool, float]:
        """What an adversary is after: a fault, else little clearance."""
        return self.fault is not None, -float(self.clearance.min(initial=np.inf))


def drive(loop: ControlLoop, driver: Driver, seed: int, stretch: int = 0) -> Trial:
    """One drive; a stretch is that of a track."""
    observation, info = loop.reset(seed=seed, options={"stretch": stretch})
    dt, end, fault, standing = loop.limits.dt, "", None, 0
    rows: list[tuple[float, float, float, float]] = []
    reasons: deque[str] = deque(maxlen=TRACE)
    while not end:
        command = np.clip(driver(observation, info), loop.limits.low, loop.limits.high)
        observation, _, _, _, info = loop.step_command(command)
        certificate, speed, fault = info["certificate"], info["speed"], info["fault"]
        standing = standing + 1 if abs(speed) < STANDS else 0
        clearance = np.inf if standing else info["clearance"]
        rows.append((speed * dt, certificate.intervened, certificate.solve_time, clearance))
        reasons.append(certificate.reason)
        ends = {
            "contact": info["contact"],
            "departure": info["departure"],
            "goal": info["goal_distance"] == 0.0,
            "timeout": (len(rows) + 0.5) * dt > loop.city.config.time_limit,
            "stood": standing * dt >= PATIENCE,
        }
        end = next((name for name, reached in ends.items() if reached), "")
    distance, changed, taken, clearances = np.array(rows, np.float64).T
    numbers = float(distance.sum()), float(changed.mean()), taken, clearances
    return Trial(seed, end, fault, *numbers, tuple(reasons))


def search(loop: ControlLoop, rng: np.random.Generator, seed: int, stretch: int = 0) -> Trial:
    """The worst of some drives with random commands, each redrawn from before the worst moment."""
    limits = loop.limits
    count = int(loop.city.config.time_limit / PIECE) + 1
    held = round(PIECE / limits.dt)
    commands = rng.uniform(limits.low, limits.high, (count, 2))
    best, kept = None, commands
    for _ in range(SEARCHES):
        steps = iter(np.repeat(commands, held, axis=0))
        trial = drive(loop, lambda *_, steps=steps: next(steps), seed, stretch)
        if best is None or trial.badness > best.badness:
            best, kept = trial, commands
        if best.fault is not None:
            break
        worst = limits.dt * int(best.clearance.argmin())
        first = max(0, int((worst - REWIND) / PIECE))
        redrawn = rng.uniform(limits.low, limits.high, (count - first, 2))
        commands = np.concatenate([kept[:first], redrawn])
    assert best is not None
    return best


def driver_trials(
    config: RunConfig,
    name: str,
    seeds: Sequence[int],
    jobs: int = 1,
    console: Console | None = None,
) -> list[Trial]:
    """Drives of one driver under the shield alone, a seed each, in `jobs` processes."""
    tasks = [(name, place, seed) for place, seed in enumerate(seeds)]
    return Workers(config, AgentSpec("expert"), jobs, console).map(name, _trial, tasks)


def driver_tables(
    config: RunConfig,
    names: Sequence[str],
    seeds: Sequence[int],
    jobs: int = 1,
    console: Console | None = None,
) -> Iterator[RenderableType]:
    """What happened to each driver, event by event, and all in a table."""
    groups: dict[str, list[Trial]] = {}
    for name in names:
        groups[name] = driver_trials(config, name, seeds, jobs, console)
        for trial in groups[name]:
            if trial.fault is not None:
                yield _report(name, trial)
    level = config.shield.level
    rows = [[name, *_events(group)] for name, group in groups.items()]
    yield terminal_table(f"what happened under {level}", ["", "episodes", *EVENTS], rows)
    rows = [[name, *_price(group)] for name, group in groups.items()]
    yield terminal_table(f"and the price of {level}", ["", *PRICE], rows)


def _trial(rig: Rig, task: tuple[str, int, int]) -> Trial:
    name, place, seed = task
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=STREAM))
    if name == ADVERSARY:
        return search(rig.loop, rng, seed, place)
    return drive(rig.loop, DRIVERS[name](rig.loop, rng), seed, place)


def _events(trials: Sequence[Trial]) -> list[str]:
    verdicts = [(trial.fault or "").split(":")[0] for trial in trials]
    ends = [trial.end for trial in trials]
    counts = [
        verdicts.count("at_fault"), ends.count("departure"), verdicts.count("assumption"),
        verdicts.count("hit_by_other"), verdicts.count("at_rest"), ends.count("goal"),
        ends.count("stood"),
    ]  # fmt: skip
    return [str(count) for count in (len(trials), *counts)]


def _price(trials: Sequence[Trial]) -> list[str]:
    distance, changed = np.mean([(trial.distance, trial.changed) for trial in trials], axis=0)
    times = 1e3 * np.concatenate([trial.shield_time for trial in trials])
    median, late = np.percentile(times, (50, 99))
    return [f"{distance:.0f}", f"{changed:.1%}", f"{median:.2f}", f"{late:.2f}"]


def _report(name: str, trial: Trial) -> Text:
    """A contact or departure, and what the shield said before it."""
    step = len(trial.clearance)
    lines = [f"{name}, seed {trial.seed}, step {step}: {trial.end}, {trial.fault}"]
    first = step - len(trial.reasons) + 1
    lines += [f"  {first + n}: {reason}" for n, reason in enumerate(trial.reasons) if reason]
    return Text("\n".join(lines))
