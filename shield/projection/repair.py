r"""The forward repair: any finite horizon becomes one whose bounds hold exactly.

Step by step, with :math:`p` the command before, the target is moved into

.. math:: W = \{l \le u \le h\} \cap \{-b \le u - p \le a\}

whose ends are the outermost float64 numbers that satisfy the exact inequalities, and then, where
the lateral bound is broken, along :math:`|v^2\tan\delta| \le a_{lat}L` inside `W`. The *corner* of
`W`, its smallest :math:`|\delta|` with its smallest :math:`|v|`, minimises the lateral acceleration
over `W`. From an admissible `p` the corner is admissible because `p` lies in `W`, so every step has
an answer and is again admissible: induction proves the horizon. From an inadmissible `p` the corner
is the full-rate approach.
"""

import math
from typing import NamedTuple

from shield.limits.actuator_limits import ActuatorLimits
from shield.limits.rounding import BAND, difference_exceeds, lateral_exceeds, sum_above, sum_below

__all__ = [
    "INWARD",
    "Bounds",
    "Repaired",
    "is_admissible",
    "lateral_boundary",
    "repair",
    "worst_excess",
]

# Points computed on the lateral boundary aim at this share of the bound: far enough inside that
# their rounding errors cannot matter, near enough to cost nothing.
INWARD = 1.0 - 16.0 * BAND
_NEWTON_STEPS = 4


class Bounds(NamedTuple):
    """The numbers of `ActuatorLimits` that the inner loops need, computed once.

    Attributes:
        max_steering: [rad].
        min_speed: [m/s].
        max_speed: [m/s].
        steering_step: Largest change of the steering in one period [rad].
        rise: Largest rise of the speed in one period [m/s].
        fall: Largest fall of the speed in one period [m/s].
        lateral: Lateral acceleration bound [m/s²]; None when off.
        wheelbase: [m].
        surely: v²·|tan δ| up to which the lateral bound holds whatever the rounding [m²/s²].
    """

    max_steering: float
    min_speed: float
    max_speed: float
    steering_step: float
    rise: float
    fall: float
    lateral: float | None
    wheelbase: float
    surely: float

    @classmethod
    def of(cls, limits: ActuatorLimits) -> "Bounds":
        """Collect the numbers of `limits`."""
        lateral = limits.max_lateral_acceleration
        surely = math.inf if lateral is None else lateral * limits.wheelbase * (1.0 - BAND)
        return cls(
            limits.max_steering,
            limits.min_speed,
            limits.max_speed,
            limits.steering_step,
            limits.acceleration_step,
            limits.deceleration_step,
            lateral,
            limits.wheelbase,
            surely,
        )


class Repaired(NamedTuple):
    """Outcome of `repair`.

    Attributes:
        commands: Flat commands (δ0, v0, δ1, v1, ...), length 2 H.
        complete: False when some step could not keep every bound because its predecessor, and so
            `previous`, was inadmissible; that step is then the full-rate approach.
        bent: True when some step had to move for the lateral bound.
    """

    commands: list[float]
    complete: bool
    bent: bool


def repair(
    bounds: Bounds,
    targets: list[float],
    steering: float,
    speed: float,
    weights: tuple[float, float] = (1.0, 1.0),
) -> Repaired:
    """Move a horizon step by step into the exact bounds.

    Args:
        bounds: Limits.
        targets: Flat finite targets (δ0, v0, δ1, v1, ...), length 2 H.
        steering: Steering executed before the first step [rad], finite.
        speed: Speed executed before the first step [m/s], finite.
        weights: Weights of steering and speed in the distance that the lateral step minimises.

    Returns:
        The repaired horizon. Targets that are admissible come back bit by bit.
    """
    low, high, step = bounds.min_speed, bounds.max_speed, bounds.steering_step
    rise, fall, surely, side = bounds.rise, bounds.fall, bounds.surely, bounds.max_steering
    lateral = bounds.lateral
    commands: list[float] = []
    complete, bent = True, False
    inside = -side <= steering <= side and low <= speed <= high
    pairs = iter(targets)
    for delta, v in zip(pairs, pairs, strict=True):
        if inside:
            # With the last command in the box the window is not empty: one clip after the other.
            delta = -side if delta < -side else side if delta > side else delta
            if delta - steering >= step:
                delta = min(delta, sum_below(steering, step))
            elif delta - steering <= -step:
                delta = max(delta, sum_above(steering, -step))
            v = low if v < low else high if v > high else v
            if v - speed >= rise:
                v = min(v, sum_below(speed, rise))
            elif v - speed <= -fall:
                v = max(v, sum_above(speed, -fall))
        else:
            delta, v, complete = _from_outside(bounds, delta, v, steering, speed)
            inside = True
        if lateral is not None and v * v * abs(math.tan(delta)) > surely:
            moved = _into_lateral(bounds, delta, v, steering, speed, weights)
            if moved is not None:
                (delta, v), fits = moved
                complete, bent = complete and fits, True
        commands += (delta, v)
        steering, speed = delta, v
    return Repaired(commands, complete, bent)


