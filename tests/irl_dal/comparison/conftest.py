from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from irl_dal.comparison.page import write_page
from irl_dal.comparison.suite import compare
from irl_dal.comparison.work import Subject
from irl_dal.evaluation.report import write_json

from .tiny import tiny_subject, untrained_run


@dataclass(frozen=True)
class Compared:
    """A complete comparison."""

    subject: Subject
    report: dict[str, Any]


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder."""
    return untrained_run(tmp_path_factory.mktemp("compare") / "runs" / "tiny")


@pytest.fixture(scope="session")
def compared(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Compared:
    """A comparison on it with its page."""
    subject = tiny_subject(run, tmp_path_factory.mktemp("compared") / "out")
    report = compare(subject)
    write_json(subject.store.report, report)
    write_page(subject, report)
    return Compared(subject, report)
