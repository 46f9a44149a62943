"""What a command needs before its imports can succeed: standard library only."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

__all__ = ["EXTRAS", "preflight"]

EXTRAS = {
    "drive": (
        "gymnasium",
        "hydra",
        "imageio",
        "jinja2",
        "joblib",
        "markupsafe",
        "matplotlib",
        "numba",
        "omegaconf",
        "PIL",
        "pybullet",
        "pydantic",
        "rich",
        "safetensors",
        "stable_baselines3",
        "threadpoolctl",
        "torch",
        "yaml",
    ),
    "report": ("rliable",),
}
"""Modules beyond the core that each extra of the distribution brings."""

_HOME = Path(__file__).resolve().parents[2]
"""Folder of the three packages."""


def preflight(*extras: str) -> None:
    """End the process with one line where an import of a command would fail.

    Args:
        extras: The extras whose modules the command imports.

    Raises:
        SystemExit: Code 2, if a file of the working folder hides one of our packages (`python -m`
            looks there first), or if a module is not installed.
    """
    for name in ("expert", "shield"):
        spec = find_spec(name)
        origin = Path((spec and spec.origin) or "?")
        if origin.resolve().parent != _HOME / name:
            _fail(f"{origin} hides the package {name!r} of irl-dal: rename it, or call irl-dal-...")
    for extra in extras:
        for module in EXTRAS[extra]:
            if find_spec(module) is None:
                _fail(f"{module} is not installed: pip install 'irl-dal[{extra}]'")


def _fail(line: str) -> None:
    print(f"error: {line}", file=sys.stderr)
    raise SystemExit(2)
