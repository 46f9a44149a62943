"""What the command line states, against what an earlier run was started with."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from irl_dal.config import ConfigError, RunConfig, parse, to_mapping

__all__ = ["changed", "stated", "unchanged"]


def stated(composed: DictConfig, own: Iterable[str]) -> Iterator[tuple[str, Any]]:
    """Keys and values that the command line states, without the command's own.

    Args:
        composed: What Hydra made of it.
        own: Keys that are not part of a run's configuration.
    """
    resolved = OmegaConf.create(OmegaConf.to_container(composed, resolve=True))
    for override in HydraConfig.get().overrides.task:
        key = override.lstrip("+~").partition("=")[0]
        if key not in own:
            yield key, OmegaConf.select(resolved, key)


def changed(config: RunConfig, values: Iterable[tuple[str, Any]]) -> RunConfig:
    """A run's configuration with some values replaced.

    Raises:
        ConfigError: The result cannot be.
    """
    mapping = OmegaConf.create(to_mapping(config))
    for key, value in values:
        OmegaConf.update(mapping, key, value, merge=False, force_add=True)
    return parse(mapping)


def unchanged(key: str, value: Any, config: RunConfig, why: str) -> None:
    """Refuse a value that differs from a run's.

    Args:
        key: What the command line states.
        value: What it states.
        config: The run's configuration.
        why: End of the complaint.

    Raises:
        ConfigError: It differs.
    """
    known = OmegaConf.select(OmegaConf.create(to_mapping(config)), key)
    if known != value:
        shown = "another configuration" if isinstance(value, DictConfig) else repr(value)
        raise ConfigError(f"{key} = {shown}: {why}")
