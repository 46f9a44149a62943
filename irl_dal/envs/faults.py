"""What can be wrong with sensors and actuators, by configuration."""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irl_dal.arrays import Observation
from irl_dal.checks import Ranges, check_ranges
from irl_dal.envs.vehicle import SERVO_RATE
from shield import ScannerGeometry

FAULT_TIME = 1.0  # Length of one freeze of the camera and of one burst of noise [s]
# Standard deviation in a burst, of a range [m] and of a pixel [1/255]
BURST_RANGE, BURST_PIXEL = 1.0, 10.0
SHORTEST_STUCK = 2.0  # Shortest range at which a beam is stuck [m]
# Admissible values, in the fields' units
RANGES: Ranges = {
    **dict.fromkeys(("dead_beams", "stuck_beams", "frozen_camera", "noise_bursts"), (0.0, 1.0)),
    "latency": (0, 5),
    "actuator_lag": (0.0, 10.0),
    "servo_rate": (0.01, 100.0),
}


@dataclass(frozen=True, slots=True)
class FaultConfig:
    """Strength of each fault; the defaults are no fault at all."""

    dead_beams: float = 0.0  # Share of LiDAR beams that never return anything
    stuck_beams: float = 0.0  # Share of LiDAR beams that always return one and the same range
    frozen_camera: float = 0.0  # Share of the time in which the image stands still
    noise_bursts: float = 0.0  # Share of the time in which image and LiDAR are noisy
    latency: int = 0  # Age of every observation [steps]
    actuator_lag: float = 0.0  # Time constant with which the actuators follow commands [s]
    # Turning rate of the steering servo [rad/s]; 1.2 when healthy, 0.6 is what the shield counts on
    servo_rate: float = SERVO_RATE

    def __post_init__(self) -> None:
        check_ranges(self, RANGES)


# Each fault at its default strength
FAULTS: dict[str, FaultConfig] = {
    "none": FaultConfig(),
    "dead_beams": FaultConfig(dead_beams=0.15),
    "stuck_beams": FaultConfig(stuck_beams=0.05),
    "frozen_camera": FaultConfig(frozen_camera=0.1),
    "noise_bursts": FaultConfig(noise_bursts=0.1),
    "latency_1": FaultConfig(latency=1),
    "latency_2": FaultConfig(latency=2),
    "actuator_lag": FaultConfig(actuator_lag=0.2),
    "slow_servo": FaultConfig(servo_rate=0.3),
}


class SensorFaults:
    """Spoils observations; with the defaults it hands them through untouched.

    Its generator is its own, so that no other noise depends on the faults.
    """

    def __init__(
        self, config: FaultConfig, dt: float, scanner: ScannerGeometry, rng: np.random.Generator
    ) -> None:
        self._config, self._dt, self._rng = config, dt, rng
        self._max_range, beams = scanner.max_range, scanner.beams
        order = rng.permutation(beams)
        dead, stuck = round(config.dead_beams * beams), round(config.stuck_beams * beams)
        self._dead, self._stuck = order[:dead], order[dead : dead + stuck]
        low = min(SHORTEST_STUCK, self._max_range)
        self._stuck_at = rng.uniform(low, self._max_range, len(self._stuck)).astype(np.float32)
        self._queue: deque[Observation] = deque(maxlen=config.latency + 1)
        self._frozen_for = self._burst_for = 0
        self._image: NDArray[np.uint8] | None = None

    @property
    def frozen(self) -> bool:
        """Whether the camera stands still now."""
        return self._frozen_for > 0

    @property
    def bursting(self) -> bool:
        """Whether image and LiDAR are noisy now."""
        return self._burst_for > 0

    def apply(self, observation: Observation) -> Observation:
        """The observation as the faulty sensors give it."""
        config = self._config
        self._frozen_for = self._next(self._frozen_for, config.frozen_camera)
        self._burst_for = self._next(self._burst_for, config.noise_bursts)
        image, lidar = observation["image"], observation["lidar"]
        if self._burst_for:
            grain = self._rng.normal(0.0, BURST_PIXEL, image.shape)
            image = np.clip(image + grain, 0.0, 255.0).astype(np.uint8)
            blur = self._rng.normal(0.0, BURST_RANGE, lidar.shape)
            lidar = np.clip(lidar + blur, 0.0, self._max_range).astype(np.float32)
        if len(self._dead) or len(self._stuck):
            lidar = lidar.copy()
            lidar[self._dead] = self._max_range
            lidar[self._stuck] = self._stuck_at
        if self._frozen_for and self._image is not None:
            image = self._image
        self._image = image
        self._queue.append({**observation, "image": image, "lidar": lidar})
        return self._queue[0]

    def _next(self, left: int, share: float) -> int:
        """Steps that an intermittent fault still lasts."""
        if share == 0.0:
            return 0
        if left > 1:
            return left - 1
        steps = max(1, round(FAULT_TIME / self._dt))
        begins = share >= 1.0 or self._rng.random() < share / (steps * (1.0 - share))
        return steps if begins else 0


class ActuatorLag:
    """First-order lag of commands with a time constant [s], 0 for none, from a first command on."""

    def __init__(self, time: float, dt: float, command: NDArray[np.float64]) -> None:
        self._share = 1.0 if time <= 0.0 else 1.0 - float(np.exp(-dt / time))
        self._now = np.array(command, dtype=np.float64)

    def follow(self, command: NDArray[np.float64]) -> NDArray[np.float64]:
        """What the actuators are told for a command (2,) [rad, m/s]."""
        if self._share == 1.0:
            return command
        self._now = self._now + self._share * (command - self._now)
        return self._now
