"""From runs to the paper's table."""

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import trim_mean

from irl_dal import report
from irl_dal.config import ConfigError
from irl_dal.sweep.across_runs import across_runs, band
from irl_dal.sweep.collection import Collection, collect
from irl_dal.sweep.paper_table import estimates_of, notes
from irl_dal.sweep.remarks import interventions, remarks
from irl_dal.sweep.result import RunResult, read_result, write_result
from tests.irl_dal.figures.test_comparison_page import CHROMIUM, opened
from tests.irl_dal.tiny_run import sweep

Call = Callable[..., str]


@pytest.fixture(autouse=True)
def few_resamples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Intervals a little less exact, ten times as fast."""
    monkeypatch.setattr("irl_dal.sweep.across_runs.RESAMPLES", 200)


@pytest.fixture
def call(console: Call) -> Call:
    """The command on its console."""
    return partial(console, report.main)


@pytest.fixture(scope="module")
def result(swept: Path, tmp_path_factory: pytest.TempPathFactory) -> RunResult:
    """A run's result, as it is read back."""
    found = collect(swept).of("shielded")[0]
    path = tmp_path_factory.mktemp("result") / "one.json"
    write_result(found, path)
    assert read_result(path) == found
    return found


def runs_of(result: RunResult, variant: str, successes: list[float]) -> tuple[RunResult, ...]:
    """Runs that differ in their success."""
    return tuple(
        replace(
            result, variant=variant, seed=seed, evaluation={**result.evaluation, "success": value}
        )
        for seed, value in enumerate(successes)
    )


