"""The lane measurement against the truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.table import Table

from irl_dal.bench.drive import Drive

__all__ = ["DAY", "WRONG", "lane_numbers", "lane_table"]

DAY = 0.5
"""Brightness from which it is day."""

WRONG = 0.8
"""Error beyond which a valid estimate is confidently wrong [m]."""

_ROWS = {
    "episodes": ("episodes", "{:.0f}"),
    "rmse_measured_m": ("RMSE measured [m]", "{:.3f}"),
    "rmse_tracked_m": ("RMSE after tracking [m]", "{:.3f}"),
    "measured_share": ("steps with a measurement", "{:.2%}"),
    "valid_share": ("steps with a valid estimate", "{:.2%}"),
    "confidently_wrong_share": ("confidently wrong", "{:.3%}"),
}


def lane_numbers(drives: Sequence[Drive]) -> dict[str, float]:
    """RMSE of the lateral offset, validity, and how often a valid one is off by more than `WRONG`.

    Args:
        drives: At least one.
    """
    offset = np.concatenate([drive.offset for drive in drives])
    measured = np.concatenate([drive.measured for drive in drives]) - offset
    tracked = np.concatenate([drive.tracked for drive in drives]) - offset
    valid = np.concatenate([drive.valid for drive in drives])
    seen = np.isfinite(measured)
    return {
        "episodes": float(len(drives)),
        "rmse_measured_m": float(np.sqrt(np.mean(measured[seen] ** 2))),
        "rmse_tracked_m": float(np.sqrt(np.mean(tracked[valid] ** 2))),
        "measured_share": float(seen.mean()),
        "valid_share": float(valid.mean()),
        "confidently_wrong_share": float((valid & (np.abs(tracked) > WRONG)).mean()),
    }


def lane_table(drives: Sequence[Drive]) -> Table:
    """The numbers by day, in the dark and together."""
    groups = {
        "day": [drive for drive in drives if drive.brightness >= DAY],
        "dark": [drive for drive in drives if drive.brightness < DAY],
        "all": list(drives),
    }
    table = Table(title="lateral offset against the truth")
    table.add_column("")
    columns = {name: lane_numbers(part) for name, part in groups.items() if part}
    for name in columns:
        table.add_column(name, justify="right")
    for key, (title, form) in _ROWS.items():
        table.add_row(title, *(form.format(numbers[key]) for numbers in columns.values()))
    return table
