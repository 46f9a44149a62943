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
    "SHIELDED_CITY_ID",
    "Scene",
]

CITY_ID, SHIELDED_CITY_ID = "IRLDAL/City-v0", "IRLDAL/ShieldedCity-v0"

if CITY_ID not in gymnasium.registry:
    gymnasium.register(id=CITY_ID, entry_point="irl_dal.envs.city:CityEnv")
    gymnasium.register(id=SHIELDED_CITY_ID, entry_point="irl_dal.build:shielded_city")