def test_a_sweep_trains_every_combination_and_goes_on(
    swept: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The second call finds both runs finished and touches nothing."""
    times = {path: path.stat().st_mtime_ns for path in swept.rglob("*.csv")}
    assert {path.parent.name for path in times} == {"ppo_uniform-seed3", "shielded-seed3"}
    capsys.readouterr()
    sweep(swept.parent)
    assert capsys.readouterr().out.count("finished already") == 2
    assert times == {path: path.stat().st_mtime_ns for path in swept.rglob("*.csv")}


def test_a_sweep_does_not_go_on_with_another_configuration(
    swept: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A changed number would mix two configurations in one run."""
    with pytest.raises(SystemExit) as end:
        sweep(swept.parent, "env.lidar_noise=0.5")
    assert end.value.code == 2
    assert "another configuration" in capsys.readouterr().err


def test_the_command_writes_table_results_and_page(swept: Path, call: Call, tmp_path: Path) -> None:
    """The table is printed; results reproduce it without the runs."""
    page = tmp_path / "README.md"
    page.write_text("before\n<!-- table: begin -->\nold\n<!-- table: end -->\nafter\n")
    out = tmp_path / "out"
    printed = call(f"runs={swept}", f"out={out}", f"page={page}")
    assert "PPO, uniform replay" in printed and "78.1" in printed
    text = page.read_text()
    assert text.startswith("before\n") and text.endswith("after\n") and "old" not in text
    assert "| + projection, shield | 1 |" in text
    again = call(f"runs={out / 'results'}", f"page={page}")
    assert page.read_text() == text
    assert printed.startswith(again) and len(again) > 500
    numbers = json.loads((out / "report.json").read_text())
    assert numbers["shielded"]["command_violation_rate"]["value"] == 0.0
    assert {path.name for path in (out / "figures").iterdir()} == {
        "scores.png",
        "dynamics.png",
        "overlay.png",
    }


@pytest.mark.skipif(CHROMIUM is None, reason="apt-get install chromium")
def test_a_browser_draws_the_page(swept: Path, call: Call, tmp_path: Path) -> None:
    """Every figure with its marks, nothing on the console, no other file needed."""
    call(f"runs={swept}", f"out={tmp_path}")
    page = (tmp_path / "index.html").read_text()
    assert not re.search(r"""(?:src|href)\s*=\s*["'](?!data:|#)""", page)
    figures, console = opened(page, tmp_path)
    assert console == []
    assert set(figures) == {"scores", "dynamics", "overlay"}
    assert min(figures.values()) > 20, figures


def test_the_interquartile_mean_is_that_of_the_middle_half(result: RunResult) -> None:
    """One bad run of five does not enter; the interval holds the value and depends on the seed."""
    successes = [0.2, 0.9, 0.95, 1.0, 0.97]
    runs = runs_of(result, "shielded", successes)
    one = across_runs(runs, "success", np.random.default_rng(0))
    assert one.value == pytest.approx(trim_mean(successes, 0.25)) == pytest.approx(0.94)
    assert one.low is not None and one.high is not None and one.low < one.value < one.high
    assert one == across_runs(runs, "success", np.random.default_rng(0))
    state = np.random.get_state()[1]
    across_runs(runs, "success", np.random.default_rng(1))
    assert np.array_equal(state, np.random.get_state()[1])


def test_one_run_has_no_interval_and_a_missing_number_is_none(result: RunResult) -> None:
    """Neither is an error."""
    runs = runs_of(result, "paper", [0.5])
    one = across_runs(runs, "success", np.random.default_rng(0))
    assert (one.value, one.low, one.high) == (0.5, None, None)
    assert across_runs(runs, "no_such_number", np.random.default_rng(0)).value is None


def test_a_band_keeps_the_steps_at_which_every_run_has_a_value(result: RunResult) -> None:
    """A hole in one run is a hole in the band."""
    first = replace(result, steps=[1, 2, 3], curves={"bc/loss": [1.0, None, 3.0]})
    second = replace(result, seed=1, steps=[1, 2, 3], curves={"bc/loss": [3.0, 2.0, 5.0]})
    found = band([first, second], "bc/loss", np.random.default_rng(0))
    assert found is not None
    assert found.steps.tolist() == [1.0, 3.0] and found.middle.tolist() == [2.0, 4.0]
    empty = replace(result, curves={"bc/loss": [None] * len(result.steps)})
    assert band([empty], "bc/loss", np.random.default_rng(0)) is None


@pytest.mark.parametrize(
    ("ours", "how_sure"),
    [
        ([0.8], "too few runs to tell"),
        ([0.8, 0.95], "their intervals overlap"),
        ([0.7, 0.8], "their intervals do not overlap"),
    ],
)
def test_the_remarks_say_who_is_out_of_order(
    result: RunResult, ours: list[float], how_sure: str
) -> None:
    """The paper's order holds, or the page says where it does not, and whether that is noise."""
    rng = np.random.default_rng(0)
    good = runs_of(result, "irl_dal", [0.8]) + runs_of(result, "shielded", [0.9])
    said = " ".join(remarks(c := Collection(good), estimates_of(c, rng)))
    assert "By success the variants are in the paper's order." in said
    bad = runs_of(result, "irl_dal", [0.9, 0.92]) + runs_of(result, "shielded", ours)
    said = " ".join(remarks(c := Collection(bad), estimates_of(c, rng)))
    words = f"not in the paper's order: + projection, shield behind + LAM + SAEC ({how_sure})"
    assert words in said


def test_the_remarks_compare_a_variant_with_all_before_it(result: RunResult) -> None:
    """The third may be ahead of the second and still behind the first."""
    first, second, third = (
        runs_of(result, variant, [success])
        for variant, success in (("ppo_uniform", 0.8), ("fsm_replay", 0.6), ("diffusion", 0.7))
    )
    c = Collection(first + second + third)
    said = remarks(c, estimates_of(c, np.random.default_rng(0)))[0]
    assert "FSM replay behind PPO, uniform replay" in said
    assert "diffusion planner behind PPO, uniform replay" in said
    assert "behind + FSM replay" not in said


def test_interventions_are_those_of_the_mixed_phase(result: RunResult) -> None:
    """What comes before it does not count."""
    run = replace(
        result,
        origin={**result.origin, "imitation_steps": 10},
        steps=[5, 10, 15, 20, 25],
        curves={"rollout/intervention_rate": [0.9, 0.9, 0.6, None, 0.2]},
    )
    assert interventions([run]) == (0.6, 0.2)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ((), "runs = None"),
        (("runs=/nowhere",), "no such folder"),
        (("runs={tmp}",), "neither runs nor results"),
        (("runs={runs}", "page={tmp}/no.md"), "No such file"),
        (("runs={runs}", "page={tmp}/bare.md"), "lacks <!-- table: begin -->"),
        (("runs={runs}", "page={tmp}/half.md"), "lacks <!-- table: begin -->"),
        (("runs={runs}", "page={tmp}"), "page = '{tmp}'"),
        (("runs={runs}", "page={tmp}/latin.md"), "not UTF-8"),
        (("runs={runs}", "out={tmp}/bare.md"), "out = '{tmp}/bare.md': is a file"),
        (("runs={runs}", "out={tmp}/bare.md/out"), "out = '{tmp}/bare.md/out': cannot be written"),
        (("runs={runs}", "seed=-1"), "seed = -1"),
        (("runs={runs}", "seed=many"), "seed = 'many'"),
        (("runs={tmp}/bare.md",), "no such folder"),
    ],
)
def test_mistakes_get_one_line(
    swept: Path, call: Call, tmp_path: Path, arguments: tuple[str, ...], complaint: str
) -> None:
    """That names what is wrong."""
    folder = tmp_path / "empty"
    folder.mkdir()
    (folder / "bare.md").write_text("nothing here")
    (folder / "half.md").write_text("<!-- table: end --> <!-- table: begin -->")
    (folder / "latin.md").write_bytes(b"caf\xe9")
    asked = [one.format(tmp=folder, runs=swept) for one in arguments]
    printed = call(*asked)
    assert complaint.format(tmp=folder) in printed and len(printed.splitlines()) == 1


