"""Hydra's groups: data only, on top of the dataclasses' defaults (irl_dal/config.py)."""
