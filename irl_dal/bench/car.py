"""How far the car is from the kinematic bicycle: step responses."""

from collections.abc import Iterator
from contextlib import closing
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from irl_dal.envs.vehicle import WHEELBASE, Vehicle
from irl_dal.envs.world import World
from irl_dal.figures.table import terminal_table

DT = 0.05  # [s] between two samples
SAMPLES = 60  # after the step: 3 s, by when everything is steady
STEERING = ((4.0, 1.0), (8.0, 1.0), (8.0, 2.0), (8.0, 4.0), (8.0, 8.0), (12.0, 4.0), (12.0, 12.0))
"""Speed [m/s] and lateral acceleration of the bicycle [m/s²], up to and beyond the bounds."""

SPEED = ((5.0, 5.3), (5.0, 8.0), (8.0, 7.4), (8.0, 2.0))  # steps of the speed command [m/s]


class Response(NamedTuple):
    """What a step of a command did."""

    rise: float  # time to 63 % of the step [s]
    overshoot: float  # largest value beyond the end, as a share of the step
    gain: float  # final value over the bicycle's
    slip: float  # largest sideways speed at the rear axle [m/s]


def steering_response(speed: float, steering: float) -> Response:
    """Yaw rate after a step of the steering at constant speed [m/s], [rad]."""
    yaw_rate, _, slip = _samples(speed, steering, speed)
    return _response(yaw_rate, 0.0, speed * float(np.tan(steering)) / WHEELBASE, slip)


def speed_response(start: float, stop: float) -> Response:
    """Speed after a step of its command [m/s], straight on."""
    _, speed, slip = _samples(start, 0.0, stop)
    return _response(speed, start, stop, slip)


def car_tables() -> Iterator[Table]:
    """Steering and speed responses, up to and beyond the shield's bounds."""
    form = "{:.2f} {:.0%} {:.3f} {:.2f}"
    headings = ["63 % after [s]", "overshoot", "gain", "slip [m/s]"]
    rows = []
    for v, a in STEERING:
        response = steering_response(v, float(np.arctan(WHEELBASE * a / v**2)))
        rows.append([f"{v:g}", f"{a:g}", *form.format(*response).split()])
    title = "step of the steering: yaw rate against the bicycle's v tan(delta) / L"
    yield terminal_table(title, ["v [m/s]", "lateral [m/s²]", *headings], rows)
    yield terminal_table(
        "step of the speed command",
        ["from [m/s]", "to [m/s]", *headings[:3]],
        [[f"{v:g}", f"{w:g}", *form.format(*speed_response(v, w)).split()[:3]] for v, w in SPEED],
    )


def _samples(start: float, steering: float, speed: float) -> NDArray[np.float64]:
    """Yaw rate, speed and sideways speed (3, T) after a step from straight on at `start`."""
    rows = []
    with closing(World()) as world:
        world.clear()
        car = Vehicle(world)
        car.place(0.0, 0.0, 0.0, start)
        for _ in range(10):  # until the wheels roll
            car.drive(0.0, start)
            world.step(DT)
        for _ in range(SAMPLES):
            car.drive(steering, speed)
            world.step(DT)
            state = car.state()
            rows.append((state.yaw_rate, state.speed, state.lateral_speed))
    return np.array(rows, np.float64).T


def _response(
    values: NDArray[np.float64], start: float, target: float, lateral: NDArray[np.float64]
) -> Response:
    share = (values - start) / (target - start)
    end = float(share[-20:].mean())
    reached = np.flatnonzero(share >= 0.632 * end)
    return Response(
        rise=float(DT * (reached[0] + 1)) if reached.size else float("inf"),
        overshoot=max(0.0, float(share.max()) - end),
        gain=float(values[-20:].mean()) / target,
        slip=float(np.abs(lateral).max()),
    )
