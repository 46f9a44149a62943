"""What a command needs before its imports can succeed: standard library only."""

import sys
from importlib.util import find_spec
from pathlib import Path

__all__ = ["EXTRAS", "preflight"]

EXTRAS = {  # modules beyond the core that each extra of the distribution brings
    "drive": (
        *("gymnasium", "hydra", "imageio", "jinja2", "joblib", "markupsafe", "matplotlib", "numba"),
        *("omegaconf", "PIL", "pybullet", "pydantic", "rich", "safetensors", "stable_baselines3"),
        *("threadpoolctl", "torch", "yaml"),
    ),
    "report": ("rliable",),
}

_HOME = Path(__file__).resolve().parents[2]  # folder of the three packages


def preflight(*extras: str) -> None:
    """End the process with one line and exit code 2 where an import of a command would fail.

    A file of the working folder may hide one of our packages (`python -m` looks there first), or a
    module that one of the `extras` brings is not installed.
    """
    line = ""
    for name in ("expert", "shield"):
        spec = find_spec(name)
        origin = Path((spec and spec.origin) or "?")
        if origin.resolve().parent != _HOME / name:
            line = f"{origin} hides the package {name!r} of irl-dal: rename it, or call irl-dal-..."
    for extra in extras:
        for module in EXTRAS[extra]:
            if not line and find_spec(module) is None:
                line = f"{module} is not installed: pip install 'irl-dal[{extra}]'"
    if line:
        print(f"error: {line}", file=sys.stderr)
        raise SystemExit(2)
