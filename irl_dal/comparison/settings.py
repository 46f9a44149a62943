"""The arms of a comparison: one checkpoint under different supervision."""

from __future__ import annotations

from dataclasses import dataclass, replace

from irl_dal.comparison.config import Asked, ComparisonConfig
from irl_dal.config import RunConfig
from irl_dal.planner import ProjectionMode

__all__ = ["Arm", "arms_of", "state_arms"]


@dataclass(frozen=True, slots=True)
class Arm:
    """How the same policy and planner are supervised.

    Attributes:
        activation: When the planner is asked.
        projection: Where its plan is projected.
        shielded: Whether the shield has the last word.
        guided: Whether the energies push.
    """

    activation: Asked
    projection: ProjectionMode
    shielded: bool
    guided: bool = True

    @property
    def name(self) -> str:
        """Key in files: activation, projection, shield, guidance."""
        parts = [self.activation, self.projection, "shield" if self.shielded else "bare"]
        return "-".join(parts if self.guided else [*parts, "unguided"])

    @property
    def label(self) -> str:
        """Words for tables and figures."""
        words = f"{self.projection}{' + shield' if self.shielded else ''}"
        return words if self.guided else f"{words}, unguided"

    @property
    def admissible(self) -> bool:
        """Whether everything that it executes has to keep the bounds."""
        return self.shielded or self.projection != "none"

    @property
    def baseline(self) -> Arm:
        """Pure diffusion under the same activation."""
        return Arm(self.activation, "none", shielded=False)

    def configure(self, config: RunConfig, candidates: int | None = None) -> RunConfig:
        """A run's configuration under this supervision.

        Args:
            config: Of the run.
            candidates: Plans drawn at once; None for the run's own.
        """
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


def arms_of(comparison: ComparisonConfig, default: ProjectionMode) -> list[Arm]:
    """All arms: activations x projections x shield, and one without guidance per activation.

    Args:
        comparison: What is asked for.
        default: The run's own projection, which the arm without guidance keeps.
    """
    arms = [
        Arm(activation, projection, shielded)
        for activation in comparison.activations
        for projection in comparison.projections
        for shielded in (False, True)
    ]
    kept = default if default in comparison.projections else comparison.projections[-1]
    return arms + [Arm(one, kept, True, guided=False) for one in comparison.activations]


def state_arms(comparison: ComparisonConfig, default: ProjectionMode) -> list[Arm]:
    """The arms that differ in how they plan, whatever is then done with the plan."""
    first = comparison.activations[0]
    return [arm for arm in arms_of(comparison, default) if arm.shielded and arm.activation == first]
