"""Where in the sampling a plan is made admissible.

| mode       | clean estimate A-hat^0_k | iterate x_k | last estimate |
|------------|--------------------------|-------------|---------------|
| `none`     | -                        | -           | -             |
| `final`    | -                        | -           | projected     |
| `x0`       | every step               | -           | projected     |
| `xt`       | -                        | every step  | projected     |
| `adaptive` | where the defect is large| -           | projected     |

The defect is how far an estimate breaks a bound, as a share of that bound. Bounds are tied to the
last executed command, in physical units.

References:
    `xt`: Christopher et al., Projected Generative Diffusion Models, 2024.
    `x0`: DiRecT, arXiv 2606.15359.
    `adaptive`: arXiv 2605.11214.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from irl_dal.arrays import Array
from irl_dal.planner.action_scale import ActionScale
from irl_dal.planner.sampler import Refinement
from shield import ActuatorLimits, HorizonProjector, Projection

ProjectionMode = Literal["none", "final", "x0", "xt", "adaptive"]

PROJECTION_MODES: tuple[str, ...] = get_args(ProjectionMode)
LARGE_DEFECT = 0.5  # Defect from which `adaptive` projects: half of a bound beyond it


@dataclass(frozen=True, slots=True, eq=False)
class ProjectedPlans:
    """What the projection makes of the last estimate."""

    nominal: Array  # The estimate before its projection (B, H, 2) [rad, m/s]
    commands: Array  # After it (B, H, 2) [rad, m/s]; equal to `nominal` in mode `none`
    actions: Array  # The same, normalised
    projections: tuple[Projection, ...]  # One per plan; empty in mode `none`


class PlanProjection(Refinement):
    """Projection inside the reverse process, from the last executed command (2,) [rad, m/s]."""

    def __init__(self, mode: ProjectionMode, projector: HorizonProjector, previous: Array) -> None:
        self._mode = mode
        self._projector = projector
        self._previous = previous
        self._scale = ActionScale(projector.limits)

    def clean(self, clean: Array, index: int) -> Array:
        """The estimate (B, H, 2), projected where the mode says so."""
        if self._mode not in ("x0", "adaptive"):
            return clean
        commands = self._scale.to_command(clean)
        if self._mode == "x0":
            return self._project(commands).actions
        large = defect(commands, self._previous, self._projector.limits) > LARGE_DEFECT
        if not large.any():
            return clean
        refined = clean.copy()
        refined[large] = self._project(commands[large]).actions
        return refined

    def noisy(self, noisy: Array, index: int) -> Array:
        """The iterate (B, H, 2), projected in mode `xt`."""
        if self._mode != "xt":
            return noisy
        return self._project(self._scale.to_command(noisy)).actions

    def finish(self, clean: Array) -> ProjectedPlans:
        """The last estimate (B, H, 2), projected in every mode but `none`."""
        nominal = self._scale.to_command(clean)
        if self._mode == "none":
            return ProjectedPlans(nominal, nominal, clean, ())
        return self._project(nominal)

    def _project(self, nominal: Array) -> ProjectedPlans:
        projections = self._projector.project_batch(nominal, self._previous)
        commands = np.stack([projection.actions for projection in projections])
        return ProjectedPlans(nominal, commands, self._scale.to_action(commands), projections)


def defect(commands: Array, previous: Array, limits: ActuatorLimits) -> Array:
    """How far commands (B, H, 2) [rad, m/s] break box, rates or lateral bound, as its share (B,).

    0 for an admissible horizon after the command `previous` (2,).
    """
    width = limits.high - limits.low
    outside = np.maximum(commands - limits.high, limits.low - commands) / np.where(width, width, 1)
    steps = np.diff(commands, axis=1, prepend=np.broadcast_to(previous, (len(commands), 1, 2)))
    too_fast = np.maximum(steps / limits.max_increase, -steps / limits.max_decrease) - 1.0
    worst = np.maximum(outside, too_fast).max(axis=(1, 2))
    if limits.max_lateral_acceleration is not None:
        lateral = np.abs(limits.lateral_acceleration(commands)) / limits.max_lateral_acceleration
        worst = np.maximum(worst, lateral.max(axis=1) - 1.0)
    return np.asarray(np.maximum(worst, 0.0))
