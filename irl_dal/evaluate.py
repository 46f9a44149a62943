"""Evaluate a trained run, the expert or random actions.

python -m irl_dal.evaluate run=DIR | policy=expert|random
[episodes=N] [first_seed=N] [out=FILE.json]
"""

from irl_dal.cli.preflight import preflight

preflight("drive", command=__name__)

from dataclasses import replace
from pathlib import Path

from omegaconf import DictConfig

from irl_dal.cli.command import new_console, run_command
from irl_dal.cli.overrides import (
    apply_overrides,
    explicit_overrides,
    path_argument,
    require_writable,
)
from irl_dal.config import ConfigError, RunConfig, parse
from irl_dal.evaluation.rig import AgentSpec
from irl_dal.evaluation.suite import evaluate
from irl_dal.evaluation.summary import evaluation_table
from irl_dal.storage.atomic import write_json
from irl_dal.storage.run_folder import open_run

OWN_KEYS = frozenset({"run", "policy", "episodes", "first_seed", "n_jobs", "out", "drive", "step"})
"""Keys of this command beside the configuration's."""


def main() -> None:
    """Entry point of the command."""
    run_command(_main, "evaluate")


def _main(composed: DictConfig) -> None:
    config, spec = subject(composed)
    out = path_argument(composed, "out")
    if out is not None:
        require_writable("out", out)
    runs = Path("runs") if spec.run_dir is None else spec.run_dir.parent
    console = new_console()
    report = evaluate(config, spec, runs, console).report
    title = spec.policy if spec.run_dir is None else f"{config.variant}, {spec.run_dir}"
    table = evaluation_table(report, title)
    if out is not None:
        try:
            write_json(out, report)  # before anything is printed: a terminal can fail, too
        except OSError as error:
            console.print(table)
            raise ConfigError(f"out = {str(out)!r}: not written ({error.strerror})") from None
    console.print(table)
    if out is not None:
        console.print(f"written to {out}", soft_wrap=True)


def subject(composed: DictConfig) -> tuple[RunConfig, AgentSpec]:
    """Who drives, and in which configuration: a run's own, with what the command line states."""
    run, policy = path_argument(composed, "run"), composed.policy
    if (run is None) == (policy is None):
        raise ConfigError(f"run = {composed.run!r}, policy = {policy!r}: give one of the two")
    config = parse(composed)
    if policy is not None:
        if policy not in ("expert", "random"):
            raise ConfigError(f"policy = {policy!r}: choose one of expert, random")
        return config, AgentSpec(policy)
    assert run is not None
    folder = open_run("run", run)
    theirs = replace(folder.config, evaluation=config.evaluation)
    theirs = apply_overrides(theirs, explicit_overrides(composed, OWN_KEYS), folder.path)
    return theirs, AgentSpec("run", folder.path)


if __name__ == "__main__":
    main()
