from dataclasses import replace
from pathlib import Path

import pytest

from irl_dal.evaluation.references import ReferenceCache
from irl_dal.evaluation.rig import AgentSpec, Bench
from irl_dal.evaluation.suite import evaluate
from tests.irl_dal.evaluation.small import small_config


def comparable(report: dict[str, object]) -> dict[str, object]:
    """The numbers that must repeat: everything but durations and the state of the clone."""
    return {
        key: value
        for key, value in report.items()
        if key != "commit" and not key.startswith("latency")
    }


def test_the_number_of_processes_changes_no_number(tmp_path: Path) -> None:
    """One process and two give the same report to the last bit."""
    reports = [
        evaluate(small_config(n_jobs=jobs), AgentSpec("random"), tmp_path / str(jobs)).report
        for jobs in (1, 2)
    ]
    assert comparable(reports[0]) == comparable(reports[1])
    assert reports[0]["seeds"] == [10_000, 10_001]
    assert reports[0]["normalized_return"] == 0.0
    assert reports[0]["command_violation_rate"] == 0.0


def test_the_expert_is_its_own_measure(tmp_path: Path) -> None:
    """Normalised return 200, similarity 1, BC loss, ADE and FDE exactly 0, no plan to time."""
    report = evaluate(small_config(), AgentSpec("expert"), tmp_path).report
    assert report["normalized_return"] == 200.0
    assert report["action_similarity"] == 1.0
    assert (report["bc_loss"], report["ade_m"], report["fde_m"]) == (0.0, 0.0, 0.0)
    assert report["latency_plan_p50_ms"] is None and report["latency_threads"] == 1


def test_references_are_driven_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A second evaluation reads them from beside the runs and reports the same."""
    config = small_config()
    first = evaluate(config, AgentSpec("random"), tmp_path).report

    def never(_bench: Bench, seed: int) -> float:
        raise AssertionError(f"seed {seed} was driven again")

    monkeypatch.setattr(Bench, "random_return", never)
    assert comparable(evaluate(config, AgentSpec("random"), tmp_path).report) == comparable(first)
    faster = replace(config.expert.longitudinal, cruise_speed=7.0)
    other = replace(config, expert=replace(config.expert, longitudinal=faster))
    other = replace(other, shield=replace(config.shield, enabled=False))
    with pytest.raises(AssertionError, match="driven again"):
        evaluate(other, AgentSpec("random"), tmp_path)


def test_another_evaluation_may_lose_what_this_one_remembers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two that write at once keep what one of them wrote; neither ends with an error."""
    kept = evaluate(small_config(), AgentSpec("random"), tmp_path / "kept").report
    monkeypatch.setattr(ReferenceCache, "add", lambda *_: None)
    lost = evaluate(small_config(), AgentSpec("random"), tmp_path / "lost").report
    assert comparable(lost) == comparable(kept)


def test_the_experts_own_drives_are_its_references(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Evaluating the expert drives each of its episodes once."""

    def never(_bench: Bench, seed: int) -> None:
        raise AssertionError(f"seed {seed} was driven again")

    monkeypatch.setattr(Bench, "probe", never)
    report = evaluate(small_config(held_out_episodes=0), AgentSpec("expert"), tmp_path).report
    assert report["normalized_return"] == 200.0 and report["bc_loss"] is None


def test_a_run_needs_a_folder() -> None:
    """An agent from a run without a folder, or the expert with one, is refused."""
    with pytest.raises(ValueError, match="`run_dir`"):
        AgentSpec("run")
    with pytest.raises(ValueError, match="`run_dir`"):
        AgentSpec("expert", Path("somewhere"))
