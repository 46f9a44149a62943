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
from shield.limits.rounding import BAND, difference_exceeds, sum_above, sum_below

__all__ = ["Repaired", "is_admissible", "lateral_boundary", "repair", "worst_excess"]

Command = tuple[float, float]

# Points computed on the lateral boundary aim at this share of the bound: far enough inside that
# their rounding errors cannot matter, near enough to cost nothing.
_INWARD = 1.0 - 16.0 * BAND
_NEWTON_STEPS = 4


class Repaired(NamedTuple):
    """Outcome of `repair`: flat commands (δ0, v0, δ1, v1, ...), length 2 H.

    It is not complete when some step could not keep every bound because its predecessor, and so
    `previous`, was inadmissible; that step is then the full-rate approach.
    """

    commands: list[float]
    complete: bool
    lateral_active: bool  # whether some step had to move for the lateral bound


def repair(
    limits: ActuatorLimits,
    targets: list[float],
    steering: float,
    speed: float,
    weights: tuple[float, float] | None = None,
) -> Repaired:
    """Move a horizon step by step into the exact bounds.

    Args:
        limits: Limits of the vehicle.
        targets: Flat finite targets (δ0, v0, δ1, v1, ...), length 2 H; admissible ones come back
            bit by bit.
        steering: Executed before the first step [rad], finite.
        speed: Executed before the first step [m/s], finite.
        weights: Weights of steering and speed in the distance that the lateral step minimises.
            Default: distances in steps of the actuators.
    """
    low, high, step = limits.min_speed, limits.max_speed, limits.steering_step
    increase, decrease = limits.acceleration_step, limits.deceleration_step
    certain, side = limits.certain_bound, limits.max_steering
    bounded = certain < math.inf
    commands: list[float] = []
    complete, lateral_active = True, False
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
            if v - speed >= increase:
                v = min(v, sum_below(speed, increase))
            elif v - speed <= -decrease:
                v = max(v, sum_above(speed, -decrease))
        else:
            delta, v, complete = _into_window(limits, (delta, v), (steering, speed))
            inside = True
        if bounded and v * v * abs(math.tan(delta)) > certain:
            (delta, v), fits = _into_lateral(limits, (delta, v), (steering, speed), weights)
            complete, lateral_active = complete and fits, True
        commands += (delta, v)
        steering, speed = delta, v
    return Repaired(commands, complete, lateral_active)


def _into_window(
    limits: ActuatorLimits, target: Command, last: Command
) -> tuple[float, float, bool]:
    """Return the point of box and rate window nearest to a target, and whether there is any."""
    side, step = limits.max_steering, limits.steering_step
    delta, fits = _into_interval(target[0], last[0], (-side, side), (step, step))
    v, fits_too = _into_interval(
        target[1],
        last[1],
        (limits.min_speed, limits.max_speed),
        (limits.acceleration_step, limits.deceleration_step),
    )
    return delta, v, fits and fits_too


def _into_interval(value: float, last: float, box: Command, steps: Command) -> tuple[float, bool]:
    """Return the nearest value of box ∩ rate window, and whether that set is not empty."""
    (low, high), (increase, decrease) = box, steps
    value = low if value < low else high if value > high else value
    difference = value - last
    if -decrease < difference < increase:
        return value, True
    if difference >= increase:
        value = min(value, max(low, sum_below(last, increase)))
        return value, not difference_exceeds(value, last, increase)
    value = max(value, min(high, sum_above(last, -decrease)))
    return value, not difference_exceeds(last, value, decrease)


