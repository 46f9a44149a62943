"""The shield around a gymnasium environment, single or vectorised."""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shield.errors import Array, InvalidLimits, InvalidProblem, MissingDependency, as_array
from shield.gym.box_filter import BoxFilter
from shield.gym.vehicle_filter import VehicleFilter
from shield.limits.actuator_limits import ActuatorLimits
from shield.predictive import PredictiveFilter

try:
    import gymnasium
    from gymnasium.utils import RecordConstructorArgs
    from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper

    from shield.gym.certified import CertifiedEnv
except ImportError as error:
    raise MissingDependency("shield.gym needs gymnasium: pip install gymnasium") from error

__all__ = ["ShieldedEnv", "ShieldedVectorEnv"]


class ShieldedEnv(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Executes only admissible actions; `info["certificate"]` says what was done to each.

    Works with any environment whose action space is a `Box` of floating point numbers. An action
    that is admissible reaches the environment bit by bit. Everything else is replaced by the
    nearest admissible action that the precision of the space can express. A vectorised environment
    gives a `ShieldedVectorEnv`; with a `PredictiveFilter` in the place of the limits, and `sense`,
    the arguments and the wrapper are those of `CertifiedEnv`.

    Args:
        env: Environment.
        limits: Vehicle limits, for spaces of two numbers (steering, speed), also as a mapping of
            their fields. None: the bounds of the space and `rate`.
        normalised: With `limits` only: whether actions in [-1, 1] stand for the whole range of the
            limits, as `ActuatorLimits.to_command` maps them, or are commands [rad, m/s]. Default:
            normalised if the space is [-1, 1] in both, with a warning, else commands.
        rate: Without `limits` only: largest rates of change per second in the units of the space, a
            number or an array of the space's shape. Default: none.
        dt: Without `limits` only: control period that `rate` refers to [s]. Default: 1, per step.
        low: Without `limits` only: lower bounds. Default: those of the space.
        high: The same, upper bounds.
        rest: Action, with `limits` the command [rad, m/s], that counts as executed at `reset`.
            Default: the one nearest to zero.

    Raises:
        InvalidProblem: The action space is not a `Box` of floating point numbers, or with `limits`
            not one of two, or an argument would have no effect.
        InvalidLimits: No action satisfies the bounds, or there is nothing to hold.
    """

    def __new__(cls, env: Any = None, *args: Any, **kwargs: Any) -> Any:
        """Return a `CertifiedEnv`, or a `ShieldedVectorEnv` for a vectorised environment."""
        if _predictive(args, kwargs):
            return CertifiedEnv(env, *args, **kwargs)
        if isinstance(env, VectorEnv):
            return ShieldedVectorEnv(env, *args, **kwargs)
        return super().__new__(cls)

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        limits: ActuatorLimits | Mapping[str, Any] | None = None,
        *,
        normalised: bool | None = None,
        rate: ArrayLike | None = None,
        dt: float | None = None,
        low: ArrayLike | None = None,
        high: ArrayLike | None = None,
        rest: ArrayLike | None = None,
    ) -> None:
        bounds = _Bounds(limits, normalised, rate, dt, low, high, rest)
        RecordConstructorArgs.__init__(self, **bounds.plain())
        gymnasium.Wrapper.__init__(self, env)
        (self._shield,) = bounds.filters(env.action_space, 1)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environment and the last executed action."""
        self._shield.reset()
        return self.env.reset(seed=seed, options=options)

    def step(self, action: ArrayLike) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Execute the nearest admissible action."""
        certificate = self._shield.filter(action)
        result = self.env.step(certificate.safe_action.copy())
        return *result[:4], {**result[4], "certificate": certificate}


class ShieldedVectorEnv(VectorWrapper):
    """`ShieldedEnv` for a vectorised environment: each sub-environment has its own shield.

    `info["certificate"]` is an array of certificates, with the mask `info["_certificate"]`; it is
    None where a step only reset its sub-environment. Arguments and errors are those of
    `ShieldedEnv`.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], *arguments: Any, **options: Any) -> None:
        if _predictive(arguments, options):
            raise InvalidProblem(f"a PredictiveFilter needs one environment of its own. Got {env}.")
        super().__init__(env)
        bounds = _Bounds(*arguments, **options)
        self._shields = bounds.filters(env.single_action_space, env.num_envs)
        self._mode = env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP)
        self._ended = np.zeros(env.num_envs, dtype=bool)

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environments, those in ``options["reset_mask"]`` if it is given."""
        mask = (options or {}).get("reset_mask", np.ones(self.num_envs, dtype=bool))
        self._reset(mask)
        self._ended = self._ended & ~np.asarray(mask, dtype=bool)
        return self.env.reset(seed=seed, options=options)

    def _reset(self, mask: Any) -> None:
        for shield, chosen in zip(self._shields, mask, strict=True):
            if chosen:
                shield.reset()

    def step(
        self, actions: ArrayLike
    ) -> tuple[Any, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Execute the nearest admissible actions."""
        nominal = np.asarray(actions)
        if nominal.shape[:1] != (self.num_envs,):
            raise InvalidProblem(
                f"`actions` must have shape ({self.num_envs}, ...). Got {nominal.shape}."
            )
        ignored = self._ended & (self._mode == AutoresetMode.NEXT_STEP)
        self._reset(ignored)
        certificates = np.empty(self.num_envs, dtype=object)
        certificates[:] = [shield.filter(nominal[i]) for i, shield in enumerate(self._shields)]
        executed = np.array([certificate.safe_action for certificate in certificates])
        self._reset(ignored)
        certificates[ignored] = None
        observations, rewards, terminated, truncated, info = self.env.step(executed)
        self._ended = np.asarray(terminated | truncated, dtype=bool)
        if self._mode == AutoresetMode.SAME_STEP:
            self._reset(self._ended)
        info = {**info, "certificate": certificates, "_certificate": ~ignored}
        return observations, rewards, terminated, truncated, info