def _from_outside(
    bounds: Bounds, delta: float, v: float, steering: float, speed: float
) -> tuple[float, float, bool]:
    """Return the nearest (δ, v) to be reached from outside the box, and whether rates hold."""
    side, step = bounds.max_steering, bounds.steering_step
    delta, fits = _into_window(delta, steering, -side, side, step, step)
    v, fits_too = _into_window(
        v, speed, bounds.min_speed, bounds.max_speed, bounds.rise, bounds.fall
    )
    return delta, v, fits and fits_too


def _into_window(
    value: float, last: float, low: float, high: float, rise: float, fall: float
) -> tuple[float, bool]:
    """Return the nearest value of box ∩ rate window, and whether that set is not empty."""
    value = low if value < low else high if value > high else value
    difference = value - last
    if -fall < difference < rise:
        return value, True
    if difference >= rise:
        value = min(value, max(low, sum_below(last, rise)))
        return value, not difference_exceeds(value, last, rise)
    value = max(value, min(high, sum_above(last, -fall)))
    return value, not difference_exceeds(last, value, fall)


def _into_lateral(
    bounds: Bounds,
    delta: float,
    v: float,
    steering: float,
    speed: float,
    weights: tuple[float, float],
) -> tuple[tuple[float, float], bool] | None:
    """Move (δ, v) of the window into the lateral bound, inside the window.

    Returns:
        The point and whether it keeps the bound; None when (δ, v) itself keeps it.
    """
    lateral, wheelbase = bounds.lateral, bounds.wheelbase
    if lateral is None or not lateral_exceeds(delta, v, lateral, wheelbase):
        return None
    corner_delta, _ = _into_window(
        0.0,
        steering,
        -bounds.max_steering,
        bounds.max_steering,
        bounds.steering_step,
        bounds.steering_step,
    )
    corner_v, _ = _into_window(
        0.0, speed, bounds.min_speed, bounds.max_speed, bounds.rise, bounds.fall
    )
    if lateral_exceeds(corner_delta, corner_v, lateral, wheelbase):
        return (corner_delta, corner_v), False
    near_delta, near_v = lateral_boundary(bounds, delta, v, weights)
    if (
        _is_between(near_delta, corner_delta, delta)
        and _is_between(near_v, corner_v, v)
        and near_v * near_v * abs(math.tan(near_delta)) <= bounds.surely
    ):
        return (near_delta, near_v), True
    near = (_between(near_delta, corner_delta, delta), _between(near_v, corner_v, v))
    best, least = (corner_delta, corner_v), math.inf
    for candidate in _candidates(bounds, near, (delta, v), (corner_delta, corner_v)):
        turn, change = candidate[0] - delta, candidate[1] - v
        distance = weights[0] * turn * turn + weights[1] * change * change
        if distance < least and not lateral_exceeds(*candidate, lateral, wheelbase):
            best, least = candidate, distance
    return best, True


def _candidates(
    bounds: Bounds,
    near: tuple[float, float],
    target: tuple[float, float],
    corner: tuple[float, float],
) -> list[tuple[float, float]]:
    """Return points on the lateral boundary between a target and the corner of its window.

    From each of three starts, the nearest boundary point clipped to the window, the target, and the
    target's steering at the corner's speed, one goes down in speed and one in steering. Moving
    towards the corner in one coordinate stays in the window, which is a rectangle.
    """
    points = []
    for delta, v in (near, target, (target[0], corner[1])):
        slowed = math.copysign(boundary_speed(bounds, delta), target[1])
        eased = math.copysign(_boundary_steering(bounds, v), target[0])
        points.append((delta, _between(slowed, corner[1], v)))
        points.append((_between(eased, corner[0], delta), v))
    return points


def _between(value: float, end: float, other_end: float) -> float:
    """Clip `value` to the interval between two ends given in either order."""
    return min(max(value, min(end, other_end)), max(end, other_end))


