"""What the commands have in common: Hydra composes, a mistake is one line and exit code 2."""

import os
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from io import TextIOWrapper
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException
from rich.console import Console

from irl_dal.cli.overrides import as_argument, is_readable
from irl_dal.config import ConfigError, did_you_mean, is_known, register
from irl_dal.storage.checkpoint import CheckpointError

_PACKAGE = Path(__file__).resolve().parents[1]
# Hydra's groups: inside the package in a wheel, beside it in a clone. An absolute path, because
# `configs` may be another package's name where the command is called from.
CONFIG_FOLDER = next(
    (folder for folder in (_PACKAGE / "configs", _PACKAGE.parent / "configs") if folder.is_dir()),
    _PACKAGE / "configs",
)

# Exit codes of a mistake in what was asked for, and of Ctrl-C, as a shell has it.
USER_ERROR, INTERRUPTED = 2, 130
NO_REMOVAL = ": no key can be removed; switch the part off instead"


def run_command(task: Callable[[DictConfig], None], config_name: str) -> None:
    """Call a command with the configuration that the command line and its file in `configs/` give.

    It may raise KeyboardInterrupt with a line that says how to go on.

    Raises:
        SystemExit: After a mistake, or after Ctrl-C.
    """
    # Hydra then raises what it would otherwise print over many lines.
    os.environ["HYDRA_FULL_ERROR"] = "1"

    def run(composed: DictConfig) -> None:
        with one_line_errors():  # inside: Hydra prints other exceptions than SystemExit
            _refuse_signs(HydraConfig.get().overrides.task)
            task(composed)

    with one_line_errors():
        register()
        main = hydra.main(str(CONFIG_FOLDER), config_name, version_base="1.3")
        main(run)()


@contextmanager
def one_line_errors() -> Iterator[None]:
    """End the process with one line on stderr where a command cannot do what was asked for.

    What the terminal's encoding cannot show is replaced by `?` from now on.

    Raises:
        SystemExit: Code 2 for an unusable configuration, run folder or checkpoint, 130 for Ctrl-C.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")
    code = USER_ERROR
    try:
        yield
        return
    except (ConfigError, CheckpointError) as error:
        line = f"error: {error}"
    except (HydraException, OmegaConfBaseException) as error:
        line = f"error: {_describe(error, sys.argv[1:])}"
    except ValueError as error:
        if not str(error).startswith("Config group override"):  # Hydra's own, of `shield=3`
            raise
        line = f"error: {_no_option(sys.argv[1:])}"
    except KeyboardInterrupt as error:
        line, code = "; ".join(["interrupted", *map(str, error.args)]), INTERRUPTED
    print(line, file=sys.stderr)
    raise SystemExit(code)


def new_console(*, force_terminal: bool | None = None) -> Console:
    """A console that prints names as they are: `[...]` and `:...:` in a path are no markup."""
    return Console(markup=False, emoji=False, force_terminal=force_terminal)


def _describe(error: Exception, arguments: Sequence[str]) -> str:
    """One line that names the key and the value of what Hydra or OmegaConf refuses."""
    if isinstance(error, MissingConfigException) and error.options is not None:
        group, _, name = str(error.missing_cfg_file).rpartition("/")
        return f"{group} = {name!r}: choose one of {', '.join(sorted(error.options))}"
    if isinstance(error, OverrideParseException):  # Hydra's grammar refuses it
        key, equals, value = str(error.override).partition("=")
        if not equals or not is_readable(f"{key}=x"):
            return f"{error.override}: an argument has the form key=value"
        return f"{key} = {value}: this value must be quoted, twice: {as_argument(key, value)}"
    text = str(error)
    if found := re.search(r"(?:Could not append .*?'|Multiple values for )([\w./]+)", text):
        key = found[1].rstrip(".")
        return f"{key} = {_value(key, arguments)}: the key exists, state it without the +"
    if found := re.search(r"Could not delete.*?'([^']+)'", text):
        return f"~{found[1]}{NO_REMOVAL}"
    if found := re.search(r"Could not override.*?'([^']+)'", text):
        key = found[1]
        return f"{key} = {_value(key, arguments)}: there is no such key{did_you_mean(key)}"
    node = re.search(r"Interpolation key '([^']+)'", text)
    where = [f"{argument}: " for argument in arguments if node and node[1] in argument]
    return "".join(where[:1]) + " ".join(text.partition("\nSee https")[0].split())


def _refuse_signs(overrides: Sequence[str]) -> None:
    """Every key that can be stated exists: adding or removing a key is a mistake."""
    for override in overrides:
        key = override.lstrip("+").partition("=")[0]
        if override.startswith("~"):
            raise ConfigError(f"{override}{NO_REMOVAL}")
        if override.startswith("+") and not is_known(key):
            hint = did_you_mean(key)
            raise ConfigError(f"{override}: a key must exist and is stated without the +{hint}")


def _no_option(arguments: Sequence[str]) -> str:
    """A group for which something else than a name is stated."""
    for key, _, value in (argument.partition("=") for argument in arguments):
        options = sorted(file.stem for file in (CONFIG_FOLDER / key).glob("*.yaml"))
        if key and options and not is_readable(f"{key}={value}", value):
            return f"{key} = {value}: choose one of {', '.join(options)}"
    return f"{' '.join(arguments)}: an argument has the form key=value"


def _value(key: str, arguments: Sequence[str]) -> str:
    values = [a.partition("=")[2] for a in arguments if a.lstrip("+~").partition("=")[0] == key]
    return values[-1] if values else "?"
