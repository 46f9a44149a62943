"""The planner's settings."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, get_args

from irl_dal.planner.blend import BlendConfig
from irl_dal.planner.denoiser import DenoiserConfig
from irl_dal.planner.energy import EnergyConfig
from irl_dal.planner.guidance import GuidanceConfig
from irl_dal.planner.noise_schedule import NoiseSchedule, ScheduleKind
from irl_dal.planner.projection import PROJECTION_MODES, ProjectionMode
from irl_dal.planner.sampler import Prediction, Sampler, ddim_transitions, ddpm_transitions

SamplerKind = Literal["ddim", "ddpm"]
Activation = Literal["trigger", "always", "never"]


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
        eta: Noise of `ddim`: 0 deterministic, 1 that of DDPM.
        clip: Clean estimates are clipped to [-clip, clip] before guidance; None for never.
        projection: Where the plan is projected.
        defect_threshold: Defect from which `adaptive` projects, as a share of the bound.
        candidates: N plans drawn in one batch; the one of least energy is taken.
        deadline: Longest time for one plan [s]; past it the fallback is used and counted. None for
            simulated time, which stands still while a plan is made: a busy machine must not change
            a result. 0.08 leaves a margin in the 100 ms of a real control step.
        denoiser: Size of the network.
        guidance: Guidance step.
        energy: Energies.
        blend: Blend with the policy's action.

    Raises:
        ValueError: A value that cannot be meant.
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
    eta: float = 0.0
    clip: float | None = 1.0
    projection: ProjectionMode = "final"
    defect_threshold: float = 0.5
    candidates: int = 1
    deadline: float | None = None
    denoiser: DenoiserConfig = field(default_factory=DenoiserConfig)
    guidance: GuidanceConfig = field(default_factory=GuidanceConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)
    blend: BlendConfig = field(default_factory=BlendConfig)

    def __post_init__(self) -> None:
        if self.horizon < 2 or self.horizon % 2:
            raise ValueError(
                f"`horizon` must be even and at least 2, the U-Net halves it. Got {self.horizon}."
            )
        choices: dict[str, tuple[str, ...]] = {
            "prediction": get_args(Prediction),
            "sampler": get_args(SamplerKind),
            "projection": PROJECTION_MODES,
        }
        for name, known in choices.items():
            value = getattr(self, name)
            if value not in known:
                raise ValueError(f"`{name}` must be one of {known}. Got {value!r}.")
        if self.candidates < 1:
            raise ValueError(f"`candidates` must be at least 1. Got {self.candidates}.")
        for name in ("deadline", "clip"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise ValueError(f"`{name}` must be finite and positive. Got {value}.")
        if not self.defect_threshold >= 0:
            raise ValueError(
                f"`defect_threshold` must not be negative. Got {self.defect_threshold}."
            )
        self.make_sampler()

    def make_sampler(self) -> Sampler:
        """Build the sampler that these settings describe."""
        schedule = NoiseSchedule.make(self.schedule, self.diffusion_steps)
        if self.sampler == "ddpm":
            transitions = ddpm_transitions(schedule)
        else:
            transitions = ddim_transitions(schedule, self.sampling_steps, self.eta)
        return Sampler(transitions, self.prediction, self.clip)
