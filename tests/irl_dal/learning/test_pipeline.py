"""Algorithm 1 from end to end, on the real city."""

import contextlib
import multiprocessing
import signal
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from irl_dal.learning import Pipeline
from irl_dal.learning.collection.recorder import EpisodeEnd
from irl_dal.learning.reinforcement.ppo import PPOConfig
from irl_dal.learning.run_log import ProgressBar, read_metrics
from irl_dal.storage.checkpoint import CheckpointError, CheckpointStore, pack
from tests.irl_dal.learning.city import SHORT, new_drivers, new_pipeline


class StopError(Exception):
    """Ends a run as a failure of anything else would."""


class StopAt(ProgressBar):
    """A progress bar that breaks the run at a step."""

    def __init__(self, step: int) -> None:
        self.step = step
        self.phases: list[tuple[str, int, int]] = []
        self.rows: list[int] = []
        self.ended = False

    def begin(self, phase: str, step: int, last: int) -> None:
        """Note the phase."""
        self.phases.append((phase, step, last))

    def advance(self, step: int) -> None:
        """Break the run."""
        if step == self.step:
            raise StopError

    def metrics(self, step: int, values: Mapping[str, float]) -> None:
        """Note the row."""
        self.rows.append(step)

    def end(self) -> None:
        """Note the end."""
        self.ended = True


def weights(pipeline: Pipeline) -> dict[str, np.ndarray]:
    """Every array of the pipeline's state but the replay buffer."""
    return pack(pipeline._state(final=True))[0]


def same(first: dict[str, np.ndarray], second: dict[str, np.ndarray]) -> bool:
    """Bit for bit the same arrays."""
    return first.keys() == second.keys() and all(np.array_equal(first[k], second[k]) for k in first)


def watch(pipeline: Pipeline, calls: dict[str, list[int]]) -> None:
    """Note the steps at which each learner is called from now on."""
    learners = pipeline.learners
    for name in ("clone", "train_planner", "train_discriminator", "sync_features"):
        owner = learners.discriminator if name == "sync_features" else learners
        original = getattr(owner, name)

        def spy(*given: object, name: str = name, real: Any = original) -> None:
            calls.setdefault(name, []).append(pipeline.step)
            real(*given)

        setattr(owner, name, spy)


@pytest.fixture(scope="module")
def calls() -> dict[str, list[int]]:
    """The steps at which the complete short run called each learner."""
    return {}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory, calls: dict[str, list[int]]) -> Pipeline:
    """A complete short run."""
    states = torch.get_rng_state(), np.random.get_state()[1].copy()
    pipeline = new_pipeline(tmp_path_factory.mktemp("run"), progress=StopAt(-1))
    watch(pipeline, calls)
    pipeline.run()
    assert torch.equal(torch.get_rng_state(), states[0])
    assert np.array_equal(np.random.get_state()[1], states[1])
    return pipeline


def test_a_run_does_all_of_algorithm_1(finished: Pipeline) -> None:
    """Both phases to the last step, every learner reports, the shield lets no violation through."""
    counts = finished.recorder.counts
    assert finished.step == counts.steps == 108
    assert counts.command_violations == 0
    assert finished.learners.discriminator.updates == 2
    assert len(finished.replay) == 108
    rows = read_metrics(finished.log._run_dir / "metrics.csv")
    assert [int(row["step"]) for row in rows] == [*range(10, 108, 10), 108]
    assert [row["phase"] for row in rows] == ["1.0"] * 6 + ["2.0"] * 5
    last_values = {key: row[key] for row in rows for key in row if row[key]}
    for key in (
        "bc/loss",
        "bc/train_loss",
        "planner/loss",
        "planner/train_loss",
        "discriminator/accuracy",
        "reward/imitation",
        "train/value_loss",
        "mask/alpha_speed",
        "critic/explained_variance",
        "rollout/intervention_rate",
        "rollout/action_similarity",
        "count/saec_marks",
        "count/plans_projected",
        "replay/lane_following",
        "time/driving",
        "time/ppo",
    ):
        assert np.isfinite(float(last_values[key])), key
    assert int(last_values["count/command_violations"]) == 0
    observer = finished.log.progress
    assert isinstance(observer, StopAt)
    assert observer.phases == [("imitation", 0, 60), ("mixed", 60, 108)]
    assert observer.rows == [int(row["step"]) for row in rows]
    assert observer.ended


