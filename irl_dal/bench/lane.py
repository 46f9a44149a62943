"""The lane measurement against the truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.table import Table

from irl_dal.bench.drive import Drive
from irl_dal.figures.table import terminal_table

DAY = 0.5  # brightness from which it is day
WRONG = 0.8  # [m] error beyond which a valid estimate is confidently wrong

_FORMATS = {
    "episodes": "{:.0f}",
    "RMSE measured [m]": "{:.3f}",
    "RMSE after tracking [m]": "{:.3f}",
    "steps with a measurement": "{:.2%}",
    "steps with a valid estimate": "{:.2%}",
    "confidently wrong": "{:.3%}",
}


def lane_numbers(drives: Sequence[Drive]) -> dict[str, float]:
    """RMSE of the lateral offset, validity, and how often a valid one errs by more than `WRONG`."""
    offset = np.concatenate([drive.offset for drive in drives])
    measured = np.concatenate([drive.measured for drive in drives]) - offset
    tracked = np.concatenate([drive.tracked for drive in drives]) - offset
    valid = np.concatenate([drive.valid for drive in drives])
    seen = np.isfinite(measured)
    wrong = valid & (np.abs(tracked) > WRONG)
    rmse = (float(np.sqrt(np.mean(error**2))) for error in (measured[seen], tracked[valid]))
    shares = (float(share.mean()) for share in (seen, valid, wrong))
    return dict(zip(_FORMATS, (float(len(drives)), *rmse, *shares), strict=True))


def lane_table(drives: Sequence[Drive]) -> Table:
    """The numbers by day, in the dark and together."""
    groups = {
        "day": [drive for drive in drives if drive.brightness >= DAY],
        "dark": [drive for drive in drives if drive.brightness < DAY],
        "all": list(drives),
    }
    columns = {name: lane_numbers(group) for name, group in groups.items() if group}
    rows = [
        [title, *(form.format(numbers[title]) for numbers in columns.values())]
        for title, form in _FORMATS.items()
    ]
    return terminal_table("lateral offset against the truth", ["", *columns], rows)
