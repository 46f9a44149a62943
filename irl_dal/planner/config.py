"""The planner's settings."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

from irl_dal.planner.blend import BlendConfig
from irl_dal.planner.energy import EnergyConfig
from irl_dal.planner.guidance import GuidanceConfig
from irl_dal.planner.noise_schedule import NoiseSchedule, ScheduleKind
from irl_dal.planner.projection import PROJECTION_MODES, ProjectionMode
from irl_dal.planner.sampler import Prediction, Sampler, ddim_transitions, ddpm_transitions
from shield.arguments import check_positive

SamplerKind = Literal["ddim", "ddpm"]
Activation = Literal["trigger", "always", "never"]

CLIP = 1.0
"""Clean estimates are clipped to [-CLIP, CLIP], the box of the actions, before they are guided."""


@dataclass(frozen=True, slots=True)
class PlannerConfig:
    """Settings of the diffusion planner, and when a run asks it.

    Attributes:
        enabled: Whether a run has a planner.
        activation: When it is asked: on the trigger, always or never.
        without_lane: Whether the trigger asks it also where no lane is seen and nothing is near.
        expert_reference: Whether the expert's command is its reference (E_expert) in training; in
            an evaluation there is no expert to ask.
        horizon: H (Table II), even because the U-Net halves it.
        diffusion_steps: T (Table II).
        schedule: Noise schedule; `printed` is the paper's and leaves signal at T.
        prediction: What the network predicts, the clean chunk or the noise.
        sampler: `ddpm` takes all T steps as the paper does, `ddim` takes `sampling_steps`.
        sampling_steps: Reverse steps of `ddim`.
        projection: Where the plan is projected.
        candidates: N plans drawn in one batch; the one of least energy is taken.
        deadline: Longest time for one plan [s]; past it the fallback is used and counted. None for
            simulated time, which stands still while a plan is made: a busy machine must not change
            a result. 0.08 leaves a margin in the 100 ms of a real control step.
        width: Channels of the network at full length, even; the paper does not give them.
        guidance: Guidance step.
        energy: Energies.
        blend: Blend with the policy's action.

    Raises:
        ValueError: If a field is out of range.
    """

    enabled: bool = True
    activation: Activation = "trigger"
    without_lane: bool = False
    expert_reference: bool = True
    horizon: int = 8
    diffusion_steps: int = 100
    schedule: ScheduleKind = "cosine"
    prediction: Prediction = "x0"
    sampler: SamplerKind = "ddim"
    sampling_steps: int = 10
    projection: ProjectionMode = "final"
    candidates: int = 1
    deadline: float | None = None
    width: int = 64
    guidance: GuidanceConfig = field(default_factory=GuidanceConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)
    blend: BlendConfig = field(default_factory=BlendConfig)

    def __post_init__(self) -> None:
        for name in ("horizon", "width"):
            value = getattr(self, name)
            if value < 2 or value % 2:
                raise ValueError(f"`{name}` must be even and at least 2. Got {value}.")
        choices: dict[str, tuple[str, ...]] = {
            "prediction": get_args(Prediction),
            "sampler": get_args(SamplerKind),
            "projection": PROJECTION_MODES,
        }
        for name, known in choices.items():
            if getattr(self, name) not in known:
                raise ValueError(f"`{name}` must be one of {known}. Got {getattr(self, name)!r}.")
        if self.candidates < 1:
            raise ValueError(f"`candidates` must be at least 1. Got {self.candidates}.")
        if self.deadline is not None:
            check_positive(ValueError, deadline=self.deadline)
        self.make_sampler()

    def make_sampler(self) -> Sampler:
        """Build the sampler that these settings describe."""
        schedule = NoiseSchedule.make(self.schedule, self.diffusion_steps)
        if self.sampler == "ddpm":
            return Sampler(ddpm_transitions(schedule), self.prediction, CLIP)
        return Sampler(ddim_transitions(schedule, self.sampling_steps), self.prediction, CLIP)
