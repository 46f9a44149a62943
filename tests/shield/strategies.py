"""Hypothesis strategies: limits, commands and horizons, ordinary and nasty."""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from shield import ActuatorLimits, HorizonProjector, SafetyFilter

Array = NDArray[np.float64]

CITY = ActuatorLimits()
LINEAR = replace(CITY, max_lateral_acceleration=None)
# Vehicles that differ in every way that matters: reversing, never standing still, quick, sluggish,
# at odds with binary fractions, with hardly any lateral acceleration.
VEHICLES = (
    CITY,
    LINEAR,
    ActuatorLimits(min_speed=-3.0, max_speed=5.0, max_steering=1.2, max_lateral_acceleration=2.0),
    ActuatorLimits(min_speed=2.0, max_speed=30.0, max_lateral_acceleration=6.0, dt=0.05),
    ActuatorLimits(dt=0.01, max_steering_rate=0.1, max_acceleration=0.7, max_deceleration=0.3),
    ActuatorLimits(dt=0.3, max_steering_rate=3.0, max_acceleration=30.0, max_deceleration=60.0),
    ActuatorLimits(max_lateral_acceleration=0.05, wheelbase=0.3, max_speed=3.0),
    ActuatorLimits(min_speed=4.0, max_speed=4.0, max_lateral_acceleration=3.0),
)
VIEWS = (1, 2, 8)


@lru_cache(maxsize=64)
def projector(limits: ActuatorLimits, horizon: int) -> HorizonProjector:
    """Return a projector, built once: the OSQP workspace is what takes time."""
    # So long that a busy machine does not decide what is found.
    return HorizonProjector(limits, horizon, deadline=2.0)


@lru_cache(maxsize=64)
def safety_filter(limits: ActuatorLimits) -> SafetyFilter:
    """Return a filter, built once; tests reset it."""
    return SafetyFilter(limits, deadline=2.0)


def _positive(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_subnormal=False)


@st.composite
def random_limits(draw: st.DrawFn) -> ActuatorLimits:
    """Draw limits of any plausible vehicle."""
    slowest = draw(st.sampled_from([0.0, -2.0, 1.0]) | _positive(-5.0, 5.0))
    return ActuatorLimits(
        dt=draw(_positive(1e-3, 0.5)),
        max_steering=draw(_positive(0.01, 1.5)),
        max_steering_rate=draw(_positive(1e-3, 10.0)),
        min_speed=slowest,
        max_speed=slowest + draw(_positive(0.0, 40.0)),
        max_acceleration=draw(_positive(0.01, 20.0)),
        max_deceleration=draw(_positive(0.01, 20.0)),
        max_lateral_acceleration=draw(st.none() | _positive(0.01, 12.0)),
        wheelbase=draw(_positive(0.1, 8.0)),
    )


def vehicles() -> st.SearchStrategy[ActuatorLimits]:
    """Draw one of the fixed vehicles, or a random one now and then."""
    return st.sampled_from(VEHICLES) | st.sampled_from(VEHICLES) | random_limits()


@st.composite
def commands(draw: st.DrawFn, limits: ActuatorLimits) -> Array:
    """Draw a command in the box, often on its edges."""
    low, high = limits.low, limits.high
    values = []
    for bottom, top in zip(low, high, strict=True):
        edges = [value for value in (bottom, 0.0, top) if bottom <= value <= top]
        values.append(draw(st.sampled_from(edges) | st.floats(bottom, top)))
    return np.array(values)


@st.composite
def admissible_commands(draw: st.DrawFn, limits: ActuatorLimits) -> Array:
    """Draw a command that keeps G1 and G3, often on the lateral boundary to the last bit."""
    command = draw(commands(limits))
    bound = limits.max_lateral_acceleration
    if bound is None or limits.is_admissible(command):
        return command
    speed = abs(command[1])
    angle = float(np.arctan(bound * limits.wheelbase / speed**2)) * draw(
        st.sampled_from([1.0, 1.0, 0.9]) | st.floats(0.0, 1.0)
    )
    while not limits.is_admissible([angle, command[1]]):
        angle = np.nextafter(angle, 0.0)
    return np.array([np.copysign(angle, command[0]), command[1]])


@st.composite
def horizons(draw: st.DrawFn, limits: ActuatorLimits, length: int, previous: Array) -> Array:
    """Draw wanted horizons: near, far, on bounds, moving by whole steps of the rates."""
    low, high = limits.low, limits.high
    width = high - low + 1.0
    kind = draw(st.sampled_from(["anywhere", "walk", "steps", "constant"]))
    uniform = st.floats(-1.0, 2.0)
    if kind == "constant":
        row = np.array([draw(uniform), draw(uniform)])
        return np.tile(low + width * row, (length, 1))
    shares = np.array(draw(st.lists(uniform, min_size=2 * length, max_size=2 * length)))
    shares = shares.reshape(length, 2)
    if kind == "anywhere":
        return low + width * shares
    if kind == "walk":
        return previous + np.cumsum((shares - 0.5) * 3.0 * limits.max_increase, axis=0)
    whole = np.round(2.0 * shares - 1.0)
    return previous + np.cumsum(
        np.where(whole > 0, limits.max_increase, limits.max_decrease) * whole, axis=0
    )


@st.composite
def problems(draw: st.DrawFn) -> tuple[ActuatorLimits, Array, Array]:
    """Draw limits, a wanted horizon and an admissible previous command."""
    limits = draw(vehicles())
    previous = draw(admissible_commands(limits))
    return limits, draw(horizons(limits, draw(st.sampled_from(VIEWS)), previous)), previous


@st.composite
def linear_problems(draw: st.DrawFn) -> tuple[ActuatorLimits, Array, Array]:
    """Draw a problem without lateral bound."""
    limits = replace(draw(vehicles()), max_lateral_acceleration=None)
    previous = draw(commands(limits))
    return limits, draw(horizons(limits, draw(st.sampled_from(VIEWS)), previous)), previous


NASTY = st.sampled_from(
    [np.nan, np.inf, -np.inf, 1e300, -1e300, 1.7e308, 5e-324, -5e-324, 1e-310, -0.0, 0.0, 1e9]
) | st.floats(width=64)


@st.composite
def nasty_problems(draw: st.DrawFn) -> tuple[ActuatorLimits, Array, Array]:
    """Draw a problem whose values may be anything that float64 can hold."""
    limits = draw(st.sampled_from(VEHICLES))
    length = draw(st.sampled_from(VIEWS))
    ordinary = draw(horizons(limits, length, draw(commands(limits))))
    for _ in range(draw(st.integers(0, 3))):
        row, column = draw(st.integers(0, length - 1)), draw(st.integers(0, 1))
        ordinary[row, column] = draw(NASTY)
    previous = draw(commands(limits) | st.tuples(NASTY, NASTY).map(np.array))
    return limits, ordinary, previous


def any_shape() -> st.SearchStrategy[Any]:
    """Draw arrays whose shape fits no horizon."""
    shapes = st.sampled_from([(), (2,), (8,), (8, 3), (7, 2), (9, 2), (1, 8, 2), (0, 2), (2, 8)])
    return shapes.map(np.zeros)