def test_what_does_not_belong_together_is_refused(result: RunResult, tmp_path: Path) -> None:
    """Twice the same run, other episodes, a file that is no result."""
    write_result(result, tmp_path / "a.json")
    write_result(result, tmp_path / "b.json")
    with pytest.raises(ConfigError, match="is shielded-seed3, as"):
        collect(tmp_path)
    write_result(replace(result, seed=1, first_seed=7), tmp_path / "b.json")
    with pytest.raises(ConfigError, match="episodes from seed"):
        collect(tmp_path)
    (tmp_path / "b.json").write_text('{"format": 99}')
    with pytest.raises(ConfigError, match="result format 99"):
        collect(tmp_path)
    (tmp_path / "b.json").write_text("half a fi")
    with pytest.raises(ConfigError, match="is damaged"):
        collect(tmp_path)


def test_a_row_holds_one_configuration(result: RunResult, call: Call, tmp_path: Path) -> None:
    """The most frequent configuration is the row; others are left out by name, never averaged."""
    for seed, (digest, success) in enumerate((("aaa", 1.0), ("aaa", 1.0), ("bbb", 0.0))):
        run = replace(
            result,
            seed=seed,
            origin={**result.origin, "config_hash": digest},
            evaluation={**result.evaluation, "config_hash": digest, "success": success},
        )
        write_result(run, tmp_path / f"{seed}.json")
    (page := tmp_path / "page.md").write_text("<!-- table: begin --><!-- table: end -->")
    note = f"left out: {tmp_path / '2.json'} (configuration bbb, the row has aaa)"
    assert note in call(f"runs={tmp_path}", f"page={page}")
    assert note in page.read_text() and "| + projection, shield | 2 | 100.0" in page.read_text()
    # the same seed under another configuration is no duplicate, and an evaluation under other
    # settings than the training's is another configuration
    kept = read_result(tmp_path / "0.json")
    write_result(
        replace(kept, evaluation={**kept.evaluation, "config_hash": "ccc"}), tmp_path / "2.json"
    )
    assert "aaa evaluated as ccc" in collect(tmp_path).left_out[0]


