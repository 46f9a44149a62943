"""The settings of a comparison: one checkpoint under different supervision."""

from __future__ import annotations

from dataclasses import dataclass, replace

from irl_dal.comparison.config import Activation, ComparisonConfig
from irl_dal.config import RunConfig
from irl_dal.planner import ProjectionMode


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
    def baseline(self) -> Setting:
        """Pure diffusion under the same activation."""
        return Setting(self.activation, "none", shielded=False)

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
