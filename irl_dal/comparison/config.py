"""What a comparison is asked to do, and its settings: one checkpoint under each supervision."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, Self

from pydantic import TypeAdapter, ValidationError

from irl_dal.config import ConfigError, RunConfig, first_line
from irl_dal.planner import ProjectionMode
from shield.errors import check_within

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
        for name in ("episodes", "n_jobs", "candidates", "first_seed", "film_duration"):
            lowest = int(name not in ("first_seed", "film_duration"))
            check_within(ValueError, lowest, math.inf, **{name: getattr(self, name)})
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


@dataclass(frozen=True, slots=True)
class Setting:
    """How the same policy and planner are supervised."""

    activation: Activation  # when the planner plans
    projection: ProjectionMode  # where its plan is projected
    shielded: bool  # whether the shield has the last word
    guided: bool = True  # whether the energies guide the plan

    @property
    def name(self) -> str:
        """Key in files: activation, projection, shield, guidance."""
        parts = [self.activation, self.projection, "shield" if self.shielded else "bare"]
        return "-".join(parts if self.guided else [*parts, "unguided"])

    @property
    def plan_label(self) -> str:
        """Words for how it plans, whatever is then done with the plan."""
        return self.projection if self.guided else f"{self.projection}, unguided"

    @property
    def label(self) -> str:
        """Words for tables and figures."""
        shield = " + shield" if self.shielded else ""
        return f"{self.projection}{shield}" + ("" if self.guided else ", unguided")

    @property
    def baseline(self) -> Self:
        """Pure diffusion under the same activation."""
        return replace(self, projection="none", shielded=False, guided=True)

    def configure(self, config: RunConfig, candidates: int | None = None) -> RunConfig:
        """A run's configuration under this supervision."""
        guidance, blend = config.planner.guidance, config.planner.blend
        alone = self.activation == "alone"
        planner = replace(
            config.planner,
            activation="trigger" if self.activation == "trigger" else "always",
            projection=self.projection,
            blend=replace(blend, base=1.0) if alone else blend,
            candidates=config.planner.candidates if candidates is None else candidates,
            guidance=guidance if self.guided else replace(guidance, scale=0.0),
        )
        shield = replace(config.shield, enabled=self.shielded)
        return replace(config, planner=planner, shield=shield)


def all_settings(comparison: ComparisonConfig, default: ProjectionMode) -> list[Setting]:
    """Activations x projections x shield, and one setting without guidance per activation."""
    settings = [
        Setting(activation, projection, shielded)
        for activation in comparison.activations
        for projection in comparison.projections
        for shielded in (False, True)
    ]
    kept = default if default in comparison.projections else comparison.projections[-1]
    return settings + [Setting(each, kept, True, guided=False) for each in comparison.activations]


def planning_settings(comparison: ComparisonConfig, default: ProjectionMode) -> list[Setting]:
    """The settings that differ in how they plan, whatever is then done with the plan."""
    settings, first = all_settings(comparison, default), comparison.activations[0]
    return [each for each in settings if each.shielded and each.activation == first]
