"""Command line of the benches."""

import argparse
import json
import os
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from shield.bench.estimation import tracking_against_raw
from shield.bench.projection import single_against_bare
from shield.limits.actuator_limits import ActuatorLimits


def main(arguments: Sequence[str] | None = None) -> dict[str, float]:
    """Run the benches, print tables and write JSON.

    Args:
        arguments: Command line; None takes it from the process.

    Returns:
        All numbers of the tables.
    """
    parser = argparse.ArgumentParser(prog="python -m shield.bench", description=__doc__)
    parser.add_argument(
        "what", nargs="?", default="projection", choices=["projection", "estimation", "all"]
    )
    parser.add_argument("--out", type=Path, default=Path("runs/shield-bench"), metavar="FOLDER")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="few problems")
    options = parser.parse_args(arguments)
    rng, quick = np.random.default_rng(options.seed), options.quick
    values: dict[str, float] = {}
    if options.what != "estimation":
        values |= single_against_bare(ActuatorLimits(), 8, 50 if quick else 500, rng)
        _print_table("one horizon, H = 8", values)
    if options.what != "projection":
        tracking = tracking_against_raw(rng, drives=5 if quick else 50)
        _print_table("clearance alarms at 3 m, raw against tracked", tracking)
        values |= tracking
    path = options.out / f"{options.what}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps({**_machine(), **values}, indent=2, sort_keys=True)
    path.write_text(text + "\n", encoding="utf-8")
    print(f"written to {path}")
    return values


def _machine() -> dict[str, str | int]:
    """Return what the numbers were measured on."""
    return {
        "python": platform.python_version(),
        "machine": platform.machine(),
        "processors": os.cpu_count() or 0,
        "threads": int(os.environ.get("OMP_NUM_THREADS", "0")),
    }


def _print_table(title: str, values: Mapping[str, float]) -> None:
    """Print names and numbers in two columns."""
    width = max(map(len, values))
    print(title)
    for name, value in values.items():
        print(f"  {name:<{width}}  {value:10.4g}")


if __name__ == "__main__":
    main()
