"""What the commands have in common: Hydra composes, mistakes get one line and exit code 2."""

from __future__ import annotations

import functools
import os
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import hydra
from hydra.errors import ConfigCompositionException, HydraException, MissingConfigException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from irl_dal.cli.streams import replace_unknown_characters
from irl_dal.config import ConfigError, register, similar_key
from irl_dal.storage.checkpoint import CheckpointError

__all__ = ["CONFIG_FOLDER", "describe", "run_command"]

CONFIG_FOLDER = Path(__file__).resolve().parents[2] / "configs"
"""Hydra's groups. They lie beside this package in a clone and in an installed wheel alike; an
absolute path, because `configs` may be another package's name where the command is called from."""

USER_ERROR = 2
"""Exit code of a mistake in what was asked for."""

INTERRUPTED = 130
"""Exit code after Ctrl-C, as a shell has it."""

Task = Callable[[DictConfig], None]


def run_command(task: Task, config_name: str) -> None:
    """Compose the configuration from the command line and call `task` with it.

    A wrong configuration, a run folder or a checkpoint that cannot be used end the process with one
    line on stderr and exit code 2; Ctrl-C ends it with one line and exit code 130. A task says
    what is kept by raising `KeyboardInterrupt(words)`.

    Args:
        task: The command.
        config_name: Its root file in `configs/`.

    Raises:
        SystemExit: After such a mistake.
    """
    replace_unknown_characters()
    register()
    # Hydra then raises what it would otherwise print over many lines.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    entry = hydra.main(version_base="1.3", config_path=str(CONFIG_FOLDER), config_name=config_name)(
        _guarded(task)
    )
    try:
        entry()
    except (HydraException, OmegaConfBaseException) as error:
        _fail(describe(error, sys.argv[1:]))
    except KeyboardInterrupt as error:
        print("; ".join(["interrupted", *map(str, error.args)]), file=sys.stderr)
        raise SystemExit(INTERRUPTED) from None


def describe(error: Exception, arguments: Sequence[str]) -> str:
    """One line that names the key and the value of a mistake on the command line.

    Args:
        error: What Hydra or OmegaConf raised.
        arguments: The command line behind the program's name.
    """
    if isinstance(error, MissingConfigException) and error.options is not None:
        group, _, name = str(error.missing_cfg_file).rpartition("/")
        return f"{group} = {name!r}: choose one of {', '.join(sorted(error.options))}"
    text = str(error)
    found = re.search(r"Could not (?:override|append to config|delete).*?'([^']+)'", text)
    if isinstance(error, ConfigCompositionException) and found:
        return _unknown_key(found[1], arguments)
    return " ".join(text.partition("\nSee https")[0].split())


def _guarded(task: Task) -> Task:
    """A task whose expected failures end the process with one line."""

    @functools.wraps(task)
    def run(config: DictConfig) -> None:
        try:
            task(config)
        except (ConfigError, CheckpointError) as error:
            _fail(str(error))

    return run


def _unknown_key(key: str, arguments: Sequence[str]) -> str:
    values = [a.partition("=")[2] for a in arguments if a.lstrip("+~").partition("=")[0] == key]
    line = f"{key} = {values[-1] if values else '?'}: there is no such key"
    close = similar_key(key)
    return f"{line}; did you mean {close}?" if close else line


def _fail(line: str) -> None:
    print(f"error: {line}", file=sys.stderr)
    raise SystemExit(USER_ERROR)
