"""Overrides: what the command line states, against an earlier run, and the paths in it."""

import os
import re
import shlex
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf

from irl_dal.config import ConfigError, RunConfig, parse, to_mapping

SETTLED = ("seed", "variant", "preset")  # keys that the training of a run has settled


def explicit_overrides(composed: DictConfig, own: Iterable[str]) -> Iterator[tuple[str, Any]]:
    """Keys and values that the command line states, without the command's `own` keys."""
    resolved = OmegaConf.create(OmegaConf.to_container(composed, resolve=True))
    for override in HydraConfig.get().overrides.task:
        key = override.lstrip("+").partition("=")[0]
        if key not in own:
            yield key, OmegaConf.select(resolved, key)


def apply_overrides(config: RunConfig, values: Iterable[tuple[str, Any]], run: Path) -> RunConfig:
    """A trained run's configuration with some values replaced.

    Raises:
        ConfigError: As `parse`, or a value differs that the training of `run` has settled.
    """
    mapping = OmegaConf.create(to_mapping(config))
    for key, value in values:
        if key in SETTLED:
            require_same(key, value, config, f"settled by the training of {run}")
        OmegaConf.update(mapping, key, value, merge=False, force_add=True)
    return parse(mapping)


def require_same(key: str, value: Any, config: RunConfig, why: str) -> None:
    """Raise a ConfigError that ends in `why` if a run has another value under `key`."""
    known = OmegaConf.select(OmegaConf.create(to_mapping(config)), key)
    if known != value:
        shown = "another configuration" if isinstance(value, DictConfig) else repr(value)
        raise ConfigError(f"{key} = {shown}: {why}")


def path_argument(composed: DictConfig, key: str) -> Path | None:
    """The path under a key, None where none is stated.

    Raises:
        ConfigError: The value is empty, or Hydra read something else than text: `run_dir=1e3`.
    """
    value = composed[key]
    if value is None:
        return None
    if not isinstance(value, str | int) or isinstance(value, bool) or value == "":
        quoted = as_argument(key, "NAME", force=True)
        raise ConfigError(f"{key} = {value!r}: must be a path; quote it as {quoted}")
    return Path(os.path.expanduser(str(value)))


def require_writable(key: str, path: Path, *, folder: bool = False) -> None:
    """Refuse a target that cannot be written, before anything is computed for it.

    Makes the folder that the target will lie in or, where it is a `folder` itself, the target.

    Raises:
        ConfigError: Nothing can be written there.
    """
    where = f"{key} = {str(path)!r}"
    try:
        if path.exists() and (not path.is_dir() if folder else not path.is_file()):
            raise ConfigError(f"{where}: is {'a file' if folder else 'a folder or a device'}")
        place = path if folder else path.parent
        place.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=place):
            pass
    except OSError as error:
        raise ConfigError(f"{where}: cannot be written ({error.strerror})") from None


def as_argument(key: str, value: str, *, force: bool = False) -> str:
    """`key=value` as a shell takes it so that Hydra reads this text; `force` quotes it anyway."""
    plain = f"{key}={value}"
    if not force and is_readable(plain, value):
        return shlex.quote(plain)
    escaped = value.replace("'", "\\'")
    argument = f"{key}='{escaped}'"
    return shlex.quote(argument) if re.search(r'[$`"\\!]', argument) else f'"{argument}"'


def is_readable(argument: str, value: str | None = None) -> bool:
    """Whether Hydra's grammar reads an argument, and reads `value` in it where that is given."""
    try:
        override = OverridesParser.create().parse_override(argument)
    except HydraException:
        return False
    return value is None or override.value() == value
