"""The city: a gymnasium environment on PyBullet."""

import copy
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from irl_dal.arrays import Array, Info, Observation
from irl_dal.checks import nested
from irl_dal.envs.attribution import Attribution, Event, departs
from irl_dal.envs.chase import Scene, chase_view
from irl_dal.envs.config import CityConfig
from irl_dal.envs.faults import ActuatorLag, SensorFaults
from irl_dal.envs.lane_camera import LaneCamera
from irl_dal.envs.lighting import Illumination, draw_light
from irl_dal.envs.reward import Situation, driving_mode, reward_terms
from irl_dal.envs.road import HALF_WIDTH, HOME_LANE, LANE_WIDTH, Road, RoadPoint
from irl_dal.envs.scenery import Scenery
from irl_dal.envs.sensors import Camera, LaneSensor, Lidar, wrap
from irl_dal.envs.track import Track
from irl_dal.envs.traffic import DENSITY, Traffic
from irl_dal.envs.vehicle import Vehicle
from irl_dal.envs.world import World
from shield import ActuatorLimits, LaneMeasurement
from shield.vehicle import yaw_rate_between


@dataclass(frozen=True, slots=True)
class _Episode:
    """All that an episode follows from."""

    rng: np.random.Generator  # The environment's generator before the episode
    options: dict[str, Any]  # Of `reset`
    camera_on: bool  # Whether the camera was on at `reset`
    steps: list[tuple[Array, bool]]  # Command (2,) of each step, and whether the camera was on


# Attributes that a copy takes over; all others follow from the episode
_KEPT = ("spec", "camera_on", "overlay", "action_space", "observation_space", "np_random")


