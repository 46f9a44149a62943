"""How far the car is from the kinematic bicycle: step responses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from irl_dal.envs.vehicle import WHEELBASE, Vehicle
from irl_dal.envs.world import World

__all__ = ["Response", "car_tables", "speed_response", "steering_response"]

Array = NDArray[np.float64]

DT = 0.05
"""Between two samples [s]."""


@dataclass(frozen=True, slots=True)
class Response:
    """What a step of a command did.

    Attributes:
        rise: Time to 63 % of the step [s].
        overshoot: Largest value beyond the end, as a share of the step.
        gain: Final value over what the bicycle would have.
        slip: Largest sideways speed at the rear axle [m/s].
    """

    rise: float
    overshoot: float
    gain: float
    slip: float


def steering_response(speed: float, steering: float) -> Response:
    """Yaw rate after a step of the steering at constant speed [m/s], [rad]."""
    rates, slips = [], []
    world = World()
    try:
        car = _car(world, speed)
        for _ in range(60):
            car.drive(steering, speed)
            world.step(DT)
            rates.append(car.state().yaw_rate)
            slips.append(abs(car.state().lateral_speed))
    finally:
        world.close()
    wanted = speed * float(np.tan(steering)) / WHEELBASE
    return _response(np.array(rates), 0.0, wanted, max(slips))


def speed_response(start: float, stop: float) -> Response:
    """Speed after a step of its command [m/s], straight on."""
    speeds = []
    world = World()
    try:
        car = _car(world, start)
        for _ in range(60):
            car.drive(0.0, stop)
            world.step(DT)
            speeds.append(car.state().speed)
    finally:
        world.close()
    return _response(np.array(speeds), start, stop, 0.0)


def car_tables() -> tuple[Table, Table]:
    """Steering and speed responses, up to and beyond the shield's bounds."""
    steering = Table(title="step of the steering: yaw rate against the bicycle's v tan(delta) / L")
    for title in (
        "v [m/s]",
        "lateral [m/s^2]",
        "63 % after [s]",
        "overshoot",
        "gain",
        "slip [m/s]",
    ):
        steering.add_column(title, justify="right")
    for speed, lateral in ((4.0, 1.0), (8.0, 1.0), (8.0, 2.0), (8.0, 4.0), (8.0, 8.0), (12.0, 4.0)):
        angle = float(np.arctan(WHEELBASE * lateral / speed**2))
        steering.add_row(f"{speed:g}", f"{lateral:g}", *_cells(steering_response(speed, angle)))
    angle = float(np.arctan(WHEELBASE * 12.0 / 12.0**2))
    steering.add_row("12", "12", *_cells(steering_response(12.0, angle)))
    speed_table = Table(title="step of the speed command")
    for title in ("from [m/s]", "to [m/s]", "63 % after [s]", "overshoot", "gain"):
        speed_table.add_column(title, justify="right")
    for start, stop in ((5.0, 5.3), (5.0, 8.0), (8.0, 7.4), (8.0, 2.0)):
        cells = _cells(speed_response(start, stop))[:3]
        speed_table.add_row(f"{start:g}", f"{stop:g}", *cells)
    return steering, speed_table


def _car(world: World, speed: float) -> Vehicle:
    world.clear()
    car = Vehicle(world)
    car.place(0.0, 0.0, 0.0, speed)
    for _ in range(10):
        car.drive(0.0, speed)
        world.step(DT)
    return car


def _response(values: Array, start: float, wanted: float, slip: float) -> Response:
    share = (values - start) / (wanted - start)
    end = float(share[-20:].mean())
    reached = np.flatnonzero(share >= 0.632 * end)
    rise = float(DT * (reached[0] + 1)) if reached.size else float("inf")
    final = float(values[-20:].mean())
    return Response(rise, max(0.0, float(share.max()) - end), final / wanted, slip)


def _cells(response: Response) -> tuple[str, str, str, str]:
    return (
        f"{response.rise:.2f}",
        f"{response.overshoot:.0%}",
        f"{response.gain:.3f}",
        f"{response.slip:.2f}",
    )
