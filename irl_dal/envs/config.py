"""What the city is like."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from irl_dal.envs.faults import FaultConfig
from irl_dal.envs.reward import RewardConfig
from irl_dal.envs.track import Track, TrackError
from irl_dal.envs.traffic import DENSITY

__all__ = ["CityConfig"]


@dataclass(frozen=True, slots=True)
class CityConfig:
    """What the city is like.

    Attributes:
        difficulty: How much traffic: easy, paper or hard.
        route_length: From start to goal on the average [m]; on a track exactly, a goal every so
            many metres.
        route_spread: How much longer or shorter a generated route may be [m].
        track: TUM centre-line CSV file to drive on; None draws a road from the seed.
        min_radius: Smallest radius of the centre line [m].
        max_radius: Largest radius of an arc [m].
        dynamics: physics (four wheels, tyres that slide) or kinematic (for quick tests).
        min_brightness: Darkest light, 0 is a dark evening.
        max_brightness: Brightest light, 1 is noon.
        initial_speed: Speed at the start [m/s].
        time_limit: After which an episode is truncated [s].
        collision_distance: d_collision [m] (Table II).
        obstacle_sight: Distance at which an obstacle changes the reward's mode [m].
        image_size: Edge length of the camera image [px] (Table II).
        image_noise: Standard deviation of a pixel's brightness [1/255].
        lidar_beams: Number of beams over 180 degrees (Table II).
        lidar_range: [m]
        lidar_noise: Standard deviation of a reading [m].
        lidar_dropout: Probability that a beam returns nothing.
        lane_sensor: camera measures in the image, odometry is the truth with noise.
        lane_offset_noise: Standard deviation of the odometry's lateral offset [m].
        lane_heading_noise: Standard deviation of the odometry's heading error [rad].
        lane_dropout: Probability that the odometry gives nothing in a step.
        reward: Weights of the reward terms.
        faults: What is wrong with sensors and actuators.
    """

    difficulty: Literal["easy", "paper", "hard"] = "paper"
    route_length: float = 500.0
    route_spread: float = 100.0
    track: str | None = None
    min_radius: float = 25.0
    max_radius: float = 200.0
    dynamics: Literal["physics", "kinematic"] = "physics"
    min_brightness: float = 0.0
    max_brightness: float = 1.0
    initial_speed: float = 3.0
    time_limit: float = 120.0
    collision_distance: float = 1.0
    obstacle_sight: float = 25.0
    image_size: int = 64
    image_noise: float = 2.0
    lidar_beams: int = 180
    lidar_range: float = 40.0
    lidar_noise: float = 0.03
    lidar_dropout: float = 0.01
    lane_sensor: Literal["camera", "odometry"] = "camera"
    lane_offset_noise: float = 0.06
    lane_heading_noise: float = 0.01
    lane_dropout: float = 0.02
    reward: RewardConfig = field(default_factory=RewardConfig)
    faults: FaultConfig = field(default_factory=FaultConfig)

    def __post_init__(self) -> None:
        """Refuse what cannot be, naming the field and the value received."""
        self._check_choices()
        self._check_numbers()
        if self.track is not None:
            self._check_track(self.track)

    def _check_choices(self) -> None:
        for name, choices in (
            ("difficulty", sorted(DENSITY)),
            ("dynamics", ["kinematic", "physics"]),
            ("lane_sensor", ["camera", "odometry"]),
        ):
            if getattr(self, name) not in choices:
                raise ValueError(f"`{name}` must be one of {choices}. Got {getattr(self, name)!r}.")

    def _check_track(self, track: str) -> None:
        try:
            Track.read(track).stretch(0, self.route_length)
        except TrackError as error:
            raise ValueError(f"`track` {error}") from None

    def _check_numbers(self) -> None:
        for name in (
            "route_length",
            "min_radius",
            "time_limit",
            "lidar_range",
            "image_size",
            "lidar_beams",
        ):
            if not getattr(self, name) > 0:
                raise ValueError(f"`{name}` must be positive. Got {getattr(self, name)}.")
        for name in ("lidar_dropout", "lane_dropout", "min_brightness", "max_brightness"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"`{name}` must lie in [0, 1]. Got {getattr(self, name)}.")
        for low, high in (("min_radius", "max_radius"), ("min_brightness", "max_brightness")):
            if getattr(self, low) > getattr(self, high):
                raise ValueError(
                    f"`{low}` must not exceed `{high}`. "
                    f"Got {getattr(self, low)} and {getattr(self, high)}."
                )
        if self.route_length < 80.0:
            raise ValueError(f"`route_length` must be at least 80 m. Got {self.route_length}.")
        if not 0.0 <= self.route_spread <= self.route_length - 80.0:
            raise ValueError(
                f"`route_spread` must lie in [0, {self.route_length - 80.0}], so that no route is "
                f"shorter than 80 m. Got {self.route_spread}."
            )
        if self.min_radius < 25.0:
            raise ValueError(f"`min_radius` must be at least 25 m. Got {self.min_radius}.")
