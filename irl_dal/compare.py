"""Compare pure with projected diffusion on one trained run.

python -m irl_dal.compare run=DIR [episodes=N] [first_seed=N] [projections=[none,x0]] [out=DIR]
"""

from irl_dal.cli.preflight import preflight

preflight("drive", command=__name__)

from dataclasses import fields

from omegaconf import DictConfig, OmegaConf

from irl_dal.cli.command import new_console, run_command
from irl_dal.cli.overrides import apply_overrides, explicit_overrides, path_argument
from irl_dal.comparison.config import ComparisonConfig, parse_comparison
from irl_dal.comparison.drive import ComparisonJob
from irl_dal.comparison.experiment import compare
from irl_dal.comparison.presentation import comparison_tables
from irl_dal.config import ConfigError, parse
from irl_dal.figures.comparison_page import write_comparison_page
from irl_dal.storage.atomic import write_json
from irl_dal.storage.run_folder import open_run

EXTENT_KEYS = frozenset(entry.name for entry in fields(ComparisonConfig))
"""Keys of the comparison's extent."""

COMPARED_KEYS = frozenset({"shield", "shield.enabled"}) | frozenset(
    f"planner.{name}" for name in ("enabled", "activation", "projection", "candidates")
)
"""Keys that differ between the settings."""


def main() -> None:
    """Entry point of the command."""
    run_command(_main, "compare")


def _main(composed: DictConfig) -> None:
    job = _job(composed)
    console = new_console()
    results = compare(job, console)
    write_json(job.results, results)
    for table in comparison_tables(results):
        console.print(table.printed())
    with console.status("drawing the page"):
        write_comparison_page(job, results)
    for path in (job.results, job.page):
        console.print(f"written to {path}", soft_wrap=True)


def _job(composed: DictConfig) -> ComparisonJob:
    run, out = path_argument(composed, "run"), path_argument(composed, "out")
    if run is None:
        raise ConfigError("run = None: name the folder of a trained run")
    values = OmegaConf.to_container(composed, resolve=True)
    assert isinstance(values, dict)
    comparison = parse_comparison({str(key): values[key] for key in EXTENT_KEYS & values.keys()})
    parse(composed)
    folder = open_run("run", run)
    if not folder.config.planner.enabled:
        raise ConfigError(f"run = {str(run)!r}: was trained without a planner")
    values = list(explicit_overrides(composed, EXTENT_KEYS | {"run", "out"}))
    for key, value in values:
        if key in COMPARED_KEYS:
            raise ConfigError(f"{key} = {value!r}: this is what the comparison varies")
    config = apply_overrides(folder.config, values, folder.path)
    return ComparisonJob(config, folder.path, comparison, out or folder.path / "comparison")


if __name__ == "__main__":
    main()