def test_a_complete_run_leaves_one_checkpoint_without_replay(finished: Pipeline) -> None:
    """Policy and planner for the evaluation, no 600 MB of images; running again does nothing."""
    run_dir = finished.log._run_dir
    checkpoint = CheckpointStore(run_dir).load()
    assert checkpoint.step == 108
    assert not (run_dir / "checkpoints" / "replay").exists()
    again = new_pipeline(run_dir, seed=5)
    again.restore()
    assert same(weights(again), weights(finished))
    before = (run_dir / "metrics.csv").read_bytes()
    again.run()
    assert (run_dir / "metrics.csv").read_bytes() == before


def test_another_seed_is_another_agent(tmp_path: Path) -> None:
    """From the first weights on."""
    other = new_pipeline(tmp_path / "other", seed=1)
    assert not same(weights(other), weights(new_pipeline(tmp_path / "third")))


@pytest.mark.parametrize(("broken_at", "resumed_at"), [(14, 0), (70, 60), (106, 92)])
def test_a_broken_run_goes_on_from_its_last_checkpoint(
    tmp_path: Path, broken_at: int, resumed_at: int
) -> None:
    """At most one interval is lost; weights and data are those of the checkpoint."""
    broken = new_pipeline(tmp_path, progress=StopAt(broken_at))
    with pytest.raises(StopError):
        broken.run()
    end = 108 if resumed_at else 30  # from the beginning it is a run like any other
    resumed = new_pipeline(tmp_path, seed=9, progress=StopAt(-1 if resumed_at else 30))
    resumed.restore()
    assert resumed.step == resumed.replay.counter == len(resumed.replay) == resumed_at
    saved = pack(CheckpointStore(tmp_path).load().state)[0]
    assert same(
        {k: v for k, v in weights(resumed).items() if "replay" not in k},
        {k: v for k, v in saved.items() if "replay" not in k},
    )
    with contextlib.suppress(StopError):
        resumed.run()
    assert resumed.step == resumed.recorder.counts.steps == end
    steps = [int(row["step"]) for row in read_metrics(tmp_path / "metrics.csv")]
    assert steps == [*range(10, end, 10), *([end] if resumed_at else [])]


@pytest.mark.slow
def test_cars_in_processes_of_their_own_drive_the_same_run(
    finished: Pipeline, tmp_path: Path
) -> None:
    """Expert and policy, two cars side by side: the same weights as in one process.

    Every random draw comes from the seed, though the global generators are elsewhere. Fast are the
    same steps from processes (`collection/test_driver_processes`) and a run that leaves the global
    generators alone (`finished`).
    """
    torch.manual_seed(123)
    np.random.seed(123)
    drivers = new_drivers(processes=True)
    try:
        pipeline = new_pipeline(tmp_path, drivers=drivers)
        pipeline.run()
        assert same(weights(pipeline), weights(finished))
    finally:
        drivers.close()


def test_resuming_is_deterministic(tmp_path: Path) -> None:
    """Two processes that go on from one checkpoint end with the same weights."""
    with pytest.raises(StopError):
        new_pipeline(tmp_path, progress=StopAt(66)).run()
    ends = []
    for _ in range(2):
        with pytest.raises(StopError):
            resumed = new_pipeline(tmp_path, progress=StopAt(83))
            resumed.restore()
            resumed.run()
        ends.append(weights(resumed))
    assert same(*ends)


