import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from irl_dal.comparison import suite
from irl_dal.comparison.drive import arm_bench, arm_planner, plan_log, risky_contexts
from irl_dal.comparison.settings import Arm, arms_of
from irl_dal.comparison.suite import compare
from irl_dal.config import ConfigError
from irl_dal.evaluation.metrics import compute_metrics
from irl_dal.evaluation.rig import Rig
from irl_dal.planner import ProjectionMode
from tests.irl_dal.comparison.tiny import TINY, tiny_subject
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
    """Executed violations: many without projection and shield, exactly 0 in admissible arms."""
    arms = {arm.name: arm for arm in arms_of(TINY, "x0")}
    for name, found in compared.report["arms"].items():
        if arms[name].admissible:
            assert found["command_violation_rate"] == 0.0, name
        if arms[name].projection != "none":
            assert found["nominal_violation_rate_planner"] == 0.0, name
    assert compared.report["arms"]["alone-none-bare"]["command_violation_rate"] > 0.3
    assert compared.report["arms"]["alone-none-bare"]["correction_norm"] == 0.0
    assert compared.report["arms"]["alone-none-shield"]["nominal_violation_rate"] > 0.3
    assert compared.report["arms"]["alone-none-shield"]["correction_norm"] > 0.0
    assert compared.report["arms"]["alone-x0-bare"]["command_violation_rate"] == 0.0


def test_plans_in_the_same_states(compared: Compared) -> None:
    """Projected plans keep every bound, pure ones do not; guidance lowers a plan's energy."""
    states = compared.report["states"]
    assert set(states) == {"none", "x0", "x0, unguided"}
    assert states["none"]["state_plan_violation_rate"] > 0.3
    assert states["x0"]["state_plan_violation_rate"] == 0.0
    assert states["x0"]["state_plan_nominal_violation_rate"] > 0.0
    assert states["x0"]["state_plan_energy"] < states["none"]["state_plan_energy"]
    assert states["x0"]["state_plan_energy_nominal"] < states["x0"]["state_plan_energy_unguided"]
    assert states["x0, unguided"]["state_plan_energy_unguided"] is None
    assert states["none"]["state_plan_diversity_m"] > 0.0


@pytest.mark.parametrize("projection", ["none", "x0"])
def test_guided_plans_have_less_energy_in_logged_risky_states(
    compared: Compared, projection: ProjectionMode
) -> None:
    """In the risky states of two drives of the expert, with the same noise, one plan in each."""
    arms = [Arm("trigger", projection, True, guided=guided) for guided in (True, False)]
    logs = []
    with arm_bench(compared.subject, arms[0]) as bench:
        contexts = [list(risky_contexts(bench, seed)[1].values()) for seed in TINY.seeds]
    for arm in arms:
        planner = arm_planner(compared.subject, arm, 1)
        plans = [plan for group in contexts for plan in plan_log(planner, group, 0)]
        logs.append(np.array([entry.plan.energy for entry in plans]))
    guided, unguided = logs
    assert len(guided) >= 10
    assert guided.mean() < unguided.mean()
    assert (guided < unguided).mean() > 0.5


def test_numbers_are_those_of_an_evaluation(compared: Compared) -> None:
    """An arm driven anew and given to the metrics module yields the report's numbers."""
    subject, arm = compared.subject, Arm("trigger", "x0", shielded=True)
    with arm_bench(subject, arm) as bench:
        episodes = [bench.episode(seed) for seed in TINY.seeds]
    again = compute_metrics(episodes, np.random.default_rng(0))
    found = compared.report["arms"][arm.name]
    assert again["intervention_rate"] == found["intervention_rate"] > 0.0
    for key, value in again.items():
        if value is not None and not key.endswith("_ci95") and not key.startswith("latency"):
            assert found[key] == value, key
    assert found["ade_m"] >= 0.0


def test_differences_are_paired_with_pure_diffusion(compared: Compared) -> None:
    """Each arm minus its own activation's pure arm; the pure arm's own difference is zero."""
    arms = compared.report["arms"]
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
    alone = replace(TINY, activations=("alone",))
    subject = tiny_subject(run, tmp_path / "out", alone)
    drive, driven = Rig.drive, []

    def counted(bench: Rig, seed: int) -> object:
        if len(driven) == 3:
            raise KeyboardInterrupt
        driven.append(seed)
        return drive(bench, seed)

    monkeypatch.setattr(Rig, "drive", counted)
    with pytest.raises(KeyboardInterrupt):
        compare(subject)
    kept = sorted((tmp_path / "out" / "episodes").rglob("*.json"))
    assert len(kept) == 3
    stamps = [path.stat().st_mtime_ns for path in kept]
    driven.clear()
    driven.extend([-1] * 4)
    monkeypatch.setattr(suite, "plan_in_states", None)
    report = compare(subject)
    assert [path.stat().st_mtime_ns for path in kept] == stamps
    assert len(driven) == 4 + 2 * len(report["arms"]) - 3
    found = numbers(report)["arms"]
    assert found == {name: numbers(compared.report)["arms"][name] for name in found}


def test_a_complete_comparison_drives_nothing(
    compared: Compared, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All that is asked for again is read; fewer episodes are a part of it."""

    def never(*_: object) -> None:
        raise AssertionError("driven again")

    monkeypatch.setattr(suite, "drive_arm", never)
    monkeypatch.setattr(suite, "plan_in_states", never)
    assert numbers(compare(compared.subject)) == numbers(compared.report)
    fewer = replace(compared.subject, comparison=replace(TINY, episodes=1))
    assert len(compare(fewer)["arms"]["alone-x0-bare"]["seeds"]) == 1


@pytest.mark.parametrize(
    ("key", "value"), [("first_seed", 5), ("states", 1), ("candidates", 4), ("path_states", 0)]
)
def test_other_settings_are_refused(compared: Compared, key: str, value: int) -> None:
    """A folder holds one comparison; the complaint names the setting and both values."""
    other = replace(compared.subject, comparison=replace(TINY, **{key: value}))
    with pytest.raises(ConfigError, match=f"{key} = {getattr(TINY, key)}, asked for is {value}"):
        compare(other)


def test_another_planner_is_refused(compared: Compared) -> None:
    """The configuration of the run counts too."""
    config = compared.subject.config
    slower = replace(config, planner=replace(config.planner, sampling_steps=5))
    words = r"config\.planner\.sampling_steps = 4, asked for is 5"
    with pytest.raises(ConfigError, match=words):
        compare(replace(compared.subject, config=slower))


def test_a_folder_of_something_else_is_refused(run: Path, tmp_path: Path) -> None:
    """Nothing is written into a folder that holds other things."""
    (tmp_path / "mine.txt").write_text("precious")
    with pytest.raises(ConfigError, match="not the folder of a comparison"):
        compare(tiny_subject(run, tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
