"""Command line of the benches."""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from shield.bench.estimation import tracking_against_raw
from shield.bench.projection import batch_against_loop, growth, single_against_bare
from shield.bench.report import machine, plot_growth, print_table, write_json
from shield.limits.actuator_limits import ActuatorLimits

HORIZONS = [4, 8, 16, 32, 64]
BATCHES = [1, 4, 16, 64, 256, 1024, 4096]


def main(arguments: Sequence[str] | None = None) -> dict[str, float]:
    """Run the benches, print tables and write JSON and the plot.

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
    parser.add_argument("--quick", action="store_true", help="few problems, no growth curves")
    options = parser.parse_args(arguments)
    rng = np.random.default_rng(options.seed)
    values: dict[str, float] = {}
    if options.what != "estimation":
        values |= _projection(options.out, options.quick, rng)
    if options.what != "projection":
        tracking = tracking_against_raw(rng, drives=5 if options.quick else 50)
        print_table("clearance alarms at 3 m, raw against tracked", tracking)
        values |= tracking
    write_json(options.out / f"{options.what}.json", {**machine(), **values})
    print(f"written to {options.out}")
    return values


def _projection(folder: Path, quick: bool, rng: np.random.Generator) -> dict[str, float]:
    """Measure projections."""
    limits = ActuatorLimits()
    single = single_against_bare(limits, 8, 50 if quick else 500, rng)
    print_table("one horizon, H = 8 (medians side by side)", single)
    batch = batch_against_loop(limits, 8, 64 if quick else 1024, rng)
    print_table(f"a batch of {64 if quick else 1024} horizons, H = 8, against the loop", batch)
    values = single | batch
    if not quick:
        times = growth(limits, HORIZONS, BATCHES, rng)
        for name, points in times.items():
            print_table(f"milliseconds per call, {name}", points)
            values |= {f"growth_{name}_{key}_ms": value for key, value in points.items()}
        plot_growth(folder / "growth.png", times)
    return values


if __name__ == "__main__":
    main()
