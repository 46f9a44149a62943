"""Hydra's configuration groups: data only. The defaults are the dataclasses'; see irl_dal/config.py."""
