"""The configuration of a run: composed by Hydra, checked here, then frozen.

Every number lives in the dataclass of the part that it configures. `register` hands these
defaults to Hydra as the base of its groups, so that each key is known to it; the files in
`configs/` say only what differs. `parse` turns what Hydra composed into a `RunConfig` or names the
key that is wrong.
"""

import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields
from difflib import get_close_matches
from functools import cache
from typing import Annotated, Any, Literal

import qpsolvers
from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic import Field, TypeAdapter, ValidationError

from expert import ExpertConfig
from irl_dal.envs import CityConfig
from irl_dal.evaluation.config import EvaluationConfig
from irl_dal.learning import LearningConfig
from irl_dal.perception import PerceptionConfig
from irl_dal.planner import PlannerConfig
from shield import ActuatorLimits, TriggerConfig


class ConfigError(ValueError):
    """A configuration or an argument is unusable; the message is one line naming key and value."""


@dataclass(frozen=True, slots=True)
class ShieldConfig:
    """How the shield takes part in a run; its bounds are `ActuatorLimits`."""

    # Whether it stands between the commands and the actuators. Off for comparisons only.
    enabled: bool = True
    # Of every projection, the shield's and the planner's: osqp, or a name of qpsolvers.
    solver: str = "osqp"
    # What others may do (`shield.Assumptions`): P0 on a road, P1 in a parking lot; off bounds
    # commands alone.
    level: Literal["P0", "P1", "off"] = "P0"
    trigger: TriggerConfig = field(default_factory=TriggerConfig)

    def __post_init__(self) -> None:
        """Refuse a solver that is not installed before anything starts."""
        known = sorted({"osqp", *qpsolvers.available_solvers})
        if self.solver not in known:
            raise ValueError(f"`solver` must be one of {', '.join(known)}. Got {self.solver!r}.")


_PLAIN = ("seed", "variant", "preset")  # fields of `RunConfig` that are values, not sections


@dataclass(frozen=True, slots=True)
class RunConfig:
    """Everything that a run depends on: a section per part, named as its group in `configs/`."""

    # Of every random source of the training.
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**32)] = 0
    variant: str = "shielded"  # name of the compared method
    preset: str = "default"  # name of the extent: default, paper or smoke
    env: CityConfig = field(default_factory=CityConfig)
    expert: ExpertConfig = field(default_factory=ExpertConfig)
    limits: ActuatorLimits = field(default_factory=ActuatorLimits)
    shield: ShieldConfig = field(default_factory=ShieldConfig)
    planner: PlannerConfig = field(default_factory=PlannerConfig)
    perception: PerceptionConfig = field(default_factory=PerceptionConfig)
    learning: LearningConfig = field(default_factory=LearningConfig)
    evaluation: EvaluationConfig = field(default_factory=EvaluationConfig)

    def __post_init__(self) -> None:
        """Keep the seeds of evaluation apart from those of training, the axles within the car."""
        wheelbase, bumper = self.limits.wheelbase, self.env.vehicle.front_bumper
        if wheelbase >= bumper:
            rule = f"must be below `env.vehicle.front_bumper` = {bumper}"
            raise ValueError(f"`limits.wheelbase` {rule}. Got {wheelbase}.")
        last = self.evaluation.first_seed + self.evaluation.episodes - 1
        if last >= self.learning.first_seed:
            rule = f"must stay below `learning.first_seed` = {self.learning.first_seed}"
            raise ValueError(
                f"`evaluation.first_seed` and the episodes after it {rule}. Got seeds up to {last}."
            )


# Hydra's groups: the sections of `RunConfig`; `variant` and `preset` only change these.
GROUPS = tuple(entry.name for entry in fields(RunConfig) if entry.name not in _PLAIN)
_RUN_CONFIG = TypeAdapter(RunConfig)


def to_mapping(config: RunConfig) -> dict[str, Any]:
    """The configuration as nested dictionaries and lists, one entry per group."""
    return dict(json.loads(json.dumps(asdict(config))))


def parse(composed: DictConfig | Mapping[str, Any]) -> RunConfig:
    """Check a composed configuration and freeze it.

    Args:
        composed: Sections as `to_mapping` gives them; interpolations are resolved. Of what Hydra
            composed, keys beside the sections are the command's own; a plain mapping has none.

    Raises:
        ConfigError: A key is unknown, or a value has the wrong type or is out of range.
    """
    mapping: Mapping[str, Any] = composed
    if isinstance(composed, DictConfig):
        try:
            resolved: Any = OmegaConf.to_container(composed, resolve=True)
        except OmegaConfBaseException as error:
            raise ConfigError(f"{error.full_key}: {str(error).splitlines()[0]}") from None
        mapping = {key: value for key, value in resolved.items() if key in (*_PLAIN, *GROUPS)}
    for key, value in _leaves(mapping):
        if value == {}:
            raise ConfigError(f"{key} = {{}}: the section is empty")
        if not is_known(key):
            raise ConfigError(f"{key} = {value!r}: there is no such key{did_you_mean(key)}")
    try:
        return _RUN_CONFIG.validate_python(mapping)
    except ValidationError as error:
        raise ConfigError(first_line(error)) from None


def config_hash(config: RunConfig) -> str:
    """Twelve hexadecimal digits that runs of one configuration share, whatever their seed.

    The evaluation's extent does not enter either: it does not change what was trained.
    """
    mapping = to_mapping(config)
    trained = {key: mapping[key] for key in mapping if key not in ("seed", "preset", "evaluation")}
    text = json.dumps(trained, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def register() -> None:
    """Give Hydra the defaults of every group, as the group's option `base`."""
    store = ConfigStore.instance()
    defaults = to_mapping(RunConfig())
    for group in GROUPS:
        store.store(group=group, name="base", node=defaults[group])


@cache
def known_keys() -> tuple[str, ...]:
    """Every key of a run's configuration, dotted."""
    return tuple(key for key, _ in _leaves(to_mapping(RunConfig())))


def is_known(key: str) -> bool:
    """Whether a dotted key is one of a run's configuration, or a section of it."""
    return any(f"{known}.".startswith(f"{key}.") for known in known_keys())


def did_you_mean(key: str) -> str:
    """A hint at the known key closest to an unknown one: of its name in another section first."""
    known = known_keys()
    elsewhere = [other for other in known if other.split(".")[-1] == key.split(".")[-1]]
    close = get_close_matches(key, elsewhere, n=1, cutoff=0.0) or get_close_matches(key, known, n=1)
    return f"; did you mean {close[0]}?" if close and close[0] != key else ""


def _leaves(mapping: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys and values of everything that is not itself a non-empty dictionary."""
    for key, value in mapping.items():
        if isinstance(value, Mapping) and value:
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def first_line(error: ValidationError) -> str:
    """The first complaint as one line that names the key and the value."""
    details = error.errors(include_url=False)[0]
    path = [str(part) for part in details["loc"]]
    message = details["msg"].removeprefix("Value error, ")
    if details["type"] != "value_error":
        return f"{'.'.join(path)} = {details['input']!r}: {message[:1].lower()}{message[1:]}"
    named = re.match(r"`([\w.]+)`", message)
    return f"{'.'.join([*path, named[1]] if named else path)}: {message}"