def train_in(run_dir: Path) -> None:
    """A complete short run; OpenMP's other threads do not survive a fork."""
    torch.set_num_threads(1)
    pipeline = new_pipeline(run_dir)
    pipeline.learners.threads = 1
    pipeline.run()


def test_kill_9_is_survived(tmp_path: Path) -> None:
    """A training process killed in the middle of a phase is resumed by another one."""
    metrics = tmp_path / "metrics.csv"
    process = multiprocessing.get_context("fork").Process(target=train_in, args=(tmp_path,))
    process.start()
    deadline = time.monotonic() + 300.0
    while len(read_metrics(metrics)) < 4 and time.monotonic() < deadline:
        time.sleep(0.02)
    process.kill()
    process.join()
    assert process.exitcode == -signal.SIGKILL
    written = int(read_metrics(metrics)[-1]["step"])
    resumed = new_pipeline(tmp_path)
    resumed.restore()
    assert written - 32 <= resumed.step <= 108
    assert resumed.step > 0
    resumed.run()
    assert resumed.step == 108


def test_a_checkpoint_of_another_configuration_is_refused(
    finished: Pipeline, tmp_path: Path
) -> None:
    """The error names the folder and both hashes."""
    config = replace(SHORT, imitation_steps=20, mixed_steps=0)
    new_pipeline(tmp_path, config, provenance={"config_hash": "aaa"}).run()
    with pytest.raises(CheckpointError, match=f"{tmp_path}.*of config aaa, this run has bbb"):
        new_pipeline(tmp_path, config, provenance={"config_hash": "bbb"}).restore()


def test_updates_come_when_the_paper_says(finished: Pipeline, calls: dict[str, list[int]]) -> None:
    """Each learner at the multiples of its interval, BC also at the end."""
    assert finished.step == 108
    assert calls == {
        "clone": [30, 60, 72, 96, 108],
        "train_planner": [20, 40, 60, 80, 100],
        "train_discriminator": [72, 90],
        "sync_features": [80, 100],
    }


def test_updates_of_four_cars_come_where_all_are_beyond(
    finished: Pipeline, tmp_path: Path, calls: dict[str, list[int]]
) -> None:
    """The discriminator's interval ends between two of their steps; the others as with two cars."""
    assert finished.step == 108
    pipeline, seen = new_pipeline(tmp_path, replace(SHORT, n_envs=4)), dict[str, list[int]]()
    watch(pipeline, seen)
    pipeline.run()
    assert seen == calls | {"train_discriminator": [72, 92]}


