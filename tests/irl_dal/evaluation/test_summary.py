import io
import json
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from irl_dal.evaluation.measurements import Measurements
from irl_dal.evaluation.metrics import compute_metrics
from irl_dal.evaluation.summary import evaluation_table, write_json
from shield import ActuatorLimits
from tests.irl_dal.evaluation.small import written_episode


def printed(width: int) -> list[str]:
    """The table of two episodes, one successful."""
    episodes = [written_episode(), written_episode(success=False, off_road=True)]
    report = compute_metrics(Measurements(episodes), ActuatorLimits(), np.random.default_rng(0))
    report |= {"latency_threads": 1, "latency_processes": 2}
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(evaluation_table(report, "title"))
    return console.export_text().splitlines()


def test_shares_are_printed_in_percent() -> None:
    """Fractions in the report, percent in the table, a dash for what was not measured."""
    lines = printed(80)
    (success,) = (line for line in lines if line.strip().startswith("success"))
    assert "50.0" in success and "%" in success and "0.0 … 100.0" in success
    (ade,) = (line for line in lines if line.strip().startswith("ADE"))
    assert "–" in ade


def test_the_table_fits_a_terminal() -> None:
    """Nothing is cut off at 80 columns."""
    assert not any("…" in line.replace(" … ", "") for line in printed(80))


def test_json_is_written_at_once_or_not_at_all(tmp_path: Path) -> None:
    """A number that is no JSON leaves the old file as it was, and nothing beside it."""
    path = tmp_path / "deep" / "report.json"
    write_json(path, {"success": 1.0})
    with pytest.raises(ValueError, match="JSON"):
        write_json(path, {"success": float("nan")})
    assert json.loads(path.read_text()) == {"success": 1.0}
    assert list(path.parent.iterdir()) == [path]
