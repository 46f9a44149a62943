"""What a comparison is asked to do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import TypeAdapter, ValidationError

from irl_dal.config import ConfigError, first_line
from irl_dal.planner import ProjectionMode

Activation = Literal["trigger", "always", "alone"]
"""The planner plans on the trigger, always, or always and drives without the policy: then what is
executed is the plan's own first command, not a blend."""

FIRST_REPORT_SEED = 20_000  # seeds from here on are for reports; nothing is tuned on them


@dataclass(frozen=True, slots=True)
class ComparisonConfig:
    """Extent of a comparison. None of the numbers is in the paper."""

    episodes: int = 50  # of each setting, one seed each
    first_seed: int = FIRST_REPORT_SEED  # of the first one; the others follow
    projections: tuple[ProjectionMode, ...] = ("none", "final", "x0", "xt", "adaptive")
    activations: tuple[Activation, ...] = ("trigger", "always", "alone")
    candidates: int = 16  # plans drawn in each risky state in which every projection plans
    film_duration: float = 20.0  # of the side-by-side video [s]; 0 makes none
    n_jobs: int = 2  # processes that drive at the same time

    def __post_init__(self) -> None:
        for name in ("episodes", "n_jobs", "candidates"):
            if getattr(self, name) < 1:
                raise ValueError(f"`{name}` must be at least 1. Got {getattr(self, name)}.")
        for name in ("first_seed", "film_duration"):
            if not 0 <= getattr(self, name) < float("inf"):
                raise ValueError(f"`{name}` must not be negative. Got {getattr(self, name)}.")
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


def parse_comparison(values: Mapping[str, Any]) -> ComparisonConfig:
    """What the command line says about the comparison; a ConfigError names key and value."""
    try:
        return TypeAdapter(ComparisonConfig).validate_python(dict(values))
    except ValidationError as error:
        raise ConfigError(first_line(error)) from None
