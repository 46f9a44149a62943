import contextlib
import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from safetensors.numpy import load_file, save_file

from irl_dal import evaluate, train
from irl_dal.learning.run_log import read_metrics
from irl_dal.storage.checkpoint import run_lock
from irl_dal.storage.run_folder import open_run

Call = Callable[..., str]


@pytest.fixture
def call(console: Call) -> Call:
    """A command by its name, on its console."""
    commands = {"train": train.main, "evaluate": evaluate.main}
    return lambda command, *arguments: console(commands[command], *arguments)


@pytest.fixture(scope="module")
def trained(swept: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a complete tiny run, which these tests may change."""
    folder = tmp_path_factory.mktemp("commands") / "runs" / "tiny"
    shutil.copytree(swept / "shielded-seed3", folder)
    return folder


def test_training_leaves_everything_a_person_wants(trained: Path) -> None:
    """Configuration, metrics, checkpoint, numbers, figures, film; bounds kept, planner used."""
    names = {path.name for path in trained.iterdir()}
    assert names >= {
        "config.yaml",
        "run.json",
        "metrics.csv",
        "tensorboard",
        "checkpoints",
        "evaluation.json",
        "figures",
        "drive.mp4",
    }
    report = json.loads((trained / "evaluation.json").read_text())
    assert report["episodes"] == 2 and report["policy"] == "run" and report["training_seed"] == 3
    assert report["command_violation_rate"] == 0.0
    assert report["bc_loss"] is not None and report["ade_m"] is not None
    last = read_metrics(trained / "metrics.csv")[-1]
    assert int(last["step"]) == 128
    assert int(last["count/triggers"]) > 0 and int(last["count/saec_marks"]) > 0
    assert int(last["count/command_violations"]) == 0
    assert (trained / "figures" / "training.png").stat().st_size > 10_000
    assert (trained / "drive.mp4").stat().st_size > 1_000


def test_the_run_folder_says_what_was_asked_for(trained: Path) -> None:
    """The resolved configuration, without what Hydra only needs to compose it."""
    folder = open_run("run", trained)
    assert folder.config.seed == 3 and folder.config.learning.total_steps == 128
    text = (trained / "config.yaml").read_text()
    assert "${" not in text and "hydra" not in yaml.safe_load(text)


def test_evaluating_a_run_repeats_its_numbers(
    trained: Path, call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`evaluate run=DIR` measures as the training did at its end, and prints its table."""
    monkeypatch.setattr("irl_dal.evaluation.suite.PATH_DURATION", 1.0)
    out = tmp_path / "deep" / "again.json"
    extent = ("episodes=2", "n_jobs=1", "evaluation.held_out_episodes=1")
    paths = ("evaluation.path_states=2",)
    printed = call("evaluate", f"run={trained}", *extent, *paths, f"out={out}")
    assert "success" in printed and "executed commands out of bounds" in printed
    again = json.loads(out.read_text())
    before = json.loads((trained / "evaluation.json").read_text())
    for key in ("success", "mean_return", "bc_loss", "ade_m", "seeds", "config_hash"):
        assert again[key] == before[key], key


def test_an_interrupted_evaluation_goes_on(
    trained: Path,
    call: Call,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """What was driven is not driven again; other weights or settings share none of it."""

    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    out = tmp_path / "at_last.json"
    extent = ("n_jobs=1", "evaluation.held_out_episodes=0", "episodes=2", f"out={out}")
    with monkeypatch.context() as patch, pytest.raises(SystemExit) as end:
        patch.setattr("irl_dal.evaluation.suite.compute_metrics", interrupt)
        patch.setattr(sys, "argv", ["evaluate", f"run={trained}", *extent])
        evaluate.main()
    assert end.value.code == 130
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("interrupted; 2 results are kept in ") and "unfinished" in line
    with monkeypatch.context() as patch:
        patch.setattr("irl_dal.evaluation.rig.Rig.drive", None)  # nobody can drive
        with pytest.raises(TypeError):
            call("evaluate", f"run={trained}", *extent, "shield=off")
        call("evaluate", f"run={trained}", *extent)
    assert json.loads(out.read_text())["episodes"] == 2
    assert len(list((trained / "unfinished").iterdir())) == 1  # of the one without a shield


@pytest.mark.slow
def test_ctrl_c_is_one_line_and_ends_the_processes(tmp_path: Path) -> None:
    """Sent to the whole group, as a terminal does, while two processes drive.

    Its parts are fast: an interrupted evaluation in this file, deaf processes in `test_workers`.
    """
    root = Path(train.__file__).resolve().parents[1]
    extent = ("policy=random", "episodes=400", "n_jobs=2", "env.time_limit=1")
    process = subprocess.Popen(
        [sys.executable, "-m", "irl_dal.evaluate", *extent],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(root)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    try:
        started = time.monotonic()
        while not list(tmp_path.rglob("driving/*.json")) and time.monotonic() < started + 240:
            time.sleep(0.1)
        os.killpg(process.pid, signal.SIGINT)
        output = process.communicate(timeout=60)[0]  # waits for whoever holds the pipe
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == 130, output
    (line,) = output.strip().splitlines()
    assert line.startswith("interrupted; ") and " kept in runs/unfinished/" in line


def test_a_report_that_cannot_be_written_is_refused_before_the_first_drive(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`out=` is named, and nothing is left of the evaluation."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("irl_dal.evaluate.evaluate", None)  # nobody can drive
    (tmp_path / "file").touch()
    line = call("evaluate", "policy=random", "episodes=1", "out=file/numbers.json")
    assert "out = 'file/numbers.json'" in line
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_disk_that_fills_up_meanwhile_costs_the_file_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The table is printed, the complaint names `out`."""

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("irl_dal.evaluate.write_json", full)
    extent = ("episodes=1", "n_jobs=1", "evaluation.held_out_episodes=0", "env.time_limit=1")
    monkeypatch.setattr(sys, "argv", ["evaluate", "policy=random", *extent, "out=numbers.json"])
    with pytest.raises(SystemExit) as end:
        evaluate.main()
    printed = capsys.readouterr()
    assert end.value.code == 2 and "success" in printed.out
    (line,) = printed.err.splitlines()
    assert line.startswith("error: out = 'numbers.json'") and "No space left" in line


def test_a_run_can_be_evaluated_elsewhere(trained: Path, call: Call, tmp_path: Path) -> None:
    """Values of the city may be stated anew; what training settled may not."""
    out = tmp_path / "bare.json"
    extent = ("episodes=1", "n_jobs=1", "evaluation.held_out_episodes=0")
    call("evaluate", f"run={trained}", *extent, "shield=off", f"out={out}")
    report = json.loads(out.read_text())
    assert report["projection_active_rate"] == 0.0 and report["latency_shield_p50_ms"] is None
    assert report["bc_loss"] is None
    line = call("evaluate", f"run={trained}", *extent, "variant=paper")
    assert "variant = 'paper'" in line
    line = call("evaluate", f"run={trained}", *extent, "planner.width=32")
    assert "not fit the configuration" in line


def test_a_complete_run_resumes_to_its_evaluation(trained: Path, call: Call) -> None:
    """Nothing is trained again, the extent of the evaluation may be stated anew."""
    before = (trained / "metrics.csv").read_bytes()
    shorter = ("evaluation.episodes=1", "evaluation.video_duration=0")
    call("train", f"resume={trained}", *shorter, "seed=3")
    assert (trained / "metrics.csv").read_bytes() == before
    assert json.loads((trained / "evaluation.json").read_text())["episodes"] == 1


def test_a_resumed_run_keeps_its_configuration(trained: Path, call: Call) -> None:
    """Another value than the run's is refused, the same one is not."""
    assert "seed = 4" in call("train", f"resume={trained}", "seed=4")
    assert "preset = 'default'" in call("train", f"resume={trained}", "preset=default")
    assert "run_dir" in call("train", f"resume={trained}", "run_dir=elsewhere")


def test_a_truncated_checkpoint_is_named(trained: Path, call: Call, tmp_path: Path) -> None:
    """Evaluation and resumption say which file it is and write nothing."""
    copy = tmp_path / "copy"
    subprocess.run(["cp", "-r", str(trained), str(copy)], check=True)
    tensors = next((copy / "checkpoints").rglob("tensors.safetensors"))
    tensors.write_bytes(tensors.read_bytes()[:1000])
    before = sorted(path.name for path in copy.rglob("*"))
    out = tmp_path / "report.json"
    for line in (
        call("evaluate", f"run={copy}", f"out={out}"),
        call("train", f"resume={copy}"),
    ):
        assert str(tensors) in line and "truncated" in line
    assert not out.exists()
    assert sorted(path.name for path in copy.rglob("*")) == before


def test_weights_that_are_not_finite_are_named(trained: Path, call: Call, tmp_path: Path) -> None:
    """A training that diverged: one line from the evaluation and from a resumption."""
    copy = tmp_path / "copy"
    shutil.copytree(trained, copy)
    tensors = next((copy / "checkpoints").rglob("tensors.safetensors"))
    arrays = load_file(tensors)
    arrays["state/policy/action_net.bias"][0] = float("nan")
    save_file(arrays, tensors)
    for line in (call("evaluate", f"run={copy}"), call("train", f"resume={copy}")):
        assert str(copy) in line and "action_net.bias is not finite" in line


def test_a_run_in_training_cannot_be_resumed(trained: Path, call: Call) -> None:
    """A job that was submitted twice: the second one says so at once."""
    with run_lock(trained):
        line = call("train", f"resume={trained}")
    assert "resume" in line and str(trained) in line and "another process" in line


@pytest.mark.parametrize(
    ("command", "argument", "named"),
    [
        ("train", "foo=1", ["foo = 1"]),
        ("train", "limits.min_sped=1", ["limits.min_sped = 1", "did you mean limits.min_speed"]),
        ("train", "variant=best", ["variant = 'best'", "shielded"]),
        ("train", "preset=fast", ["preset = 'fast'", "smoke"]),
        ("train", "seed=abc", ["seed = 'abc'"]),
        ("train", "planner.horizon=0", ["planner.horizon", "Got 0"]),
        ("train", "limits.min_speed=50", ["limits.min_speed", "50"]),
        ("train", "seed", ["seed"]),
        ("train", "resume=nowhere", ["resume = 'nowhere'"]),
        ("evaluate", "run=nowhere", ["run = 'nowhere'"]),
        ("evaluate", "policy=best", ["policy = 'best'", "expert"]),
        ("evaluate", "episodes=5", ["run = None", "policy = None"]),
        ("evaluate", "policy=expert episodes=-1", ["episodes", "-1"]),
        ("evaluate", "policy=expert run=here", ["run = 'here'", "policy = 'expert'"]),
        ("evaluate", "policy=random out=.", ["out = '.'", "folder"]),
    ],
)
def test_a_mistake_gets_one_line(
    call: Call,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    command: str,
    argument: str,
    named: list[str],
) -> None:
    """Key and value on one line, exit code 2, nothing written."""
    monkeypatch.chdir(tmp_path)
    line = call(command, *argument.split())
    for part in named:
        assert part in line
    assert list(tmp_path.iterdir()) == []


def test_a_real_process_says_the_same(tmp_path: Path) -> None:
    """From a folder that knows nothing of the project: exit code 2, one line, no file."""
    (tmp_path / "configs").mkdir()
    (tmp_path / "configs" / "__init__.py").write_text("raise RuntimeError('not ours')")
    root = Path(train.__file__).resolve().parents[1]
    done = subprocess.run(
        [sys.executable, "-m", "irl_dal.train", "limits.min_speed=5", "limits.max_speed=1"],
        cwd=tmp_path,
        env={"PYTHONPATH": str(root), "PATH": ""},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 2 and done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert "limits.min_speed" in line and "max_speed=1.0" in line
    assert [path.name for path in tmp_path.rglob("*")] == ["configs", "__init__.py"]