def test_a_rollout_holds_what_each_car_drove(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Step by step and car by car, with new episodes where old ones ended, whatever was due."""
    config = replace(
        SHORT,
        imitation_steps=1,
        mixed_steps=140,
        bc_interval_mixed=30,
        ppo=PPOConfig(n_steps=140, batch_size=20),
    )
    pipeline = new_pipeline(tmp_path, config)
    ppo = pipeline.learners.ppo
    ppo.set_logger(pipeline.log.open(0))
    monkeypatch.setattr(ppo, "train", lambda: None)
    pipeline.step = 1
    pipeline._refine()
    buffer = ppo.rollout_buffer
    assert pipeline.step == 141 and buffer.full
    stored = pipeline.replay.export_since(0)
    for key in ("lidar", "speed", "context"):
        assert np.array_equal(buffer.observations[key].reshape(140, -1), stored[key])
    assert np.array_equal(buffer.executed_actions.reshape(140, 2), stored["command"])
    starts = np.flatnonzero(buffer.episode_starts[:, 0])
    assert np.array_equal(starts, np.flatnonzero(stored["step"][::2] == 0))
    assert len(starts) > 1 and set(stored["episode"][::2]) == set(2 * np.arange(len(starts)))
    over = buffer.ends != EpisodeEnd.GOES_ON
    assert np.array_equal(over[:-1], buffer.episode_starts[1:] == 1.0)
    # Cars of their own drive the same with these actions, until the planner learns in step 40.
    twins = new_drivers(config)
    twins.reset()
    for step in range(15):
        twins.step(np.clip(buffer.actions[step], -1.0, 1.0))
        infos = twins.buf_infos  # type: ignore[attr-defined]
        commands = [info["record"].transition.command for info in infos]
        assert np.array_equal(buffer.executed_actions[step], commands)


def test_a_policy_that_diverges_ends_the_run_with_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No traceback of torch, and the checkpoint from before can be resumed."""
    pipeline = new_pipeline(tmp_path)
    clone = pipeline.learners.clone

    def diverge(steps: int) -> None:
        clone(steps)
        if pipeline.step == 96:
            with torch.no_grad():
                pipeline.policy.action_net.bias.fill_(float("nan"))

    monkeypatch.setattr(pipeline.learners, "clone", diverge)
    with pytest.raises(CheckpointError, match=f"{tmp_path}: step 9[6-9]: the policy diverged"):
        pipeline.run()
    resumed = new_pipeline(tmp_path)
    resumed.restore()
    assert resumed.step == 92


@pytest.mark.parametrize("saec", ["label", "paper", "off"])
def test_experience_correction_in_the_loop(tmp_path: Path, saec: str) -> None:
    """With the planner always on: what the replay buffer and the PPO buffer hold in each form."""
    config = replace(SHORT, imitation_steps=20, mixed_steps=32, saec=saec)  # type: ignore[arg-type]
    pipeline = new_pipeline(tmp_path, config, drivers=new_drivers(config, activation="always"))
    pipeline.run()
    marked = 0 if saec == "off" else 32
    assert pipeline.recorder.marks == marked
    assert len(pipeline.replay) == 20 + marked
    buffer = pipeline.learners.ppo.rollout_buffer
    if saec == "off":
        return
    labels = pipeline.replay.export_since(20)["label"]
    labels = labels.reshape(16, 2, 2).swapaxes(0, 1).reshape(-1, 2)  # PPO sorts by car
    distance = np.abs(buffer.actions.reshape(-1, 2) - labels).max(axis=1)
    assert np.all(distance == 0.0) if saec == "paper" else np.all(distance > 0.0)


def test_variants_without_planner_or_discriminator_run(tmp_path: Path) -> None:
    """The paper's baseline: uniform replay, no planner, no correction, no imitation reward."""
    reward = replace(SHORT.reward, w_env=1.0, w_irl=0.0)
    config = replace(
        SHORT, imitation_steps=20, mixed_steps=32, sampling="uniform", saec="off", reward=reward
    )
    drivers = new_drivers(config, planner=None)
    pipeline = new_pipeline(tmp_path, config, drivers=drivers, planner=False)
    pipeline.run()
    assert pipeline.learners.diffusion is None
    assert pipeline.recorder.counts.triggers == 0
    assert CheckpointStore(tmp_path).load().state["diffusion"] is None


def test_ppo_as_printed_runs(tmp_path: Path) -> None:
    """One rate for everything, gradients everywhere, unit noise: nothing becomes NaN."""
    ppo = replace(
        SHORT.ppo,
        target_kl=None,
        perception_gradient=True,
        renew=False,
        initial_log_std=(0.0, 0.0),
    )
    config = replace(SHORT, imitation_steps=20, mixed_steps=32, ppo=ppo)
    pipeline = new_pipeline(tmp_path, config)
    pipeline.run()
    assert all(torch.isfinite(value).all() for value in pipeline.policy.state_dict().values())


def test_a_checkpoint_that_lacks_something_is_refused(tmp_path: Path) -> None:
    """One line that names the folder, not a KeyError."""
    pipeline = new_pipeline(tmp_path)
    state = pipeline._state(final=False)
    del state["rng"]["critic"]
    CheckpointStore(tmp_path).save(state, step=0)
    with pytest.raises(CheckpointError, match=f"{tmp_path}.*does not fit this run.*critic"):
        pipeline.restore()
