"""Run folders: what a run was asked for, where it came from, what it produced."""

import json
import os
import platform
import shutil
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import yaml

from irl_dal.cli.threads import GRADIENT_THREADS
from irl_dal.config import GROUPS, ConfigError, RunConfig, config_hash, parse, to_mapping
from irl_dal.shortcuts import in_use
from irl_dal.storage.atomic import write_json

RUN_FORMAT = 2  # raised whenever this version could misread the run folder of an older one


@dataclass(frozen=True, slots=True)
class RunFolder:
    """A run's folder and the configuration that the run was started with."""

    path: Path
    config: RunConfig

    @property
    def has_checkpoint(self) -> bool:
        """Whether a checkpoint was written; a run killed in its first moment has none."""
        return any(entry.name.isdecimal() for entry in (self.path / "checkpoints").glob("*"))

    @property
    def metrics(self) -> Path:
        """The training's log."""
        return self.path / "metrics.csv"

    @property
    def evaluation(self) -> Path:
        """The flat report of the evaluation after the training."""
        return self.path / "evaluation.json"


def default_run_dir(config: RunConfig, now: datetime) -> Path:
    """`runs/<date-time>-<variant>-seed<seed>`."""
    return Path("runs") / f"{now:%Y%m%d-%H%M%S}-{config.variant}-seed{config.seed}"


def create_run(path: Path, config: RunConfig) -> RunFolder:
    """Make a run folder with its resolved configuration and its provenance.

    The folder appears complete: a process that is killed meanwhile leaves none.

    Raises:
        ConfigError: The folder exists already, or it cannot be made.
    """
    where = f"run_dir = {str(path)!r}"
    hidden = path.with_name(f".{path.name[:80]}.{os.getpid()}")
    try:
        if path.exists():
            raise ConfigError(f"{where}: exists already; resume= goes on with it")
        path.parent.mkdir(parents=True, exist_ok=True)
        hidden.mkdir()
        document = yaml.safe_dump(to_mapping(config), sort_keys=False)
        (hidden / "config.yaml").write_text(document, encoding="utf-8")
        origin = {
            "format": RUN_FORMAT,
            "started": datetime.now().astimezone().isoformat(),
            **provenance(config),
            "machine": platform.platform(),
            "gradient_threads": GRADIENT_THREADS,
            "shortcuts": in_use(),
        }
        write_json(hidden / "run.json", origin)
        hidden.rename(path)
    except OSError as error:
        shutil.rmtree(hidden, ignore_errors=True)
        raise ConfigError(f"{where}: cannot be made ({error.strerror})") from None
    return RunFolder(path, config)


def open_run(key: str, path: Path) -> RunFolder:
    """Read the folder of an earlier run.

    Raises:
        ConfigError: It is missing, empty, damaged, no run folder, or of another version; `key` is
            what named it.
    """
    where = f"{key} = {str(path)!r}"
    try:
        if not path.is_dir():
            raise ConfigError(f"{where}: there is no such folder")
        if not any(path.iterdir()):
            raise ConfigError(f"{where}: the folder is empty")
    except OSError as error:
        raise ConfigError(f"{where}: cannot be read ({error.strerror})") from None
    found = read_mapping(path / "run.json", where).get("format")
    if found != RUN_FORMAT:
        raise ConfigError(f"{where}: run format {found!r}, this version reads {RUN_FORMAT}")
    mapping = read_mapping(path / "config.yaml", where, yaml.safe_load)
    try:
        if missing := [group for group in GROUPS if group not in mapping]:
            raise ConfigError(f"{', '.join(missing)}: missing")
        return RunFolder(path, parse(mapping))
    except ConfigError as error:
        raise ConfigError(f"{where}: config.yaml: {error}") from None


def provenance(config: RunConfig) -> dict[str, str]:
    """Where results come from: configuration hash, commit and version of the code."""
    try:
        installed = version("irl-dal")
    except PackageNotFoundError:
        installed = "unknown"
    return {"config_hash": config_hash(config), "commit": _commit(), "version": installed}


def read_mapping(path: Path, where: str, load: Callable[[str], Any] = json.loads) -> dict[str, Any]:
    """Read a file that holds a mapping, JSON or as `load` reads it.

    Raises:
        ConfigError: It is missing, cannot be read or is damaged; `where` comes first.
    """
    try:
        content = load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"{where}: not a run folder, {path.name} is missing") from None
    except OSError as error:
        raise ConfigError(f"{where}: {path.name} cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError, yaml.YAMLError):
        content = None
    if not isinstance(content, Mapping):
        raise ConfigError(f"{where}: {path.name} is damaged")
    return dict(content)


def _commit() -> str:
    """Commit of the clone that this file belongs to, `-dirty` if changed; "unknown" elsewhere."""
    here = Path(__file__).resolve()
    tracked = ("ls-files", "--error-unmatch", here.name)
    described = ("describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")
    said = b""
    try:
        for arguments in (tracked, described):
            command = ["git", "-C", str(here.parent), *arguments]
            said = subprocess.check_output(command, stderr=subprocess.DEVNULL, timeout=10)
    except (OSError, subprocess.SubprocessError):  # no git, or no clone of ours
        return "unknown"
    return said.decode().strip() or "unknown"
