"""Each fault does what it says and nothing else, and none makes anything raise."""

from dataclasses import replace

import numpy as np
import pytest

from irl_dal.envs import FAULTS, CityConfig, CityEnv, FaultConfig
from irl_dal.envs.faults import ActuatorLag, SensorFaults
from shield import ScannerGeometry


def observations(config: FaultConfig, steps: int = 60) -> list[dict[str, np.ndarray]]:
    """What comes out when step n goes in: every value of it is n."""
    faults = SensorFaults(config, 0.1, ScannerGeometry(), np.random.default_rng(0))
    return [
        faults.apply(
            {
                "image": np.full((4, 4, 3), n, np.uint8),
                "lidar": np.full(180, n / 2, np.float32),
                "speed": np.array([n], np.float32),
            }
        )
        for n in range(steps)
    ]


def test_no_fault_hands_everything_through() -> None:
    """The default changes nothing."""
    for n, seen in enumerate(observations(FaultConfig())):
        assert (seen["image"] == n).all() and (seen["lidar"] == n / 2).all() and seen["speed"] == n


@pytest.mark.parametrize("latency", [1, 2])
def test_latency_is_the_age_of_an_observation(latency: int) -> None:
    """Every part of it is equally old."""
    for n, seen in enumerate(observations(FaultConfig(latency=latency))):
        old = max(0, n - latency)
        assert (seen["image"] == old).all() and (seen["lidar"] == old / 2).all()
        assert seen["speed"] == old


def test_dead_and_stuck_beams_stay_what_they_are() -> None:
    """The same beams all the time, the stated share of them."""
    scans = np.array([o["lidar"] for o in observations(FaultConfig(dead_beams=0.1))])
    assert ((scans == 40.0).all(axis=0)).sum() == 18
    scans = np.array([o["lidar"] for o in observations(FaultConfig(stuck_beams=0.05))])
    assert (np.ptp(scans, axis=0) == 0.0).sum() == 9


def test_the_camera_freezes_for_the_stated_share() -> None:
    """About a tenth of the images repeat the one before."""
    seen = observations(FaultConfig(frozen_camera=0.1), 250)
    same = [np.array_equal(a["image"], b["image"]) for a, b in zip(seen, seen[1:], strict=False)]
    assert 0.03 < np.mean(same) < 0.25
    assert len({float(o["speed"][0]) for o in seen}) == 250


def test_bursts_are_noise() -> None:
    """Within a burst the ranges scatter by a metre, outside not at all."""
    scans = np.array([o["lidar"] for o in observations(FaultConfig(noise_bursts=0.3), 80)])
    spread = scans.std(axis=1)[20:]
    assert (spread == 0.0).any() and 0.7 < spread.max() < 1.3


def test_actuator_lag_is_first_order() -> None:
    """63 % after one time constant; none hands commands through."""
    start, step = np.array([0.0, 3.0]), np.array([0.2, 4.0])
    lag = ActuatorLag(0.5, 0.1, start)
    for _ in range(5):
        now = lag.follow(step)
    assert now == pytest.approx(start + (1.0 - np.exp(-1.0)) * (step - start))
    assert np.array_equal(ActuatorLag(0.0, 0.1, start).follow(step), step)


def test_a_slow_servo_is_slow() -> None:
    """After 0.2 s it has turned by its rate, a healthy one has arrived."""
    angles = {}
    for name in ("none", "slow_servo"):
        env = CityEnv(CityConfig(lane_sensor="odometry", faults=FAULTS[name]))
        env.camera_on = False
        env.reset(seed=0)
        for _ in range(2):
            env.execute(np.array([0.2, 3.0]))
        car, bullet = env._vehicle, env._world.bullet
        hinges = [bullet.getJointState(car.body, joint)[0] for joint in car._steer]
        angles[name] = np.arctan(np.mean(np.tan(hinges)))
        env.close()
    assert angles["none"] == pytest.approx(0.2, abs=0.03)
    assert angles["slow_servo"] == pytest.approx(0.06, abs=0.02)


@pytest.mark.parametrize("name", sorted(FAULTS))
def test_every_fault_is_survived_and_repeatable(name: str) -> None:
    """A short drive under each fault gives valid observations, twice the same."""
    env = CityEnv(replace(CityConfig(), faults=FAULTS[name]))
    poses = []
    for _ in range(2):
        env.reset(seed=1)
        for k in range(25):
            observation, *_, info = env.step(np.array([0.05 * (-1) ** k, 0.1]))
            assert env.observation_space.contains(observation)
        poses.append((info["pose"], observation["image"]))
    env.close()
    assert np.array_equal(poses[0][0], poses[1][0])
    assert np.array_equal(poses[0][1], poses[1][1])


@pytest.mark.parametrize(
    ("field", "value"),
    [("dead_beams", 1.5), ("latency", 9), ("servo_rate", 0.0), ("actuator_lag", -1.0)],
)
def test_nonsense_is_refused_by_name(field: str, value: float) -> None:
    """The error names the field and shows the value."""
    with pytest.raises(ValueError, match=f"`{field}`.*{value}"):
        FaultConfig(**{field: value})
