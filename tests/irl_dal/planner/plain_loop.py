"""The plain way to plan: a torch network in a loop over a scheduler of `diffusers`."""

import importlib
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from irl_dal.planner import DiffusionPlanner, Guidance, PlanningContext, TotalEnergy
from irl_dal.planner.config import CLIP
from irl_dal.planner.noise_schedule import NoiseSchedule
from irl_dal.planner.projection import PlanProjection
from shield import HorizonProjector

__all__ = ["PlainLoop"]

Array = NDArray[np.float64]


class PlainLoop:
    """The same network, guidance and projection as a planner's, step by step.

    Args:
        planner: Whose settings, weights and random source are used; it must predict x0.
        kind: `ddpm` takes all T steps with their noise, `ddim` the sampler's own without.

    Raises:
        ImportError: `diffusers` is not installed.
    """

    def __init__(self, planner: DiffusionPlanner, kind: Literal["ddpm", "ddim"] = "ddpm") -> None:
        config = planner.config
        schedulers: Any = importlib.import_module("diffusers")
        settings = {
            "num_train_timesteps": config.diffusion_steps,
            "trained_betas": NoiseSchedule.make(config.schedule, config.diffusion_steps).beta[1:],
            "prediction_type": "sample",
            "clip_sample": False,
        }
        if kind == "ddpm":
            self._scheduler = schedulers.DDPMScheduler(variance_type="fixed_small", **settings)
            self._scheduler.set_timesteps(config.diffusion_steps)
        else:
            self._scheduler = schedulers.DDIMScheduler(timestep_spacing="trailing", **settings)
            self._scheduler.set_timesteps(config.sampling_steps)
        self._planner = planner
        self._projector = HorizonProjector(planner.limits, config.horizon)

    def plan(self, context: PlanningContext) -> Array:
        """The last clean estimates (N, H, 2), normalised."""
        config, generator = self._planner.config, self._planner.generator
        energy = TotalEnergy(context, config.energy, self._planner.limits, config.horizon)
        steps = len(self._scheduler.timesteps)
        guidance = Guidance(energy, config.guidance)
        projection = PlanProjection(config.projection, self._projector, context.previous)
        code = torch.from_numpy(context.encode())[None]
        shape = (config.candidates, config.horizon, 2)
        noisy = torch.randn(shape, generator=generator)
        clean = np.zeros(shape)
        for index, timestep in enumerate(self._scheduler.timesteps):
            with torch.no_grad():
                k = torch.full((config.candidates,), int(timestep) + 1)
                output: Tensor = self._planner.denoiser(noisy, k, code)
            clean = output.double().numpy()
            clean = np.clip(clean, -CLIP, CLIP)
            if index + 1 == steps:
                break
            refined = torch.from_numpy(projection.clean(guidance.clean(clean, index), index))
            step = self._scheduler.step(refined.float(), timestep, noisy, generator=generator)
            iterate = projection.noisy(step.prev_sample.double().numpy(), index)
            noisy = torch.from_numpy(iterate).float()
        return projection.finish(guidance.finish(clean)[0]).actions
