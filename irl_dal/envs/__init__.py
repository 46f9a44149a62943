"""The city that the car drives in: PyBullet physics, sensors, traffic, light, reward."""

import gymnasium

from irl_dal.envs.chase import Scene
from irl_dal.envs.city import CityEnv
from irl_dal.envs.config import CityConfig
from irl_dal.envs.faults import FAULTS, FaultConfig
from irl_dal.envs.reward import RewardConfig

__all__ = [
    "CITY_ID",
    "FAULTS",
    "CityConfig",
    "CityEnv",
    "FaultConfig",
    "RewardConfig",
    "Scene",
]

CITY_ID = "IRLDAL/City-v0"

if CITY_ID not in gymnasium.registry:
    gymnasium.register(id=CITY_ID, entry_point="irl_dal.envs.city:CityEnv")
