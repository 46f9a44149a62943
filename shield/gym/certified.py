"""A predictive filter around the gymnasium environment of a vehicle."""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import ArrayLike

from shield.errors import InvalidProblem
from shield.gym.box_filter import as_action, certify
from shield.gym.vehicle_filter import VehicleFilter
from shield.predictive import PredictiveFilter
from shield.projection.certificate import Certificate, Status
from shield.world.reading import Reading

__all__ = ["CertifiedEnv", "Sense"]

Sense = Callable[[Any, Any, dict[str, Any]], Reading]
"""From environment, observation and info to what the sensors say."""


class CertifiedEnv(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Executes only commands that a certified manoeuvre to rest can follow (G5, G6; G1-G3 exactly).

    `info["certificate"]` says what was done to an action, in the units of the space. After `reset`
    the car counts as driving straight on with its measured speed.

    Args:
        env: Environment that executes (steering, speed), one command per `predictive_filter`'s dt.
            If its actions are something else, `gymnasium.wrappers.TransformAction` goes inside.
        predictive_filter: Belongs to this environment alone.
        sense: Called with `env`, observation and info of every reset and step.
        normalised: Whether actions in [-1, 1] stand for the whole range of the limits, as
            `ActuatorLimits.to_command` maps them, or are commands [rad, m/s].

    Raises:
        InvalidProblem: An argument is of a wrong type, `env` is vectorised, or its action space
            cannot express every command of the limits.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        predictive_filter: PredictiveFilter,
        sense: Sense | None = None,
        *,
        normalised: bool = False,
    ) -> None:
        shield = predictive_filter
        if not isinstance(shield, PredictiveFilter):
            raise InvalidProblem(f"`predictive_filter` must be a PredictiveFilter. Got {shield!r}.")
        if not isinstance(env, gymnasium.Env):
            raise InvalidProblem(f"`env` must be one gymnasium.Env, not vectorised. Got {env}.")
        if not callable(sense):
            raise InvalidProblem(f"`sense` must map env, observation, info. Got {sense!r}.")
        super().__init__(env)
        space, limits = env.action_space, shield.limits
        if not isinstance(space, gymnasium.spaces.Box) or space.shape != (2,):
            raise InvalidProblem(f"`env` must have a Box of two actions. Got {space}.")
        bounds, dtype = (space.low, space.high), space.dtype
        self._gate = VehicleFilter(limits, *bounds, normalised=normalised, dtype=dtype)
        reached = self._gate.limits
        if not np.allclose([reached.low, reached.high], [limits.low, limits.high], atol=1e-6):
            raise InvalidProblem(f"`env` must have all actions of {limits}. Got {space}.")
        self._shield, self._sense = shield, sense

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environment, its world and the commitment."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._shield.reset()
        reading = self._look(observation, info)
        self._gate.reset([0.0, np.nan_to_num(reading.speed)])
        self._shield.restart(self._gate.previous, self._shield.world)
        return observation, info

    def step(self, action: ArrayLike) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Execute the action if it is certified, else the nearest, or the committed backup."""
        certificate = self._filter(action)
        result = self.env.step(certificate.safe_action.copy())
        self._look(result[0], result[4])
        return *result[:4], {**result[4], "certificate": certificate}

    def _look(self, observation: Any, info: dict[str, Any]) -> Reading:
        """Update the world."""
        now = self._sense(self.env, observation, info)
        if not isinstance(now, Reading):
            raise InvalidProblem(f"`sense` must return a Reading. Got {now!r}.")
        self._shield.update(now.scan, now.speed, now.yaw_rate, now.lane, now.age)
        return now

    def _filter(self, action: ArrayLike) -> Certificate:
        """Certify, and round to the space within G1-G3; the filter remembers what is executed."""
        begin, gate = time.perf_counter(), self._gate
        nominal = as_action("action", action, (2,))
        given = nominal.astype(self.env.action_space.dtype)
        certificate = self._shield.filter(gate.to_command(given))
        if certificate.intervened:
            given = gate.to_action(certificate.safe_action)
        last = gate.filter(given)
        self._shield.record(gate.previous)
        status = certificate.status
        if last.intervened and status is Status.NOMINAL:
            status = last.status
        safe, reason = last.safe_action, certificate.reason or last.reason
        answer = certify(nominal, safe, status, reason, last.max_violation, begin)
        return replace(answer, flags=certificate.flags)
