import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from irl_dal.comparison import experiment
from irl_dal.comparison.config import Setting, all_settings
from irl_dal.comparison.drive import setting_rig
from irl_dal.comparison.experiment import compare
from irl_dal.comparison.planning import plan_log, risky_contexts, setting_planner
from irl_dal.config import ConfigError
from irl_dal.evaluation.metrics import compute_metrics
from irl_dal.evaluation.rig import Rig
from irl_dal.planner import ProjectionMode
from tests.irl_dal.comparison.tiny import TINY, tiny_job
from tests.irl_dal.conftest import Compared


def numbers(report: dict[str, object]) -> dict[str, Any]:
    """What must repeat: everything but durations, resamples and the state of the clone."""
    text = json.dumps(report)
    kept = json.loads(text, object_hook=lambda entry: {
        key: value for key, value in entry.items()
        if not key.startswith("latency") and not key.endswith("_ci95")
        and key not in ("commit", "settings")
    })  # fmt: skip
    return dict(kept)


def test_pure_diffusion_breaks_bounds_and_nothing_else_does(compared: Compared) -> None:
    """Executed violations: many without projection and shield, exactly 0 in admissible settings."""
    settings = {setting.name: setting for setting in all_settings(TINY, "x0")}
    for name, found in compared.results["arms"].items():
        if settings[name].shielded or settings[name].projection != "none":
            assert found["command_violation_rate"] == 0.0, name
        if settings[name].projection != "none":
            assert found["nominal_violation_rate_planner"] == 0.0, name
    assert compared.results["arms"]["alone-none-bare"]["command_violation_rate"] > 0.3
    assert compared.results["arms"]["alone-none-bare"]["correction_norm"] == 0.0
    shielded = compared.results["arms"]["alone-none-shield"]  # its follower keeps the bounds
    assert shielded["nominal_violation_rate_planner"] > 0.3
    assert shielded["nominal_violation_rate"] == 0.0
    assert compared.results["arms"]["alone-x0-bare"]["command_violation_rate"] == 0.0


def test_plans_in_the_same_states(compared: Compared) -> None:
    """Projected plans keep every bound, pure ones do not; guidance lowers a plan's energy."""
    states = compared.results["states"]
    assert set(states) == {"none", "x0", "x0, unguided"}
    assert states["none"]["state_plan_violation_rate"] > 0.3
    assert states["x0"]["state_plan_violation_rate"] == 0.0
    assert states["x0"]["state_plan_nominal_violation_rate"] > 0.0
    assert states["x0"]["state_plan_energy_nominal"] < states["x0"]["state_plan_energy_unguided"]
    assert states["x0, unguided"]["state_plan_energy_unguided"] is None
    assert states["none"]["state_plan_diversity_m"] > 0.0


@pytest.mark.parametrize("projection", ["none", "x0"])
def test_guided_plans_have_less_energy_in_logged_risky_states(
    compared: Compared, projection: ProjectionMode
) -> None:
    """In the risky states of two drives of the expert, with the same noise, one plan in each."""
    settings = [Setting("trigger", projection, True, guided=guided) for guided in (True, False)]
    config = replace(compared.job.config, env=replace(compared.job.config.env, time_limit=2.0))
    logs, job = [], replace(compared.job, config=config, comparison=replace(TINY, candidates=1))
    with setting_rig(job, settings[0]) as rig:
        contexts = [risky_contexts(rig, seed)[1] for seed in TINY.seeds]
    for setting in settings:
        planner = setting_planner(job, setting)
        plans = [plan for group in contexts for plan in plan_log(planner, group, 0)]
        logs.append(np.array([entry.plan.energy for entry in plans]))
    guided, unguided = logs
    assert len(guided) >= 10
    assert guided.mean() < unguided.mean()
    assert (guided < unguided).mean() > 0.5


def test_numbers_are_those_of_an_evaluation(compared: Compared) -> None:
    """An arm driven anew and given to the metrics module yields the report's numbers."""
    job, setting = compared.job, Setting("trigger", "x0", shielded=True)
    with setting_rig(job, setting) as rig:
        episodes = [rig.episode(seed) for seed in TINY.seeds]
    again = compute_metrics(episodes, np.random.default_rng(0))
    found = compared.results["arms"][setting.name]
    assert again["intervention_rate"] == found["intervention_rate"] > 0.0
    for key, value in again.items():
        if value is not None and not key.endswith("_ci95") and not key.startswith("latency"):
            assert found[key] == value, key
    assert found["ade_m"] >= 0.0