def test_among_equally_frequent_configurations_the_last_trained_counts(
    result: RunResult, tmp_path: Path
) -> None:
    """One run each."""
    for seed, day in enumerate(("2026-01-02", "2026-01-01")):
        origin = {**result.origin, "config_hash": str(seed), "started": day}
        write_result(replace(result, seed=seed, origin=origin), tmp_path / f"{seed}.json")
    assert [run.seed for run in collect(tmp_path).results] == [0]


def test_a_row_of_several_commits_says_so(result: RunResult) -> None:
    """Below the table, with the commits; not where all runs have the same."""
    other = replace(result, seed=1, origin={**result.origin, "commit": "f" * 40})
    assert notes(Collection((result,))) == []
    (note,) = notes(Collection((result, other)))
    assert "several commits" in note and "+ projection, shield" in note and "fffffff" in note


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("config.yaml", "env: null\n"),
        ("config.yaml", ": {"),
        ("run.json", "half a fi"),
        ("evaluation.json", "half a fi"),
        ("evaluation.json", "{}"),
        ("metrics.csv", "nonsense\n1\n"),
    ],
)
def test_a_damaged_run_is_named(
    swept: Path, call: Call, tmp_path: Path, name: str, text: str
) -> None:
    """Among good ones."""
    for run in ("ppo_uniform-seed3", "shielded-seed3"):
        shutil.copytree(swept / run, tmp_path / run)
    (tmp_path / "shielded-seed3" / name).write_text(text)
    assert str(tmp_path / "shielded-seed3") in call(f"runs={tmp_path}")


def test_a_run_without_weights_is_named(swept: Path, call: Call, tmp_path: Path) -> None:
    """Its path cannot be driven."""
    shutil.copytree(swept / "shielded-seed3", tmp_path / "shielded-seed3")
    shutil.rmtree(tmp_path / "shielded-seed3" / "checkpoints")
    assert str(tmp_path / "shielded-seed3") in call(f"runs={tmp_path}")


@pytest.mark.parametrize(
    "change",
    [{"seed": "x"}, {"steps": None}, {"outcomes": []}, {"curves": {"bc/loss": [1.0]}}, {"path": 3}],
)
def test_a_damaged_result_is_named(
    result: RunResult, tmp_path: Path, change: dict[str, object]
) -> None:
    """Every field has its type."""
    path = tmp_path / "one.json"
    write_result(result, path)
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(ConfigError, match="one.json"):
        collect(tmp_path)


def test_a_metric_that_is_no_number_is_named(result: RunResult) -> None:
    """Instead of a traceback from numpy."""
    wrong = replace(result, evaluation={**result.evaluation, "success": "high"})
    with pytest.raises(ConfigError, match="success = 'high'"):
        across_runs([wrong], "success", np.random.default_rng(0))


def test_an_unfinished_run_is_left_out_and_named(swept: Path, call: Call, tmp_path: Path) -> None:
    """It has no evaluation yet."""
    for name in ("ppo_uniform-seed3", "shielded-seed3"):
        shutil.copytree(swept / name, tmp_path / name)
    (tmp_path / "ppo_uniform-seed3" / "evaluation.json").unlink()
    printed = call(f"runs={tmp_path}")
    assert "(not finished)" in printed and "left out" in printed
    assert "+ projection, shield" in printed
    assert "PPO" not in printed


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_sweep_runs_on_a_local_ray_cluster(tmp_path: Path) -> None:
    """Two variants with two seeds each; extra `cluster`."""
    pytest.importorskip("ray")
    sweep(tmp_path, "seed=0,1", "hydra/launcher=ray", "+hydra.launcher.ray.init.num_cpus=2")
    assert len(collect(tmp_path / "runs").results) == 4
