"""The planner's settings."""

import math
from dataclasses import dataclass, field
from typing import Literal

from irl_dal.checks import check_choices
from irl_dal.planner.blend import BlendConfig
from irl_dal.planner.energy import EnergyConfig
from irl_dal.planner.guidance import GuidanceConfig
from irl_dal.planner.noise_schedule import NoiseSchedule, ScheduleKind
from irl_dal.planner.projection import ProjectionMode
from irl_dal.planner.sampler import Prediction, Sampler, ddim_transitions, ddpm_transitions
from shield.errors import check_positive, check_within

SamplerKind = Literal["ddim", "ddpm"]
Activation = Literal["trigger", "always"]

# Clean estimates are clipped to [-CLIP, CLIP], the box of the actions, before they are guided
CLIP = 1.0


@dataclass(frozen=True, slots=True)
class PlannerConfig:
    """Settings of the diffusion planner, and when a run asks it."""

    enabled: bool = True
    activation: Activation = "trigger"  # When it is asked
    horizon: int = 8  # H (Table II), even because the U-Net halves it
    diffusion_steps: int = 100  # T (Table II)
    schedule: ScheduleKind = "cosine"  # `printed` is the paper's and leaves signal at T
    prediction: Prediction = "x0"  # What the network predicts, the clean chunk or the noise
    sampler: SamplerKind = "ddim"  # `ddpm` takes all T steps as the paper, `ddim` `sampling_steps`
    sampling_steps: int = 10
    projection: ProjectionMode = "final"  # Where the plan is projected
    candidates: int = 1  # N plans drawn in one batch; the one of least energy is taken
    # Longest time for one plan [s]; past it the fallback is used and counted. None for simulated
    # time, which stands still while a plan is made: a busy machine must not change a result. 0.08
    # leaves a margin in the 100 ms of a real control step.
    deadline: float | None = None
    width: int = 64  # Channels of the network at full length, even; the paper does not give them
    guidance: GuidanceConfig = field(default_factory=GuidanceConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)
    blend: BlendConfig = field(default_factory=BlendConfig)

    def __post_init__(self) -> None:
        for name in ("horizon", "width"):
            value = getattr(self, name)
            if value < 2 or value % 2:
                raise ValueError(f"`{name}` must be even and at least 2. Got {value}.")
        check_choices(self)
        check_within(ValueError, 1, math.inf, candidates=self.candidates)
        if self.deadline is not None:
            check_positive(ValueError, deadline=self.deadline)
        self.make_sampler()

    def make_sampler(self) -> Sampler:
        """Build the sampler that these settings describe."""
        schedule = NoiseSchedule.make(self.schedule, self.diffusion_steps)
        table = (
            ddpm_transitions(schedule)
            if self.sampler == "ddpm"
            else ddim_transitions(schedule, self.sampling_steps)
        )
        return Sampler(table, self.prediction, CLIP)
