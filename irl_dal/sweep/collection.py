"""Finding the results in a folder of runs, or in a folder of results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from irl_dal.config import ConfigError
from irl_dal.evaluation.workers import progress_bar
from irl_dal.storage.run_folder import open_run
from irl_dal.sweep.result import RunResult, read_result, summarise_run

__all__ = ["ORDER", "Collection", "collect"]

ORDER = ("ppo_uniform", "fsm_replay", "diffusion", "irl_dal", "shielded", "paper")
"""Variants as the paper's Table I has them, then ours."""


@dataclass(frozen=True, slots=True)
class Collection:
    """Results that can be put into one table.

    Attributes:
        results: All of them, by variant and seed.
        unfinished: Run folders that have no evaluation yet.
    """

    results: tuple[RunResult, ...]
    unfinished: tuple[Path, ...]

    @property
    def variants(self) -> list[str]:
        """Those that occur, in the paper's order, unknown ones last."""
        found = {result.variant for result in self.results}
        return [name for name in ORDER if name in found] + sorted(found - set(ORDER))

    @property
    def boundary(self) -> int | None:
        """Step at which the policy begins to drive, where it is the same in all runs."""
        steps = {result.origin.get("imitation_steps") for result in self.results}
        return steps.pop() if len(steps) == 1 else None

    def of(self, variant: str) -> list[RunResult]:
        """The runs of a variant, by seed."""
        return [result for result in self.results if result.variant == variant]


def collect(folder: Path, console: Console | None = None) -> Collection:
    """Read every run folder and every result file that lies in a folder.

    Args:
        folder: Holds run folders, or result files.
        console: Where the progress bar goes.

    Raises:
        ConfigError: The folder is missing or holds nothing of the kind; two runs are of the same
            variant and seed; evaluations are of different episodes.
    """
    if not folder.is_dir():
        raise ConfigError(f"runs = {str(folder)!r}: there is no such folder")
    inside = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    runs = [path for path in inside if (path / "run.json").is_file()]
    files = [path for path in inside if path.suffix == ".json" and path.name != "references.json"]
    if not runs and not files:
        raise ConfigError(f"runs = {str(folder)!r}: holds neither runs nor results")
    found: list[tuple[Path, RunResult]] = [(path, read_result(path)) for path in files]
    unfinished = []
    with progress_bar(console) as progress:
        task = progress.add_task("runs", total=len(runs))
        for path in runs:
            result = summarise_run(open_run("runs", path))
            progress.advance(task)
            if result is None:
                unfinished.append(path)
            else:
                found.append((path, result))
    _comparable(found)
    results = sorted((result for _, result in found), key=lambda one: (one.variant, one.seed))
    return Collection(tuple(results), tuple(unfinished))


def _comparable(found: Sequence[tuple[Path, RunResult]]) -> None:
    """Refuse what does not belong into one table."""
    known: dict[str, Path] = {}
    for path, result in found:
        if result.name in known:
            raise ConfigError(f"{path}: is {result.name}, as {known[result.name]} is")
        known[result.name] = path
    extents = {(one.first_seed, len(one.outcomes)): path for path, one in found}
    if len(extents) > 1:
        (first, count), (other, more) = sorted(extents)[:2]
        raise ConfigError(
            f"{extents[other, more]}: evaluated on {more} episodes from seed {other}, "
            f"{extents[first, count]} on {count} from {first}"
        )
