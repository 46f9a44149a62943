"""The metrics file."""

from pathlib import Path

import pytest

from irl_dal.learning.run_log import MetricsCsv, metrics_logger, read_metrics


def write(log: MetricsCsv, step: int, **values: float) -> None:
    """Write a row as stable-baselines3's logger does."""
    log.write(values, {key: () for key in values}, step)


def test_rows_keep_their_columns_as_new_keys_turn_up(tmp_path: Path) -> None:
    """The step comes first; a key that is new later leaves the earlier cells empty."""
    log = MetricsCsv(tmp_path / "metrics.csv")
    write(log, 10, b=1.0)
    write(log, 20, a=2.5, b=3.0)
    write(log, 30, a=4.0)
    text = (tmp_path / "metrics.csv").read_text().splitlines()
    assert text == ["step,b,a", "10,1.0,", "20,3.0,2.5", "30,,4.0"]


def test_going_on_drops_what_came_after_the_checkpoint(tmp_path: Path) -> None:
    """Rows of a lost interval are gone, the rest is kept."""
    path = tmp_path / "metrics.csv"
    log = MetricsCsv(path)
    for step in (10, 20, 30, 40):
        write(log, step, a=float(step))
    again = MetricsCsv(path, step=20)
    write(again, 30, a=-1.0)
    assert [row["a"] for row in read_metrics(path)] == ["10.0", "20.0", "-1.0"]


def test_a_new_run_begins_with_an_empty_file(tmp_path: Path) -> None:
    """Nothing of an earlier attempt is left."""
    path = tmp_path / "metrics.csv"
    write(MetricsCsv(path), 10, a=1.0)
    MetricsCsv(path)
    assert read_metrics(path) == []


def test_the_logger_writes_csv_and_tensorboard(tmp_path: Path) -> None:
    """One dump, both places."""
    logger = metrics_logger(tmp_path)
    logger.record("bc/loss", 0.25)
    logger.dump(7)
    logger.close()
    row = read_metrics(tmp_path / "metrics.csv")[0]
    assert int(row["step"]) == 7
    assert float(row["bc/loss"]) == pytest.approx(0.25)
    assert list((tmp_path / "tensorboard").glob("events*"))
