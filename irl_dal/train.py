"""Train, evaluate and draw.

python -m irl_dal.train [preset=paper|smoke] [variant=NAME] [seed=N] [resume=DIR]
[group.key=value ...]
python -m irl_dal.train -m variant=NAME,NAME seed=0,1 'run_dir=runs/sweep/${variant}-seed${seed}'
"""

from irl_dal.cli.preflight import preflight

preflight("drive", command=__name__)

from dataclasses import replace
from datetime import datetime

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig
from rich.console import Console

from irl_dal.build import build_drivers, build_planner
from irl_dal.cli.command import new_console, run_command
from irl_dal.cli.overrides import as_argument, explicit_overrides, path_argument, require_same
from irl_dal.cli.threads import GRADIENT_THREADS, one_thread
from irl_dal.config import ConfigError, RunConfig, parse
from irl_dal.figures.showcase import show_run
from irl_dal.learning import Pipeline, ProgressBar
from irl_dal.shortcuts import keep_freed_memory
from irl_dal.storage.checkpoint import run_lock
from irl_dal.storage.run_folder import RunFolder, create_run, default_run_dir, open_run, provenance

OWN_KEYS = ("run_dir", "resume")  # of this command beside the configuration's


def main() -> None:
    """Entry point of the command."""
    run_command(_main, "train")


def _main(composed: DictConfig) -> None:
    # The runs of a sweep share a terminal: lines instead of bars that overwrite each other.
    console = new_console(force_terminal=False if _sweeping() else None)
    folder = _new(composed) if composed.resume is None else _earlier(composed)
    if composed.resume is None and folder.evaluation.is_file():
        console.print(f"finished already: {folder.path}", soft_wrap=True)
        return
    try:
        with run_lock(folder.path):
            _train(folder, console)
            show_run(folder, console)
    except KeyboardInterrupt:
        hint = as_argument("resume", str(folder.path))
        raise KeyboardInterrupt(f"go on with {hint}") from None


def _sweeping() -> bool:
    return HydraConfig.get().mode is RunMode.MULTIRUN


def _new(composed: DictConfig) -> RunFolder:
    """A new run, or, in a sweep, the run that the same sweep began before it was interrupted."""
    config = parse(composed)
    path = path_argument(composed, "run_dir") or default_run_dir(config, datetime.now())
    if _sweeping() and path.exists():
        folder = open_run("run_dir", path)
        if folder.config != config:
            raise ConfigError(f"run_dir = {str(path)!r}: began with another configuration")
        return folder
    return create_run(path, config)


def _earlier(composed: DictConfig) -> RunFolder:
    """The run to go on with; only the extent of its evaluation may be stated anew."""
    if composed.run_dir is not None:
        raise ConfigError(f"run_dir = {composed.run_dir!r}: resume={composed.resume} names it")
    resume = path_argument(composed, "resume")
    assert resume is not None
    folder = open_run("resume", resume)
    evaluation = folder.config.evaluation
    for key, value in explicit_overrides(composed, OWN_KEYS):
        if key.split(".")[0] == "evaluation":
            evaluation = parse(composed).evaluation
        else:
            require_same(key, value, folder.config, f"differs from what {folder.path} began with")
    return replace(folder, config=replace(folder.config, evaluation=evaluation))


def _train(folder: RunFolder, console: Console) -> None:
    """Both phases, from the newest checkpoint on if there is one."""
    config: RunConfig = folder.config
    keep_freed_memory()
    # Where the process was given one core alone, further processes would take others' cores.
    drivers = build_drivers(config, processes=GRADIENT_THREADS > 1)
    pipeline = Pipeline(
        config.learning,
        drivers,
        build_planner(config),
        perception=config.perception,
        run_dir=folder.path,
        seed=config.seed,
        progress=ProgressBar(console),
        provenance=provenance(config),
    )
    try:
        if folder.has_checkpoint:
            pipeline.restore()
        console.print(f"run folder: {folder.path}", soft_wrap=True)
        with one_thread():
            pipeline.run()
    finally:
        drivers.close()


if __name__ == "__main__":
    main()
