"""The diffusion planner: denoise, guide, project; a plan whatever happens."""

import math
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from irl_dal.arrays import Array
from irl_dal.planner.blend import ActionBlend
from irl_dal.planner.config import PlannerConfig
from irl_dal.planner.context import CONTEXT_SIZE, PlanningContext
from irl_dal.planner.denoiser import ACTION_SIZE, ConditionalUnet1d
from irl_dal.planner.energy import TotalEnergy
from irl_dal.planner.fast_denoiser import FastDenoiser
from irl_dal.planner.guidance import Guidance
from irl_dal.planner.noise_schedule import NoiseSchedule
from irl_dal.planner.projection import PlanProjection, ProjectedPlans
from irl_dal.planner.sampler import Refinement
from shield import ActuatorLimits, ClearanceEstimate, HorizonProjector, LaneEstimate, Status
from shield.projection.fallback import FallbackPlan

# Longest time for a projection without a deadline [s]: a busy machine must not change a result
SIMULATED_TIME_DEADLINE = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A horizon of commands with how it came about. Arrays are read-only."""

    # Commands (H, 2) [rad, m/s], only the first is executed; in mode `none` the sample as it is
    actions: Array
    # The last clean estimate (H, 2) [rad, m/s]; `actions` in mode `none` and for a fallback
    nominal: Array
    candidates: Array  # All candidates as (N, H, 2) [rad, m/s]
    # Of the last projection; `NOMINAL` in mode `none`, `FALLBACK` also without a usable sample
    status: Status
    reason: str  # Why it is a fallback or what the projection said, else empty
    latency: float  # Wall time of the whole call [s]
    energy: float = math.nan  # Of `actions`; NaN for a fallback
    energy_nominal: float = math.nan  # Of `nominal`; NaN for a fallback
    energy_unguided: float = math.nan  # Before the last guidance step; NaN without guidance

    def __post_init__(self) -> None:
        for name in ("actions", "nominal", "candidates"):
            getattr(self, name).setflags(write=False)


class DiffusionPlanner:
    """Plans a horizon of commands by guided, projected denoising (the paper's P_DAL).

    It owns the network. Training calls `loss`; driving calls `plan`, which never raises on what
    values a context holds: a context with NaN, a deadline that passes or a sample that is no number
    give the fallback plan of the shield, with a reason, and are counted.
    The `generator` is the source of all random numbers: initial weights, training noise, samples.
    `counts` has the plans made and the fallbacks by cause: `plans`, `fallback_context`,
    `fallback_deadline`, `fallback_sample`, `fallback_projection` (a previous command from which no
    plan keeps every bound).
    """

    def __init__(
        self,
        config: PlannerConfig,
        limits: ActuatorLimits,
        *,
        generator: torch.Generator,
        solver: str = "osqp",
    ) -> None:
        self.config = config
        self.limits = limits
        self.generator = generator
        seed = torch.randint(2**31, (1,), generator=generator, device=generator.device)
        with torch.random.fork_rng(devices=[]):  # torch's own random stream stays where it is
            torch.manual_seed(int(seed.item()))
            self.denoiser = ConditionalUnet1d(config.width)
        self.blend = ActionBlend(config.blend)
        self.counts: Counter[str] = Counter()
        self._schedule = NoiseSchedule.make(config.schedule, config.diffusion_steps)
        self._sampler = config.make_sampler()
        allowed = SIMULATED_TIME_DEADLINE if config.deadline is None else 0.5 * config.deadline
        self._projector = HorizonProjector(limits, config.horizon, solver=solver, deadline=allowed)
        self._fallback = FallbackPlan(limits)
        self._last_first: Array | None = None
        self._network: FastDenoiser | None = None
        self._trained_here = False
        if config.deadline is not None:
            _compile(config, limits)

    def reset(self) -> None:
        """Forget earlier plans and the blend's average: at the start of an episode.

        Weights that were written into `denoiser` since the last plan are used from here on; those
        of `load_state_dict` and of training with `loss` are at once.
        """
        if self._network is not None and not self._network.is_current():
            self._network = None
        self._fallback.reset()
        self._projector.reset()
        self._last_first = None
        self.blend.reset()

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Take over the `denoiser`'s weights; `RuntimeError` for those of another network."""
        self.denoiser.load_state_dict(state)
        self._network = None

    def loss(self, contexts: Tensor, chunks: Tensor) -> Tensor:
        """The denoising objective on a batch, mean squared error of the prediction, with gradient.

        Of contexts (B, 64) and normalised action chunks (B, H, 2), else `ValueError`.
        """
        self._trained_here = True
        count = len(contexts)
        sizes = {"contexts": (count, CONTEXT_SIZE), "chunks": (count, self.config.horizon, 2)}
        for (name, size), given in zip(sizes.items(), (contexts, chunks), strict=True):
            if given.shape != size:
                raise ValueError(f"`{name}` must be {size}. Got {tuple(given.shape)}.")
        place: dict[str, Any] = {"generator": self.generator, "device": self.generator.device}
        k = torch.randint(1, self._schedule.steps + 1, (count,), **place)
        noise = torch.randn(chunks.shape, **place).to(chunks)
        signal, spread = (
            torch.from_numpy(part(k.cpu().numpy())).to(chunks)[:, None, None]
            for part in (self._schedule.signal, self._schedule.noise)
        )
        predicted = self.denoiser(signal * chunks + spread * noise, k.to(chunks.device), contexts)
        target = chunks if self.config.prediction == "x0" else noise
        return nn.functional.mse_loss(predicted, target)

    @np.errstate(all="ignore")  # absurd but finite values overflow, which is noticed at the end
    def plan(self, context: PlanningContext, watchers: Sequence[Refinement] = ()) -> Plan:
        """Plan from a context; a fallback with a reason when there is no usable sample.

        Watchers see each estimate and iterate after guidance and projection. `ValueError` where the
        context's expert reference has another horizon.
        """
        begin = time.perf_counter()
        reference, horizon = context.expert_reference, self.config.horizon
        if reference is not None and len(reference) != horizon:
            raise ValueError(
                f"`expert_reference` must have shape ({horizon}, 2). Got {reference.shape}."
            )
        self.counts["plans"] += 1
        if not context.finite:
            return self._fall_back(context, "context", "the context is not finite", begin)
        energy = TotalEnergy(context, self.config.energy, self.limits, horizon)
        guidance = Guidance(energy, self.config.guidance)
        projection = PlanProjection(self.config.projection, self._projector, context.previous)
        estimate = self._sample(context, (guidance, projection, *watchers), begin)
        if estimate is None:
            late = f"no plan within {self.config.deadline} s"
            return self._fall_back(context, "deadline", late, begin)
        guided, energy_before = guidance.finish(estimate)
        projected = projection.finish(guided)
        for watcher in watchers:
            watcher.clean(projected.actions, len(self._sampler.transitions) - 1)
        if not (np.isfinite(projected.actions).all() and np.isfinite(projected.nominal).all()):
            return self._fall_back(context, "sample", "the sample is not finite", begin)
        return self._select(energy, energy_before, projected, begin)

    def _sample(
        self, context: PlanningContext, stages: tuple[Refinement, ...], begin: float
    ) -> Array | None:
        """Normalised samples (N, H, 2), or None when the deadline passed."""
        network = self._fast_denoiser()
        films = network.condition(context.encode()[None])
        draws = self._sampler.draw(self.generator, self.config.candidates, self.config.horizon)
        allowed = self.config.deadline
        deadline = math.inf if allowed is None else begin + allowed
        return self._sampler.sample(
            lambda noisy, index: network.predict(noisy, films, index),
            draws,
            stages,
            lambda: time.perf_counter() > deadline,
        )

    def _select(
        self, energy: TotalEnergy, unguided: Array, projected: ProjectedPlans, begin: float
    ) -> Plan:
        """The candidate of least energy as a plan."""
        energies = energy.value(projected.actions)
        best = int(np.argmin(energies))
        nominal = projected.nominal[best].copy()
        status, reason = Status.NOMINAL, ""
        if projected.projections:
            status, reason = projected.projections[best].status, projected.projections[best].reason
            self.counts["fallback_projection"] += int(status is Status.FALLBACK)
        actions = projected.commands[best].copy()
        self._remember(actions)
        return Plan(
            actions=actions,
            nominal=nominal,
            candidates=projected.commands.copy(),
            status=status,
            reason=reason,
            latency=time.perf_counter() - begin,
            energy=float(energies[best]),
            energy_nominal=float(energy.value(self.limits.to_action(nominal)[None])[0]),
            energy_unguided=float(unguided[best]),
        )

    def _fall_back(self, context: PlanningContext, cause: str, reason: str, begin: float) -> Plan:
        """The last plan shifted by one where it is being followed, else braking."""
        self.counts[f"fallback_{cause}"] += 1
        horizon, previous = self.config.horizon, context.previous
        if np.isfinite(previous).all():
            if not self._is_followed(previous):
                self._fallback.reset()
            steering, speed = previous.tolist()
            flat, what = self._fallback.horizon(steering, speed, horizon)
            actions = np.array(flat).reshape(horizon, ACTION_SIZE)
        else:
            what = "braking"
            blank = np.full((horizon, ACTION_SIZE), np.nan)
            actions = self._projector.project(blank, previous).actions.copy()
        self._remember(actions)
        latency, reason = time.perf_counter() - begin, f"{reason}: {what}"
        candidates = actions[None].copy()
        return Plan(actions, actions.copy(), candidates, Status.FALLBACK, reason, latency)

    def _remember(self, actions: Array) -> None:
        """Keep a plan for the case that the next one fails."""
        self._fallback.remember(actions)
        self._last_first = actions[0].copy()

    def _is_followed(self, previous: Array) -> bool:
        """Whether the last executed command is, to one rate step, the last plan's first."""
        if self._last_first is None:
            return False
        step = previous - self._last_first
        limits = self.limits
        return bool(np.all((-limits.max_decrease <= step) & (step <= limits.max_increase)))

    def _fast_denoiser(self) -> FastDenoiser:
        """The network for inference; only where `loss` trains it does each plan compare weights."""
        known = self._network
        if known is None or (self._trained_here and not known.is_current()):
            known = self._network = FastDenoiser(self.denoiser, self._sampler.transitions.k)
        return known


def _compile(config: PlannerConfig, limits: ActuatorLimits) -> None:
    """Plan once without a deadline, so that no later plan is late because of a compiler."""
    near = ClearanceEstimate(5.0, 0.0, 0.1, 0.0, True)
    lane = LaneEstimate(0.0, 0.0, 0.0, 0.0, 0.1, 0.0, True)
    ordinary = PlanningContext(np.full(180, 5.0), near, lane, 5.0, np.array([0.0, 5.0]))
    patient = replace(config, deadline=None)
    DiffusionPlanner(patient, limits, generator=torch.Generator()).plan(ordinary)
