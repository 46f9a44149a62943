"""What a comparison is asked to do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import TypeAdapter, ValidationError

from irl_dal.config import ConfigError
from irl_dal.planner import ProjectionMode

__all__ = ["Asked", "ComparisonConfig", "parse_comparison"]

Asked = Literal["trigger", "always", "alone"]
"""The planner is asked on the trigger, always, or always and drives without the policy: then what
is executed is the plan's own first command, not a blend."""

FIRST_REPORT_SEED = 20_000
"""Seeds from here on are for reports; nothing is tuned on them."""


@dataclass(frozen=True, slots=True)
class ComparisonConfig:
    """Extent of a comparison. None of the numbers is in the paper.

    Attributes:
        episodes: Episodes of each arm, one seed each.
        first_seed: Seed of the first one; the others follow.
        projections: Where the plan is projected, one group of arms each.
        activations: When the planner is asked, one group of arms each.
        states: Logged risky states per episode in which every mode plans.
        candidates: Plans drawn in each of these states.
        path_states: States per episode from which paths are compared (ADE, FDE).
        path_duration: Length of these paths [s].
        film_duration: Of the side-by-side video [s]; 0 makes none.
        n_jobs: Processes that drive at the same time.

    Raises:
        ValueError: A value that cannot be meant.
    """

    episodes: int = 50
    first_seed: int = FIRST_REPORT_SEED
    projections: tuple[ProjectionMode, ...] = ("none", "final", "x0", "xt", "adaptive")
    activations: tuple[Asked, ...] = ("trigger", "always", "alone")
    states: int = 10
    candidates: int = 16
    path_states: int = 1
    path_duration: float = 5.0
    film_duration: float = 20.0
    n_jobs: int = 2

    def __post_init__(self) -> None:
        for name in ("episodes", "n_jobs", "candidates"):
            if getattr(self, name) < 1:
                raise ValueError(f"`{name}` must be at least 1. Got {getattr(self, name)}.")
        for name in ("first_seed", "states", "path_states", "film_duration"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"`{name}` must not be negative. Got {getattr(self, name)}.")
        if not self.path_duration > 0.0:
            raise ValueError(f"`path_duration` must be positive. Got {self.path_duration}.")
        for name in ("projections", "activations"):
            values = getattr(self, name)
            if not values or len(set(values)) < len(values):
                raise ValueError(f"`{name}` must name each choice once. Got {list(values)}.")
        if "none" not in self.projections or len(self.projections) < 2:
            raise ValueError(
                "`projections` must hold none, which the others are compared with, and at least "
                f"one other. Got {list(self.projections)}."
            )

    @property
    def seeds(self) -> range:
        """Seeds of the episodes."""
        return range(self.first_seed, self.first_seed + self.episodes)


_COMPARISON = TypeAdapter(ComparisonConfig)


def parse_comparison(values: Mapping[str, Any]) -> ComparisonConfig:
    """Check what the command line says about the comparison itself.

    Raises:
        ConfigError: A value has the wrong type or cannot be; one line names key and value.
    """
    try:
        return _COMPARISON.validate_python(dict(values))
    except ValidationError as error:
        details = error.errors(include_url=False)[0]
        if details["type"] == "value_error":
            message = details["msg"].removeprefix("Value error, ")
            raise ConfigError(message.replace("`", "", 2)) from None
        where = ".".join(str(part) for part in details["loc"])
        message = f"{details['msg'][:1].lower()}{details['msg'][1:]}"
        raise ConfigError(f"{where} = {details['input']!r}: {message}") from None
