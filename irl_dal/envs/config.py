"""What the city is like."""

import os
from dataclasses import dataclass, field
from typing import Literal

from irl_dal.checks import Ranges, check_choices, check_ranges, nested
from irl_dal.envs.faults import FaultConfig
from irl_dal.envs.reward import RewardConfig
from irl_dal.envs.track import Track
from irl_dal.envs.track_file import TrackError
from shield import ScannerGeometry, VehicleGeometry

# [m]: room for one obstacle and the way back; the test for a road that meets itself takes time with
# the square of the length
SHORTEST_ROUTE, LONGEST_ROUTE = 80.0, 10_000.0
# Admissible values, in the fields' units
RANGES: Ranges = {
    "route_length": (SHORTEST_ROUTE, LONGEST_ROUTE),
    "route_spread": (0.0, LONGEST_ROUTE),
    **dict.fromkeys(("min_brightness", "max_brightness", "lidar_dropout"), (0.0, 1.0)),
    **dict.fromkeys(("collision_distance", "lidar_noise", "lane_offset_noise"), (0.0, 100.0)),
    "initial_speed": (0.0, 50.0),  # the observation space ends there
    "time_limit": (1.0, 1e5),
    "image_size": (32, 1024),
    "image_noise": (0.0, 255.0),
    "lidar_beams": (2, 16_384),  # Bullet's largest batch of rays
    "lidar_range": (1.0, 1e3),
}


@dataclass(frozen=True, slots=True)
class CityConfig:
    """What the city is like; `ValueError` names a field out of range."""

    difficulty: Literal["easy", "paper", "hard"] = "paper"  # How much traffic: easy, paper or hard
    route_length: float = 500.0  # From start to goal [m], on the average; on a track exactly
    route_spread: float = 100.0  # How much longer or shorter a generated route may be [m]
    track: str | None = None  # TUM centre-line file to drive on; None draws a road from the seed
    min_brightness: float = 0.0  # Darkest light, 0 is a dark evening
    max_brightness: float = 1.0  # Brightest light, 1 is noon
    initial_speed: float = 3.0  # Speed at the start [m/s]
    time_limit: float = 120.0  # After which an episode is truncated [s]
    collision_distance: float = 1.0  # d_collision [m] (Table II)
    image_size: int = 64  # Edge length of the camera image [px] (Table II)
    image_noise: float = 2.0  # Standard deviation of a pixel's brightness [1/255]
    lidar_beams: int = ScannerGeometry().beams  # Number of beams over 180 degrees (Table II)
    lidar_range: float = ScannerGeometry().max_range  # Also the reading where nothing is hit [m]
    lidar_noise: float = 0.03  # Standard deviation of a reading [m]
    lidar_dropout: float = 0.01  # Probability that a beam returns nothing
    lane_sensor: Literal["camera", "odometry"] = "camera"  # odometry: the truth with noise
    lane_offset_noise: float = 0.06  # Standard deviation of the odometry's lateral offset [m]
    # Outline of the car, or a mapping of it; its wheelbase is a limit's
    vehicle: VehicleGeometry = field(default_factory=VehicleGeometry)
    reward: RewardConfig = field(default_factory=RewardConfig)  # Or a mapping of it
    faults: FaultConfig = field(default_factory=FaultConfig)  # Or a mapping of it

    def __post_init__(self) -> None:
        parts = {"vehicle": VehicleGeometry, "reward": RewardConfig, "faults": FaultConfig}
        for name, kind in parts.items():
            object.__setattr__(self, name, nested(name, kind, getattr(self, name), ValueError))
        check_choices(self)
        check_ranges(self, RANGES)
        longest = self.route_length - SHORTEST_ROUTE
        shortest = f"so that no route is shorter than {SHORTEST_ROUTE:g} m"
        bright, reach = self.max_brightness, self.lidar_range
        for name, holds, rule in (
            ("min_brightness", self.min_brightness <= bright, f"at most max_brightness = {bright}"),
            ("route_spread", self.route_spread <= longest, f"at most {longest}, {shortest}"),
            ("collision_distance", self.collision_distance < reach, f"below lidar_range = {reach}"),
        ):
            if not holds:
                raise ValueError(f"`{name}` must be {rule}. Got {getattr(self, name)}.")
        if self.track is None:
            return
        if not isinstance(self.track, (str, os.PathLike)):
            raise ValueError(f"`track` must be the path of a file. Got {self.track!r}.")
        object.__setattr__(self, "track", os.fspath(self.track))
        try:
            Track.read(self.track).stretch(0, self.route_length)
        except TrackError as error:
            raise ValueError(f"`track` {error}") from None

    @property
    def scanner(self) -> ScannerGeometry:
        """The LiDAR's geometry."""
        mount = self.vehicle.front_bumper
        return ScannerGeometry(beams=self.lidar_beams, max_range=self.lidar_range, mount=mount)