class CityEnv(gymnasium.Env[Observation, NDArray[Any]]):
    """Drive to the goal: keep the lane, overtake what stands or crawls in it, touch nothing.

    A curved road with two lanes each way, another one for every seed, or a real one from a file, in
    any light from bright day to dark evening; standing cars and barrels, slow cars, oncoming cars,
    pedestrians. A step lasts `limits.dt`, 0.1 s by default. See `docs/city.md`.

    Actions, `Box(-1, 1, (2,), float32)`:

    | index | meaning | -1 | +1 |
    |---|---|---|---|
    | 0 | steering angle [rad], positive left | `-max_steering` | `max_steering` |
    | 1 | target speed [m/s] | `min_speed` | `max_speed` |

    Observations, `Dict`:

    | key | shape, type | meaning | unit |
    |---|---|---|---|
    | image | (64, 64, 3) uint8 | front camera, RGB | |
    | lidar | (180,) float32 | ranges, beam 0 at the right, counter-clockwise | m |
    | speed | (1,) float32 | forward speed | m/s |

    Reward: sum of the terms in `info["reward_terms"]`, about 1 for a calm step, -20 for a
    collision or for leaving the road, +20 for the goal.

    Episode end: `terminated` on goal, collision (bodies touch in the physics engine, or the
    clearance is below `collision_distance`) and off road (the rear axle's middle beyond the edge
    line); `truncated` at the time limit.

    Info: `reward_terms`, `success`, `collision`, `off_road`, `progress` [m], `goal_distance` [m],
    `clearance` [m], `lateral_offset` [m], `heading_error` [rad], `pose` (x, y, yaw), `speed` [m/s],
    `lateral_acceleration` [m/s^2]: the true state, for rewards and metrics; `lane_measurement`:
    what the lane sensor saw (None where it saw nothing); `contact` (bodies touch), `departure` (a
    corner of the body is beyond the edges of the ego's two lanes) and, on the step on which one of
    them begins, `fault`: "at_fault", "at_rest", "hit_by_other" or "assumption:<name>", else None.

    Copies and pickles go on as the original would: they drive the episode so far again, which takes
    as long as its steps took, some 2 ms each.

    Args:
        config: What the city is like, or a mapping of `CityConfig`'s fields.
        limits: Actuator limits that the normalised action refers to, or a mapping of their fields.
        render_mode: None or "rgb_array" (a chase view).
        **fields: Fields of `CityConfig` that differ from `config`, such as `difficulty="hard"`.

    Raises:
        ValueError: A field is out of range, or the render mode unknown.
        TypeError: There is no such field, or an argument has another type.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(
        self,
        config: CityConfig | Mapping[str, Any] | None = None,
        limits: ActuatorLimits | Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        **fields: Any,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"`render_mode` must be None or 'rgb_array'. Got {render_mode!r}.")
        config = {} if config is None else config
        limits = {} if limits is None else limits
        self.config: CityConfig = replace(nested("config", CityConfig, config, TypeError), **fields)
        self.limits: ActuatorLimits = nested("limits", ActuatorLimits, limits, TypeError)
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": max(1, round(1.0 / self.limits.dt))}
        self._episode: _Episode | None = None
        size, scanner = self.config.image_size, self.config.scanner
        self.observation_space = spaces.Dict(  # type: ignore[assignment]
            {
                "image": spaces.Box(0, 255, (size, size, 3), np.uint8),
                "lidar": spaces.Box(0.0, scanner.max_range, (scanner.beams,), np.float32),
                "speed": spaces.Box(-50.0, 50.0, (1,), np.float32),
            }
        )
        self.action_space: spaces.Box = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.camera_on = True
        self._world = World()
        noise, dropout = self.config.lidar_noise, self.config.lidar_dropout
        self._lidar = Lidar(self._world, scanner, noise, dropout)
        self._camera = Camera(self._world, size, self.config.image_noise)
        self._lane_camera = LaneCamera(size, self.limits.dt)
        self._track = None if self.config.track is None else Track.read(self.config.track)
        self.overlay = False, ""  # The trigger's verdict and a line of text, for the view

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Info]:
        """Draw a new road, traffic and light and put the car at the start of its lane.

        Args:
            seed: Same seed, same episode.
            options: `{"stretch": n}` chooses the n-th stretch of a track; the seed does otherwise.
        """
        super().reset(seed=seed)
        options = options or {}
        self._episode = _Episode(copy.deepcopy(self.np_random), dict(options), self.camera_on, [])
        config = self.config
        layout, self._noise, self._grain, faults = self.np_random.spawn(4)
        self._world.clear()
        self._road = self._draw_road(layout, options)
        self._scenery = Scenery(self._world, self._road, layout)
        density = DENSITY[config.difficulty]
        self._traffic = Traffic(self._world, self._road, density, layout, config.vehicle)
        self._light: Illumination = draw_light(layout, config.min_brightness, config.max_brightness)
        self._lane_sensor = LaneSensor(self._road, config.lane_offset_noise)
        self._lane_camera.reset()
        servo = config.faults.servo_rate
        self._vehicle = Vehicle(self._world, self.limits.wheelbase, servo, config.vehicle)
        x, y, yaw = self._road.pose(0.0, HOME_LANE)
        self._vehicle.place(x, y, yaw, config.initial_speed)
        self._time = 0.0
        self._command: Array = np.array([0.0, config.initial_speed])
        self._before = self._command
        self._lag = ActuatorLag(config.faults.actuator_lag, self.limits.dt, self._command)
        scanner = config.scanner
        self._faults = SensorFaults(config.faults, self.limits.dt, scanner, faults)
        self._lanes: deque[LaneMeasurement | None] = deque(maxlen=config.faults.latency + 1)
        self._at: RoadPoint = self._road.locate(x, y)
        self.overlay = False, ""
        self._sense()
        obstacles = self._traffic.obstacles
        self._judge = Attribution(config, self.limits, self._road, obstacles, self._faults)
        observation = self._observe()
        info = self._info({}, success=False, collision=False, off_road=False)
        return observation, {**info, "contact": False, "departure": False, "fault": None}

    def _draw_road(self, rng: np.random.Generator, options: dict[str, Any]) -> Road:
        """A road from the generator, or a stretch of the track."""
        config = self.config
        if self._track is not None:
            drawn = int(rng.integers(self._track.stretches(config.route_length)))
            return self._track.stretch(int(options.get("stretch", drawn)), config.route_length)
        length = config.route_length + float(rng.uniform(-1.0, 1.0)) * config.route_spread
        return Road.generate(rng, length)

    def step(self, action: NDArray[Any]) -> tuple[Observation, float, bool, bool, Info]:
        """Drive for one control period with a normalised action (2,)."""
        bounded = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0)
        return self.execute(self.limits.to_command(bounded))

    def execute(self, command: Array) -> tuple[Observation, float, bool, bool, Info]:
        """Drive for one control period with a command [rad, m/s] as the actuators get it."""
        if self._episode is None:
            raise gymnasium.error.ResetNeeded("Call `reset` before `step` or `execute`.")
        dt = self.limits.dt
        self._before = self._command
        self._command = np.array(command, dtype=np.float64)
        self._episode.steps.append((self._command, self.camera_on))
        self._traffic.step(dt, self._at, self._state.speed)
        steering, speed = self._lag.follow(self._command)
        self._vehicle.drive(float(steering), float(speed))
        self._world.step(dt)
        self._time += dt
        start = self._state
        self._sense()
        touched = frozenset(self._vehicle.touched())
        departed = departs(self._road, self._state, self._at, self.config.vehicle)
        near = self._clearance < self.config.collision_distance
        ends = {
            "success": False,
            "collision": bool(touched) or near,
            "off_road": not -HALF_WIDTH <= self._at.d <= self._at.left_edge,
        }
        ends["success"] = self._at.s >= self._road.length and not any(ends.values())
        terms = self._reward_terms(float(self._command[0] - self._before[0]) / dt, **ends)
        terminated = any(ends.values())
        truncated = not terminated and self._time >= self.config.time_limit - 0.5 * dt
        observation = self._observe()
        verdict = self._judge.judge(Event(start, float(speed), touched, departed))
        info = {**self._info(terms, **ends), **verdict}
        return observation, float(sum(terms.values())), terminated, truncated, info

    def render(self) -> NDArray[np.uint8] | None:
        """The chase view (360, 640, 3) uint8, or None without a render mode."""
        if self.render_mode is None:
            return None
        return chase_view(self._world, self.scene(), self._light, self.overlay)

    @property
    def brightness(self) -> float:
        """Of the episode's light, 0 a dark evening, 1 noon."""
        return self._light.brightness

    def close(self) -> None:
        """Leave the physics engine."""
        self._world.close()

    def scene(self) -> Scene:
        """What a view of this moment draws."""
        obstacles, geometry = tuple(self._traffic.obstacles), self.config.vehicle
        return Scene(self._road, obstacles, self._state, self._scan, self._lidar.angles, geometry)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy and pickle what makes the episode; the copy drives it again."""
        if not self._world.is_open:
            raise TypeError("A closed CityEnv can be neither copied nor pickled.")
        kept = {name: getattr(self, name) for name in _KEPT}
        arguments = (self.config, self.limits, self.render_mode)
        return type(self), arguments, copy.deepcopy((self._episode, kept))

    def __setstate__(self, state: tuple[_Episode | None, dict[str, Any]]) -> None:
        """Drive the copied episode again."""
        episode, kept = state
        if episode is not None:
            self.np_random = episode.rng
            self.camera_on = episode.camera_on
            self.reset(options=episode.options)
            for command, camera_on in episode.steps:
                self.camera_on = camera_on
                self.execute(command)
        for name, value in kept.items():
            setattr(self, name, value)

    def _sense(self) -> None:
        """Read the true state, where it lies on the road and the noise-free scan."""
        self._state = self._vehicle.state()
        self._at = self._road.locate(self._state.x, self._state.y, self._at.index)
        self._scan = self._lidar.scan(self._state)
        self._clearance = float(self._scan.min())

    def _observe(self) -> Observation:
        """Measure with every sensor; the camera has a random stream of its own, on or off.

        The lane camera needs every image: with it, `camera_on` cannot switch the camera off.
        """
        config, rng = self.config, self._noise
        image = np.zeros((config.image_size,) * 2 + (3,), np.uint8)
        self._scenery.show_around(self._at.s)
        if self.camera_on or config.lane_sensor == "camera":
            image = self._camera.measure(self._state, self._light, self._grain)
        observation = self._faults.apply(
            {
                "image": image,
                "lidar": self._lidar.measure(self._scan, rng),
                "speed": np.array([self._state.speed], dtype=np.float32),
            }
        )
        if config.lane_sensor == "camera":
            speed = float(observation["speed"][0])
            ends, wheelbase = (self._before[0], self._command[0]), self.limits.wheelbase
            yaw_rate = yaw_rate_between(*ends, speed, wheelbase)
            self._lane = self._lane_camera.measure(observation["image"], speed, yaw_rate)
        else:
            self._lanes.append(self._lane_sensor.measure(self._state, self._at, rng))
            self._lane = self._lanes[0]
        return observation

    def _reward_terms(self, steering_rate: float, **ends: bool) -> dict[str, float]:
        offset = self._at.d - HOME_LANE
        return reward_terms(
            self.config.reward,
            Situation(
                mode=driving_mode(offset, self._home_gap()),
                lateral_offset=offset,
                speed=self._state.speed * float(np.cos(self._state.yaw - self._at.heading)),
                clearance=self._clearance,
                steering_rate=steering_rate,
                **ends,
            ),
        )

    def _home_gap(self) -> float:
        """Free distance in the home lane, ahead of the bumper or beside the car [m]."""
        gaps = [
            max(0.0, o.s - 0.5 * o.size[0] - self._at.s - self.config.vehicle.front_bumper)
            for o in self._traffic.obstacles
            if abs(o.d - HOME_LANE) < 0.5 * LANE_WIDTH and o.s + 0.5 * o.size[0] > self._at.s
        ]
        return min(gaps, default=np.inf)

    def _info(self, terms: dict[str, float], **ends: bool) -> Info:
        state = self._state
        return {
            "reward_terms": terms,
            **ends,
            "progress": self._at.s,
            "goal_distance": max(0.0, self._road.length - self._at.s),
            "clearance": self._clearance,
            "lateral_offset": self._at.d - HOME_LANE,
            "heading_error": wrap(state.yaw - self._at.heading),
            "pose": np.array([state.x, state.y, state.yaw]),
            "speed": state.speed,
            "lateral_acceleration": state.speed * state.yaw_rate,
            "lane_measurement": self._lane,
        }
