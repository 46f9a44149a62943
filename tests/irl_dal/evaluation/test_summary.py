import io

import numpy as np
from rich.console import Console

from irl_dal.evaluation.metrics import compute_metrics, episode_record
from irl_dal.evaluation.summary import evaluation_table
from shield import ActuatorLimits
from tests.irl_dal.evaluation.small import written_episode


def printed(width: int) -> list[str]:
    """The table of two episodes, one successful."""
    episodes = [written_episode(), written_episode(success=False, off_road=True)]
    records = [episode_record(episode, ActuatorLimits()) for episode in episodes]
    report = compute_metrics(records, np.random.default_rng(0))
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
