"""Sensors of the ego car: LiDAR, camera and the lane sensor, each with its own noise."""

import numpy as np
from numpy.typing import NDArray

from irl_dal.arrays import Array
from irl_dal.envs.lighting import Illumination
from irl_dal.envs.road import HOME_LANE, Road, RoadPoint
from irl_dal.envs.vehicle import VehicleState
from irl_dal.envs.world import CameraPose, World
from shield import LaneMeasurement, ScannerGeometry


class Lidar:
    """Flat scanner; `noise` is a reading's deviation [m], `dropout` the share of lost readings."""

    HEIGHT = 0.6  # Above the ground [m]: over the kerbs, under the bonnet's edge
    GAP = 0.01  # From the mount to where the rays begin [m], outside the car's own body

    def __init__(
        self, world: World, geometry: ScannerGeometry, noise: float, dropout: float
    ) -> None:
        self._world, self._noise, self._dropout = world, noise, dropout
        self._mount, self.max_range = geometry.mount, geometry.max_range
        self.angles: Array = geometry.angles

    def scan(self, state: VehicleState) -> Array:
        """Noise-free ranges (beams,) [m]."""
        ahead = np.array([np.cos(state.yaw), np.sin(state.yaw)])
        origin = np.array([state.x, state.y]) + (self._mount + self.GAP) * ahead
        bearing = state.yaw + self.angles
        flat = origin + self.max_range * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
        ends = np.insert(flat, 2, self.HEIGHT, axis=1)
        return self.max_range * self._world.rays(np.append(origin, self.HEIGHT), ends)

    def measure(self, scan: Array, rng: np.random.Generator) -> NDArray[np.float32]:
        """Readings (beams,) float32 [m] of a noise-free `scan`."""
        noisy = scan + rng.normal(0.0, self._noise, scan.shape) * (scan < self.max_range)
        noisy[rng.random(scan.shape) < self._dropout] = self.max_range
        return np.clip(noisy, 0.0, self.max_range).astype(np.float32)


class Camera:
    """Square colour camera of `size` [px] above the front bumper; pixels have `noise` [1/255]."""

    FORWARD, HEIGHT = 3.3, 1.6  # Mounting point from the rear axle and above the ground [m]
    # [deg]; from the middle of the home lane the yellow line enters the picture 9.6 m ahead
    FIELD_OF_VIEW = 80.0
    PITCH = 0.19  # Of the axis below the horizon [rad]

    def __init__(self, world: World, size: int, noise: float) -> None:
        self._world, self._size, self._noise = world, size, noise

    def measure(
        self, state: VehicleState, light: Illumination, rng: np.random.Generator
    ) -> NDArray[np.uint8]:
        """Image (size, size, 3) uint8."""
        ahead = np.array([np.cos(state.yaw), np.sin(state.yaw)])
        eye = np.array([state.x, state.y]) + self.FORWARD * ahead
        aim = eye + ahead
        target = (*aim.tolist(), self.HEIGHT - float(np.tan(self.PITCH)))
        sight = (self.FIELD_OF_VIEW, self._size, self._size)
        pose = CameraPose((*eye.tolist(), self.HEIGHT), target, *sight)
        image = self._world.render(pose, light)
        grain = rng.standard_normal(image.shape[:2], dtype=np.float32) * np.float32(self._noise)
        noisy = image + grain[..., None]
        return np.clip(noisy, 0.0, 255.0, out=noisy).astype(np.uint8)


class LaneSensor:
    """Lane pose and shape as a lane camera reports them: odometry with noise.

    The shape is the clothoid `curvature + curvature_rate · s` that fits the next 25 m best;
    `offset_noise` is the deviation of the lateral offset [m].
    """

    PREVIEW = 25.0  # [m]
    # Standard deviations of the heading error [rad] and of the curvature [1/m]
    HEADING_NOISE, CURVATURE_NOISE = 0.01, 1e-3
    DROPOUT = 0.02  # Probability that a measurement is missing

    def __init__(self, road: Road, offset_noise: float) -> None:
        self._road = road
        self._offset_noise = offset_noise
        self._ahead = np.arange(0.0, self.PREVIEW + 0.5, 1.0)
        self._fit = np.linalg.pinv(np.stack([self._ahead, 0.5 * self._ahead**2], axis=1))

    def measure(
        self, state: VehicleState, at: RoadPoint, rng: np.random.Generator
    ) -> LaneMeasurement | None:
        """Lane pose relative to the home lane's centre; None where the sensor misses it."""
        noise = rng.normal(size=3)
        if rng.random() < self.DROPOUT:
            return None
        stretch = 1.0 - HOME_LANE * at.curvature
        heading = np.interp(at.s + self._ahead / stretch, self._road.s, self._road.heading)
        curvature, rate = self._fit @ (heading - at.heading)
        return LaneMeasurement(
            lateral_offset=at.d - HOME_LANE + self._offset_noise * noise[0],
            heading_error=wrap(state.yaw - at.heading) + self.HEADING_NOISE * noise[1],
            curvature=float(curvature) + self.CURVATURE_NOISE * noise[2],
            curvature_rate=float(rate),
        )


def wrap(angle: float) -> float:
    """The same angle in [-pi, pi) [rad]."""
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)
