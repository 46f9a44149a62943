"""Printing and writing what was measured."""

import json
import os
import platform
from collections.abc import Mapping
from pathlib import Path

from shield.errors import MissingDependency

__all__ = ["machine", "plot_growth", "print_table", "write_json"]


def machine() -> dict[str, str | int]:
    """Return what the numbers were measured on."""
    return {
        "python": platform.python_version(),
        "machine": platform.machine(),
        "processors": os.cpu_count() or 0,
        "threads": int(os.environ.get("OMP_NUM_THREADS", "0")),
    }


def print_table(title: str, values: Mapping[str, float]) -> None:
    """Print names and numbers in two columns."""
    width = max(len(name) for name in values)
    print(title)
    for name, value in values.items():
        print(f"  {name:<{width}}  {value:10.4g}")


def write_json(path: Path, values: Mapping[str, object]) -> None:
    """Write flat JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(values, indent=2, sort_keys=True) + "\n", encoding="utf-8")


def plot_growth(path: Path, times: Mapping[str, Mapping[str, float]]) -> None:
    """Plot milliseconds over horizon length and over batch size.

    Raises:
        MissingDependency: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingDependency("the plot needs matplotlib: pip install matplotlib") from error
    figure = Figure(figsize=(8.0, 3.2), layout="constrained")
    axes = figure.subplots(1, 2)
    labels = {"single": "horizon H", "batch": "batch B (H = 8)"}
    for axis, (name, label) in zip(axes, labels.items(), strict=True):
        points = sorted((int(key), value) for key, value in times[name].items())
        axis.loglog([x for x, _ in points], [y for _, y in points], "o-")
        axis.set_xticks([x for x, _ in points], [str(x) for x, _ in points])
        axis.minorticks_off()
        axis.set_xlabel(label)
        axis.set_ylabel("time of one call [ms]")
        axis.grid(True, which="both", alpha=0.3)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
