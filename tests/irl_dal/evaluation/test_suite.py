import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from irl_dal.evaluation import suite
from irl_dal.evaluation.rig import AgentSpec, Rig
from irl_dal.evaluation.suite import evaluate
from tests.irl_dal.evaluation.small import small_config


@pytest.fixture(autouse=True)
def short_paths(monkeypatch: pytest.MonkeyPatch) -> None:
    """Paths of a second: the drives take two."""
    monkeypatch.setattr(suite, "PATH_DURATION", 1.0)


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, object]]:
    """An evaluation of random actions in one process: the folder of the runs, and its report."""
    folder = tmp_path_factory.mktemp("usual")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(suite, "PATH_DURATION", 1.0)
        return folder, evaluate(small_config(), AgentSpec("random"), folder).report


def comparable(report: dict[str, object]) -> dict[str, object]:
    """The numbers that must repeat: everything but durations and the state of the clone."""
    return {
        key: value
        for key, value in report.items()
        if key != "commit" and not key.startswith("latency")
    }


def test_the_number_of_processes_changes_no_number(
    usual: tuple[Path, dict[str, object]], tmp_path: Path
) -> None:
    """One process and two give the same report to the last bit."""
    report = evaluate(small_config(n_jobs=2), AgentSpec("random"), tmp_path).report
    assert report["latency_processes"] == 2
    assert comparable(report) == comparable(usual[1])
    assert report["seeds"] == [10_000, 10_001]
    assert report["normalized_return"] == 0.0
    assert report["command_violation_rate"] == 0.0


def test_the_expert_is_its_own_measure(tmp_path: Path) -> None:
    """Normalised return 200, similarity 1, BC loss, ADE and FDE exactly 0, no plan to time."""
    report = evaluate(small_config(), AgentSpec("expert"), tmp_path).report
    assert report["normalized_return"] == 200.0
    assert report["action_similarity"] == 1.0
    assert (report["bc_loss"], report["ade_m"], report["fde_m"]) == (0.0, 0.0, 0.0)
    assert report["latency_plan_p50_ms"] is None and report["latency_threads"] == 1


def never(_rig: Rig, seed: int) -> dict[str, object]:
    """In the place of a drive that must not take place."""
    raise AssertionError(f"seed {seed} was driven again")


def test_references_are_driven_once(
    usual: tuple[Path, dict[str, object]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second evaluation reads them from beside the runs and reports the same."""
    config, first = small_config(), usual[1]
    shutil.copytree(usual[0], tmp_path, dirs_exist_ok=True)
    monkeypatch.setattr(Rig, "random_return", never)
    monkeypatch.setattr(Rig, "expert_return", never)
    assert comparable(evaluate(config, AgentSpec("random"), tmp_path).report) == comparable(first)
    bare = replace(small_config(held_out_episodes=0), shield=replace(config.shield, enabled=False))
    evaluate(bare, AgentSpec("random"), tmp_path)  # the references always drive under the shield
    longitudinal = replace(config.expert.longitudinal, cruise_speed=7.0)
    for other in (
        replace(bare, expert=replace(config.expert, longitudinal=longitudinal)),
        replace(bare, shield=replace(bare.shield, level="off")),
    ):
        with pytest.raises(AssertionError, match="driven again"):
            evaluate(other, AgentSpec("random"), tmp_path)


def test_the_experts_own_drives_are_its_references(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Evaluating the expert drives each of its episodes once, also for later evaluations."""
    monkeypatch.setattr(Rig, "expert", never)
    monkeypatch.setattr(Rig, "expert_return", never)
    config = small_config(held_out_episodes=0)
    report = evaluate(config, AgentSpec("expert"), tmp_path).report
    assert report["normalized_return"] == 200.0 and report["bc_loss"] is None
    monkeypatch.setattr(Rig, "random_return", never)
    evaluate(config, AgentSpec("random"), tmp_path)


def test_nothing_need_be_kept(usual: tuple[Path, dict[str, object]], tmp_path: Path) -> None:
    """In somebody else's folder the numbers are the same: what is kept is a convenience."""
    for name in ("unfinished", "references"):
        (tmp_path / name).touch()
    report = evaluate(small_config(), AgentSpec("random"), tmp_path).report
    assert comparable(report) == comparable(usual[1])


def test_an_interrupted_evaluation_goes_on_whatever_another_one_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It says what is kept; another one of the same agent that ends meanwhile removes none of it.

    The other one begins and ends while the first is interrupted; `ResultStore` is tested with
    another process.
    """
    config, drive, driven = small_config(held_out_episodes=0), Rig.episode, []
    another = small_config(held_out_episodes=0, episodes=1, first_seed=10_005)

    def interrupted(rig: Rig, seed: int) -> dict[str, object]:
        if driven:
            with monkeypatch.context() as patch:
                patch.setattr(Rig, "episode", drive)
                assert evaluate(another, AgentSpec("random"), tmp_path).report["episodes"] == 1
            raise KeyboardInterrupt
        driven.append(seed)
        return drive(rig, seed)

    monkeypatch.setattr(Rig, "episode", interrupted)
    with pytest.raises(KeyboardInterrupt, match="2 results are kept in .*unfinished") as end:
        evaluate(config, AgentSpec("random"), tmp_path)
    assert end.value.__suppress_context__
    monkeypatch.setattr(Rig, "episode", lambda rig, seed: driven.append(seed) or drive(rig, seed))
    report = evaluate(config, AgentSpec("random"), tmp_path).report
    assert driven == report["seeds"]
    assert not (tmp_path / "unfinished").exists()


def test_an_interrupted_evaluation_says_if_nothing_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before the first result, or where nothing can be written."""

    def interrupted(_rig: Rig, _seed: int) -> dict[str, object]:
        raise KeyboardInterrupt

    monkeypatch.setattr(Rig, "episode", interrupted)
    with pytest.raises(KeyboardInterrupt, match="nothing is kept"):
        evaluate(small_config(), AgentSpec("random"), tmp_path)


def test_a_run_needs_a_folder() -> None:
    """An agent from a run without a folder, or the expert with one, is refused."""
    with pytest.raises(ValueError, match="`run_dir`"):
        AgentSpec("run")
    with pytest.raises(ValueError, match="`run_dir`"):
        AgentSpec("expert", Path("somewhere"))
