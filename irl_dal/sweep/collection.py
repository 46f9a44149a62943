"""The results in a folder of runs or of result files, and which of them belong together."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from irl_dal.config import ConfigError
from irl_dal.evaluation.workers import progress_bar
from irl_dal.storage.checkpoint import CheckpointError
from irl_dal.storage.run_folder import open_run
from irl_dal.sweep.result import RunResult, read_result, summarise_run

ORDER = ("ppo_uniform", "fsm_replay", "diffusion", "irl_dal", "shielded", "paper")
"""Variants as the paper's Table I has them, then ours."""

Found = tuple[Path, RunResult]


@dataclass(frozen=True, slots=True)
class Collection:
    """Results that belong into one table: each variant has a single configuration."""

    results: tuple[RunResult, ...]  # by variant and seed
    left_out: tuple[str, ...] = ()  # sentences that name the runs left out, and why

    @property
    def variants(self) -> list[str]:
        """Those that occur, in the paper's order, unknown ones last."""
        names = {result.variant for result in self.results}
        return [name for name in ORDER if name in names] + sorted(names - set(ORDER))

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

    Of each variant the configuration with the most runs is kept, among equals the one that was
    trained last. The others and unfinished runs are left out by name.

    Raises:
        ConfigError: The folder is missing or holds nothing of the kind; a run or file is damaged;
            two runs are of the same variant and seed; evaluations are of different episodes.
    """
    if not folder.is_dir():
        raise ConfigError(f"runs = {str(folder)!r}: there is no such folder")
    try:
        inside = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    except OSError as error:
        raise ConfigError(f"runs = {str(folder)!r}: {error.strerror}") from None
    runs = [path for path in inside if (path / "run.json").is_file()]
    files = [path for path in inside if path.suffix == ".json" and path.name != "references.json"]
    if not runs and not files:
        raise ConfigError(f"runs = {str(folder)!r}: holds neither runs nor results")
    found: list[Found] = [(path, read_result(path)) for path in files]
    left_out = []
    with progress_bar(console) as progress:
        task = progress.add_task("runs", total=len(runs))
        for path in runs:
            result = _result_of_run(path)
            progress.advance(task)
            if result is None:
                left_out.append(f"left out: {path} (not finished)")
            else:
                found.append((path, result))
    if not found:
        raise ConfigError(f"runs = {str(folder)!r}: no run is finished")
    kept, others = _one_configuration_each(found)
    _require_comparable(kept)
    results = sorted((result for _, result in kept), key=lambda r: (r.variant, r.seed))
    return Collection(tuple(results), tuple(left_out + others))


def _result_of_run(path: Path) -> RunResult | None:
    """A run's result; its folder is named in every complaint."""
    try:
        return summarise_run(open_run("runs", path))
    except (ConfigError, CheckpointError) as error:
        line = str(error)
        raise ConfigError(line if str(path) in line else f"{path}: {line}") from None


def _one_configuration_each(found: Sequence[Found]) -> tuple[list[Found], list[str]]:
    """The runs of each variant's most frequent configuration, and sentences about the others."""
    rank: dict[tuple[str, str], tuple[int, str]] = {}
    for _, result in found:
        key = (result.variant, result.configuration)
        count, newest = rank.get(key, (0, ""))
        rank[key] = count + 1, max(newest, str(result.origin.get("started")))
    best_first = sorted(rank, key=rank.__getitem__, reverse=True)
    chosen = dict(reversed(best_first))  # of a variant the last one stays
    kept, others = [], []
    for path, result in found:
        own, row = result.configuration, chosen[result.variant]
        if own == row:
            kept.append((path, result))
        else:
            others.append(f"left out: {path} (configuration {own}, the row has {row})")
    return kept, others


def _require_comparable(found: Sequence[Found]) -> None:
    """Refuse what does not belong into one table."""
    known: dict[str, Path] = {}
    for path, result in found:
        if result.name in known:
            raise ConfigError(f"{path}: is {result.name}, as {known[result.name]} is")
        known[result.name] = path
    extents = {(result.first_seed, len(result.outcomes)): path for path, result in found}
    if len(extents) > 1:
        (first, count), (other, more) = sorted(extents)[:2]
        raise ConfigError(
            f"{extents[other, more]}: evaluated on {more} episodes from seed {other}, "
            f"{extents[first, count]} on {count} from {first}"
        )
