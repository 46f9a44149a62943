"""What a command needs before its imports can succeed: standard library only."""

import os
import signal
import sys
import threading
from importlib.util import find_spec
from pathlib import Path
from types import FrameType, ModuleType

EXTRAS = {  # modules beyond the core that each extra of the distribution brings
    "drive": (
        *("gymnasium", "hydra", "imageio", "jinja2", "joblib", "markupsafe", "matplotlib", "numba"),
        *("omegaconf", "PIL", "pybullet", "pydantic", "rich", "safetensors", "stable_baselines3"),
        *("threadpoolctl", "torch", "yaml"),
    ),
    "report": ("rliable",),
}

_HOME = Path(__file__).resolve().parents[2]  # folder of the three packages


def preflight(*extras: str, command: str | None = None) -> None:
    """End the process with one line and exit code 2 where an import of a command would fail.

    A file of the working folder may hide one of our packages (`python -m` looks there first), or a
    module that one of the `extras` brings is not installed.

    Args:
        *extras: Extras of the distribution that the command needs.
        command: Name of the command's module, whose imports then end at Ctrl-C with one line.
    """
    if command is not None:
        _end_imports_at_interrupt(sys.modules[command])
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


def _end_imports_at_interrupt(module: ModuleType) -> None:
    """Until `module` has its `main`, Ctrl-C is one line and exit code 130; then it raises as ever.

    The process ends in the handler, because libraries catch or replace what their imports raise.
    Nothing is lost: no work has begun. An ignored Ctrl-C stays ignored.
    """

    def interrupted(number: int, frame: FrameType | None) -> None:
        if hasattr(module, "main"):
            signal.default_int_handler(number, frame)
        os.write(2, b"interrupted\n")
        os._exit(130)

    usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if usual and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, interrupted)
