"""The planner's benchmark times what it says, beside a loop that makes the same plans."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from irl_dal.bench.__main__ import main
from irl_dal.bench.plain_loop import PlainLoop
from irl_dal.bench.planner import (
    PARTS,
    compare_loops,
    denoiser_loss,
    make_planner,
    shares,
)
from irl_dal.config import RunConfig
from irl_dal.planner.config import SamplerKind
from irl_dal.planner.guidance import GuidanceConfig
from tests.irl_dal.planner.scenes import LIMITS, context, planner, random_context

SCENES = [random_context(np.random.default_rng(seed)) for seed in range(3)]


@pytest.mark.parametrize("projection", ["none", "x0", "xt"])
def test_the_plain_loop_makes_the_same_plan(projection: str) -> None:
    """From the same noise, DDIM over diffusers ends where our loop ends."""
    pytest.importorskip("diffusers", reason="pip install 'diffusers>=0.30'")
    ours = planner(projection=projection)
    plain = PlainLoop(ours, "ddim")
    for scene in SCENES:
        ours.generator.manual_seed(3)
        plan = ours.plan(scene)
        ours.generator.manual_seed(3)
        theirs = LIMITS.to_command(plain.plan(scene)[0])
        np.testing.assert_allclose(plan.actions, theirs, atol=2e-3)


def test_our_loop_is_faster_than_the_plain_one() -> None:
    """Less than three quarters of its time, whatever else the machine does; the goal is half."""
    pytest.importorskip("diffusers", reason="pip install 'diffusers>=0.30'")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        ours, plain = compare_loops(planner(sampler="ddpm"), SCENES[:2], 1)
    finally:
        torch.set_num_threads(threads)
    assert ours.percentile(50.0)[1] < 0.75 * plain.percentile(50.0)[1]


def test_shares_are_those_of_the_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a clock that ticks once per look, each timed call takes one; nothing stays patched."""
    made = planner(sampling_steps=4, guidance=GuidanceConfig(max_final_iterations=1))
    ticks = itertools.count()
    methods = [(owner, name) for part in PARTS.values() for owner, name in part]
    before = [getattr(owner, name) for owner, name in methods]
    monkeypatch.setattr("irl_dal.bench.planner.time.process_time", lambda: float(next(ticks)))
    found = shares(made, SCENES[:1], 1)
    # condition and 4 predictions; building and 4 + 1 careful + 2 final evaluations; 4 + 3 stages.
    assert [found[part] for part in PARTS] == [5e3, 8e3, 7e3]
    assert found["rest"] == 1e3 * (2 * 20 + 1 - 20)
    assert [getattr(owner, name) for owner, name in methods] == before


def test_the_fast_network_loses_nothing() -> None:
    """It differs from the torch one by single-precision rounding at every step."""
    worst, largest = denoiser_loss(planner(sampler="ddpm"), [context()])
    assert worst < 1e-5 < 0.1 < largest


@pytest.mark.parametrize("kind", ["ddim", "ddpm"])
def test_settings_reach_the_planner(kind: SamplerKind) -> None:
    """What is swept is what is built."""
    made = make_planner(RunConfig(), None, sampler=kind, horizon=16, candidates=4)
    assert made.plan(context()).candidates.shape == (4, 16, 2)


def test_the_command_prints_everything(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Latency beside its bound, the plain loop, shares, growth and the denoiser's loss."""
    monkeypatch.setattr("irl_dal.bench.planner.logged_contexts", lambda *_: SCENES)
    assert main(["planner", "--rounds", "1", "--contexts", "3"]) == 0
    text = capsys.readouterr().out
    for words in ("DDPM-100", "DDIM-10", "wanted p99", "projection", "N", "differs from the torch"):
        assert words in text


def test_a_missing_run_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 2 and the reason."""
    assert main(["planner", "--run", "nowhere"]) == 2
    line = capsys.readouterr().err.strip()
    assert "nowhere" in line and line.count("\n") == 0


def test_a_run_without_a_planner_is_refused(tmp_path: Path) -> None:
    """There is nothing to time."""
    config = RunConfig()
    off = replace(config, planner=replace(config.planner, enabled=False))
    with pytest.raises(ValueError, match="without a planner"):
        make_planner(off)