def _is_between(value: float, end: float, other_end: float) -> bool:
    """Tell whether `value` lies in the interval between two ends given in either order."""
    return end <= value <= other_end or other_end <= value <= end


def boundary_speed(bounds: Bounds, delta: float) -> float:
    """Return the largest |v| [m/s] at a steering [rad], rounded inwards; infinite at 0."""
    tangent = abs(math.tan(delta))
    if tangent == 0.0 or bounds.lateral is None:
        return math.inf
    return math.sqrt(bounds.lateral * bounds.wheelbase / tangent) * INWARD


def _boundary_steering(bounds: Bounds, v: float) -> float:
    """Return the largest |δ| at this speed, rounded inwards; π/2 at standstill."""
    square = v * v
    if square == 0.0 or bounds.lateral is None:
        return math.pi / 2.0
    return math.atan(bounds.lateral * bounds.wheelbase / square) * INWARD


def lateral_boundary(
    bounds: Bounds, delta: float, v: float, weights: tuple[float, float]
) -> tuple[float, float]:
    """Return a point of the lateral boundary close to (δ, v), by Newton steps along the gradient.

    Args:
        bounds: Limits with a lateral bound.
        delta: Steering [rad], not zero.
        v: Speed [m/s], not zero.
        weights: Weights of the squared distance in steering and speed.
    """
    if bounds.lateral is None:
        return delta, v
    bound = bounds.lateral * bounds.wheelbase * INWARD
    for _ in range(_NEWTON_STEPS):
        tangent = math.tan(abs(delta))
        excess = v * v * tangent - bound
        along_delta = math.copysign(v * v * (1.0 + tangent * tangent), delta)
        along_v = 2.0 * v * tangent
        curvature = along_delta * along_delta / weights[0] + along_v * along_v / weights[1]
        if not 0.0 < curvature < math.inf:
            break
        moved_delta = delta - excess * along_delta / (weights[0] * curvature)
        moved_v = v - excess * along_v / (weights[1] * curvature)
        if moved_delta * delta <= 0.0 or moved_v * v <= 0.0:
            break
        delta, v = moved_delta, moved_v
    return delta, v


def is_admissible(bounds: Bounds, commands: list[float], steering: float, speed: float) -> bool:
    """Tell whether a flat horizon keeps G1, G2 and G3 exactly, step by step from `previous`.

    NaN and infinities are not admissible.
    """
    low, high, step = bounds.min_speed, bounds.max_speed, bounds.steering_step
    rise, fall, surely, side = bounds.rise, bounds.fall, bounds.surely, bounds.max_steering
    lateral = bounds.lateral
    pairs = iter(commands)
    for delta, v in zip(pairs, pairs, strict=True):
        if not (-side <= delta <= side and low <= v <= high):
            return False
        # A rounded difference strictly inside is inside exactly; only a tie needs a closer look.
        if delta - steering >= step and difference_exceeds(delta, steering, step):
            return False
        if steering - delta >= step and difference_exceeds(steering, delta, step):
            return False
        if v - speed >= rise and difference_exceeds(v, speed, rise):
            return False
        if speed - v >= fall and difference_exceeds(speed, v, fall):
            return False
        if lateral is not None and v * v * abs(math.tan(delta)) > surely:
            if lateral_exceeds(delta, v, lateral, bounds.wheelbase):
                return False
        steering, speed = delta, v
    return True


def worst_excess(bounds: Bounds, commands: list[float], steering: float, speed: float) -> float:
    """Return the largest violation as a fraction of the bound it breaks; 0 when all hold exactly.

    Args:
        bounds: Limits.
        commands: Flat horizon, length 2 H.
        steering: Steering before the first step [rad].
        speed: Speed before the first step [m/s].
    """
    if is_admissible(bounds, commands, steering, speed):
        return 0.0
    span = bounds.max_speed - bounds.min_speed or 1.0
    worst = math.ulp(0.0)
    pairs = iter(commands)
    for delta, v in zip(pairs, pairs, strict=True):
        lateral = v * v * abs(math.tan(delta)) / bounds.wheelbase
        worst = max(
            worst,
            abs(delta) / bounds.max_steering - 1.0,
            (v - bounds.max_speed) / span,
            (bounds.min_speed - v) / span,
            abs(delta - steering) / bounds.steering_step - 1.0,
            (v - speed) / bounds.rise - 1.0,
            (speed - v) / bounds.fall - 1.0,
            0.0 if bounds.lateral is None else lateral / bounds.lateral - 1.0,
        )
        steering, speed = delta, v
    return worst
