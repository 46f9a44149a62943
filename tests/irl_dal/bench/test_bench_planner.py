"""The planner's benchmark times what it says."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from irl_dal.bench.__main__ import main
from irl_dal.bench.planner import PARTS, make_planner, shares
from irl_dal.config import RunConfig
from irl_dal.planner.config import SamplerKind
from irl_dal.planner.guidance import GuidanceConfig
from tests.irl_dal.planner.scenes import context, planner, random_context

SCENES = [random_context(np.random.default_rng(seed)) for seed in range(3)]


def test_shares_are_those_of_the_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a clock that ticks once per look, each timed call takes one; nothing stays patched."""
    made = planner(sampling_steps=4, guidance=GuidanceConfig(max_final_iterations=1))
    ticks = itertools.count()
    methods = [(owner, name) for part in PARTS.values() for owner, name in part]
    before = [getattr(owner, name) for owner, name in methods]
    monkeypatch.setattr("irl_dal.bench.stopwatch.time.process_time", lambda: float(next(ticks)))
    found = shares(made, SCENES[:1], 1)
    # condition and 4 predictions; building and 4 + 1 careful + 2 final evaluations; 4 + 3 stages.
    assert [found[part] for part in PARTS] == [5e3, 8e3, 7e3]
    assert found["rest"] == 1e3 * (2 * 20 + 1 - 20)
    assert [getattr(owner, name) for owner, name in methods] == before


@pytest.mark.parametrize("kind", ["ddim", "ddpm"])
def test_settings_reach_the_planner(kind: SamplerKind) -> None:
    """What is asked for is what is built."""
    made = make_planner(RunConfig(), None, sampler=kind, horizon=16, candidates=4)
    assert made.plan(context()).candidates.shape == (4, 16, 2)


def test_the_command_prints_everything(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Latency beside its bound, and shares."""
    monkeypatch.setattr("irl_dal.bench.planner.logged_contexts", lambda *_: SCENES)
    main(["planner", "--rounds", "1", "--contexts", "3"])
    text = capsys.readouterr().out
    for words in ("DDPM-100", "DDIM-10", "target p99", "projection"):
        assert words in text


def test_a_missing_run_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 2 and the reason."""
    with pytest.raises(SystemExit, match="2"):
        main(["planner", "--run", "nowhere"])
    line = capsys.readouterr().err.strip()
    assert "nowhere" in line and line.count("\n") == 0


def test_a_run_without_a_planner_is_refused() -> None:
    """There is nothing to time."""
    config = RunConfig()
    off = replace(config, planner=replace(config.planner, enabled=False))
    with pytest.raises(ValueError, match="without a planner"):
        make_planner(off)