def test_differences_are_paired_with_pure_diffusion(compared: Compared) -> None:
    """Each arm minus its own activation's pure arm; the pure arm's own difference is zero."""
    arms = compared.results["arms"]
    for name, arm in arms.items():
        base = arms[f"{arm['activation']}-none-bare"]
        gap = arm["comfort_rms_jerk"] - base["comfort_rms_jerk"]
        assert arm["comfort_rms_jerk_vs_none"] == pytest.approx(gap), name
        low, high = arm["comfort_rms_jerk_vs_none_ci95"]
        assert low <= arm["comfort_rms_jerk_vs_none"] <= high
    assert arms["alone-none-bare"]["success_vs_none_ci95"] == [0.0, 0.0]


def test_an_interrupted_comparison_goes_on(
    run: Path, compared: Compared, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was driven before the interruption is not driven again, and the numbers are the same."""
    alone = replace(TINY, activations=("alone",), episodes=1)
    job = tiny_job(run, tmp_path / "out", alone)
    expected = numbers(compare(replace(compared.job, comparison=alone)))["arms"]
    drive, driven = Rig.drive, []

    def counted(rig: Rig, seed: int) -> object:
        if len(driven) == 2:
            raise KeyboardInterrupt
        driven.append(seed)
        return drive(rig, seed)

    monkeypatch.setattr(Rig, "drive", counted)
    with pytest.raises(KeyboardInterrupt):
        compare(job)
    kept = sorted((tmp_path / "out").rglob("driving/*/*.json"))
    assert len(kept) == 2
    stamps = [path.stat().st_mtime_ns for path in kept]
    driven.clear()
    driven.extend([-1] * 3)
    monkeypatch.setattr(experiment, "plan_in_states", None)
    results = compare(job)
    assert [path.stat().st_mtime_ns for path in kept] == stamps
    assert len(driven) == 3 + len(results["arms"]) - 2
    assert numbers(results)["arms"] == expected


def test_a_complete_comparison_drives_nothing(
    compared: Compared, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All that is asked for again is read; fewer episodes are a part of it."""

    def never(*_: object) -> None:
        raise AssertionError("driven again")

    monkeypatch.setattr(experiment, "drive_setting", never)
    monkeypatch.setattr(experiment, "plan_in_states", never)
    assert numbers(compare(compared.job)) == numbers(compared.results)
    fewer = replace(compared.job, comparison=replace(TINY, episodes=1))
    assert len(compare(fewer)["arms"]["alone-x0-bare"]["seeds"]) == 1


def test_a_larger_comparison_drives_only_what_it_adds(
    compared: Compared, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another candidate count or planner is another result; another first seed adds episodes."""
    asked: list[tuple[object, list[int]]] = []

    def noted(_job: object, _store: object, who: object, seeds: list[int]) -> int:
        asked.append((who, seeds))
        raise KeyboardInterrupt

    monkeypatch.setattr(experiment, "plan_in_states", noted)
    later = replace(TINY, first_seed=TINY.first_seed + 1)
    with pytest.raises(KeyboardInterrupt):
        compare(replace(compared.job, comparison=later))
    assert asked[-1][1] == [TINY.first_seed + 2]
    config = compared.job.config
    slower = replace(config, planner=replace(config.planner, sampling_steps=5))
    for job in (
        replace(compared.job, comparison=replace(TINY, candidates=4)),
        replace(compared.job, config=slower),
    ):
        with pytest.raises(KeyboardInterrupt):
            compare(job)
        assert asked[-1][1][0] == TINY.first_seed


def test_a_folder_of_something_else_is_refused(run: Path, tmp_path: Path) -> None:
    """Nothing is written into a folder that holds other things."""
    (tmp_path / "mine.txt").write_text("precious")
    with pytest.raises(ConfigError, match="not the folder of a comparison"):
        compare(tiny_job(run, tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
