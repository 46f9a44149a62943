"""Command line of the benches."""

import argparse
import json
import os
import platform
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from shield.bench.estimation import tracking_against_raw
from shield.bench.predictive import predictive_times
from shield.bench.projection import single_against_bare
from shield.limits.actuator_limits import ActuatorLimits


def main(arguments: Sequence[str] | None = None) -> dict[str, float]:
    """Run the benches, print tables and write JSON; return all numbers of the tables.

    Args:
        arguments: Command line; None takes it from the process.
    """
    parser = argparse.ArgumentParser(prog="python -m shield.bench", description=__doc__)
    benches = ["projection", "estimation", "predictive", "all"]
    parser.add_argument("what", nargs="?", default="projection", choices=benches)
    parser.add_argument("--out", type=Path, default=Path("runs/shield-bench"), metavar="FOLDER")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="few problems")
    options = parser.parse_args(arguments)
    rng, quick = np.random.default_rng(options.seed), options.quick
    tables: dict[str, dict[str, float]] = {}
    if options.what in ("projection", "all"):
        numbers = single_against_bare(ActuatorLimits(), 8, 50 if quick else 500, rng)
        tables["one horizon, H = 8"] = numbers
    if options.what in ("estimation", "all"):
        numbers = tracking_against_raw(rng, drives=5 if quick else 50)
        tables["clearance alarms at 3 m, raw against tracked"] = numbers
    if options.what in ("predictive", "all"):
        numbers = predictive_times(rng, streets=1 if quick else 6)
        tables["one step of the predictive filter"] = numbers
    values: dict[str, float] = {}
    for title, numbers in tables.items():
        print(title)
        for name, value in numbers.items():
            print(f"  {name:<{max(map(len, numbers))}}  {value:10.4g}")
        values |= numbers
    machine = {
        "python": platform.python_version(),
        "machine": platform.machine(),
        "processors": os.cpu_count() or 0,
        "threads": int(os.environ.get("OMP_NUM_THREADS", "0")),
    }
    path = options.out / f"{options.what}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps({**machine, **values}, indent=2, sort_keys=True)
    path.write_text(text + "\n", encoding="utf-8")
    print(f"written to {path}")
    return values


if __name__ == "__main__":
    main()