def _predictive(arguments: tuple[Any, ...], options: Mapping[str, Any]) -> bool:
    """Tell whether the arguments behind `env` are those of a `CertifiedEnv`."""
    named = {"predictive_filter", "sense"} & set(options)
    return bool(named) or isinstance(next(iter(arguments), None), PredictiveFilter)


@dataclass(frozen=True, slots=True)
class _Bounds:
    """The arguments of both wrappers."""

    limits: ActuatorLimits | Mapping[str, Any] | None = None
    normalised: bool | None = None
    rate: ArrayLike | None = None
    dt: float | None = None
    low: ArrayLike | None = None
    high: ArrayLike | None = None
    rest: ArrayLike | None = None

    def plain(self) -> dict[str, Any]:
        """Return them as what JSON can hold."""
        values = {name: getattr(self, name) for name in self.__slots__}
        if isinstance(self.limits, ActuatorLimits):
            values["limits"] = asdict(self.limits)
        arrays = [name for name in ("rate", "low", "high", "rest") if values[name] is not None]
        return values | {name: as_array(name, values[name]).tolist() for name in arrays}

    def filters(self, space: Any, count: int) -> list[BoxFilter | VehicleFilter]:
        """Return filters for an action space, each with a memory of its own."""
        if not isinstance(space, gymnasium.spaces.Box) or np.dtype(space.dtype).kind != "f":
            raise InvalidProblem(f"`env` must have a Box of floating point actions. Got {space}.")
        excluded = ("normalised",) if self.limits is None else ("rate", "dt", "low", "high")
        for name in excluded:
            if getattr(self, name) is not None:
                rule = "needs" if self.limits is None else "has no effect with"
                raise InvalidProblem(f"`{name}` {rule} `limits`. Got {getattr(self, name)!r}.")
        make = self._box(space) if self.limits is None else self._vehicle(self.limits, space)
        return [make() for _ in range(count)]

    def _vehicle(
        self, given: ActuatorLimits | Mapping[str, Any], space: gymnasium.spaces.Box
    ) -> Callable[[], VehicleFilter]:
        limits = given if isinstance(given, ActuatorLimits) else ActuatorLimits(**given)
        if space.shape != (2,):
            raise InvalidProblem(
                f"`env` must have actions of shape (2,), steering and speed. Got {space}."
            )
        normalised = self.normalised
        if normalised is None:
            normalised = bool((space.low == -1.0).all() and (space.high == 1.0).all())
            if normalised:
                warnings.warn(
                    "the actions of the space [-1, 1] are taken for normalised ones; say "
                    "`normalised=False` if they are in rad and m/s, `normalised=True` if not",
                    stacklevel=4,
                )
        return lambda: VehicleFilter(
            limits, space.low, space.high, normalised=normalised, dtype=space.dtype, rest=self.rest
        )

    def _box(self, space: gymnasium.spaces.Box) -> Callable[[], BoxFilter]:
        shaped: dict[str, Array] = {}
        for name, default in (("rate", np.inf), ("low", space.low), ("high", space.high)):
            given = getattr(self, name)
            values = as_array(name, default if given is None else given)
            if values.shape not in {(), space.shape}:
                raise InvalidLimits(
                    f"`{name}` must have shape {space.shape} or (). Got {values.shape}."
                )
            shaped[name] = np.broadcast_to(values, space.shape)
        low, high = np.maximum(shaped["low"], space.low), np.minimum(shaped["high"], space.high)
        if (np.isinf(low) & np.isinf(high) & np.isinf(shaped["rate"])).any():
            raise InvalidLimits(
                f"`env` must have bounded actions, or `rate`, `low` and `high` must. Got {space}."
            )
        dt = 1.0 if self.dt is None else self.dt
        return lambda: BoxFilter(low, high, shaped["rate"], dt, dtype=space.dtype, rest=self.rest)