def _into_lateral(
    limits: ActuatorLimits, target: Command, last: Command, weights: tuple[float, float] | None
) -> tuple[Command, bool]:
    """Move a point of the window into the lateral bound; return it and whether it keeps that."""
    certain = limits.certain_bound
    corner_delta, corner_v, _ = _into_window(limits, (0.0, 0.0), last)
    corner = (corner_delta, corner_v)
    if _curve(corner) > certain:
        return corner, False
    weights = limits.step_weights if weights is None else weights
    near = lateral_boundary(limits, *target, weights)
    clipped = (_between(near[0], corner[0], target[0]), _between(near[1], corner[1], target[1]))
    if clipped == near and _curve(near) <= certain:
        return near, True
    best, least = corner, math.inf
    # From each of three starts one goes down in speed and one in steering. Moving towards the
    # corner in one coordinate stays in the window, which is a rectangle.
    for delta, v in (clipped, target, (target[0], corner[1])):
        slowed = math.copysign(_boundary_speed(limits, delta), target[1])
        eased = math.copysign(_boundary_steering(limits, v), target[0])
        for point in (
            (delta, _between(slowed, corner[1], v)),
            (_between(eased, corner[0], delta), v),
        ):
            turn, change = point[0] - target[0], point[1] - target[1]
            distance = weights[0] * turn * turn + weights[1] * change * change
            if distance < least and _curve(point) <= certain:
                best, least = point, distance
    return best, True


def _curve(command: Command) -> float:
    """Return v² |tan δ| [m²/s²]."""
    return command[1] * command[1] * abs(math.tan(command[0]))


def _between(value: float, end: float, other_end: float) -> float:
    """Clip `value` to the interval between two ends given in either order."""
    return min(max(value, min(end, other_end)), max(end, other_end))


def _boundary_speed(limits: ActuatorLimits, delta: float) -> float:
    """Return the largest |v| [m/s] at a steering [rad], rounded inwards; infinite at 0."""
    tangent = abs(math.tan(delta))
    return math.sqrt(limits.certain_bound / tangent) * _INWARD if tangent else math.inf


def _boundary_steering(limits: ActuatorLimits, v: float) -> float:
    """Return the largest |δ| at this speed, rounded inwards; π/2 at standstill."""
    square = v * v
    return math.atan(limits.certain_bound / square) * _INWARD if square else math.pi / 2.0


def lateral_boundary(
    limits: ActuatorLimits, delta: float, v: float, weights: tuple[float, float]
) -> Command:
    """Return a point of the lateral boundary close to (δ, v), by Newton steps along the gradient.

    Neither δ nor v is zero; `weights` are those of the squared distance in both.
    """
    if limits.max_lateral_acceleration is None:
        return delta, v
    bound = limits.certain_bound * _INWARD
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


def is_admissible(
    limits: ActuatorLimits, commands: list[float], steering: float, speed: float
) -> bool:
    """Tell whether a flat horizon is finite and keeps G1, G2 and G3 exactly, step by step."""
    low, high, step = limits.min_speed, limits.max_speed, limits.steering_step
    increase, decrease = limits.acceleration_step, limits.deceleration_step
    certain, side = limits.certain_bound, limits.max_steering
    bounded = certain < math.inf
    pairs = iter(commands)
    for delta, v in zip(pairs, pairs, strict=True):
        if not (-side <= delta <= side and low <= v <= high):
            return False
        # A rounded difference strictly inside is inside exactly; only a tie needs a closer look.
        if delta - steering >= step and difference_exceeds(delta, steering, step):
            return False
        if steering - delta >= step and difference_exceeds(steering, delta, step):
            return False
        if v - speed >= increase and difference_exceeds(v, speed, increase):
            return False
        if speed - v >= decrease and difference_exceeds(speed, v, decrease):
            return False
        if bounded and v * v * abs(math.tan(delta)) > certain:
            return False
        steering, speed = delta, v
    return True


def worst_excess(
    limits: ActuatorLimits, commands: list[float], steering: float, speed: float
) -> float:
    """Return the largest violation of a flat horizon as a fraction of the bound it breaks, or 0."""
    if is_admissible(limits, commands, steering, speed):
        return 0.0
    span = limits.max_speed - limits.min_speed or 1.0
    worst = math.ulp(0.0)
    pairs = iter(commands)
    for delta, v in zip(pairs, pairs, strict=True):
        worst = max(
            worst,
            abs(delta) / limits.max_steering - 1.0,
            (v - limits.max_speed) / span,
            (limits.min_speed - v) / span,
            abs(delta - steering) / limits.steering_step - 1.0,
            (v - speed) / limits.acceleration_step - 1.0,
            (speed - v) / limits.deceleration_step - 1.0,
            _curve((delta, v)) / limits.certain_bound - 1.0,
        )
        steering, speed = delta, v
    return worst
