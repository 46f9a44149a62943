"""The learners' benchmark times gradient steps on the threads that it names."""

from dataclasses import replace

import pytest
import torch

from irl_dal.bench.__main__ import main
from irl_dal.bench.learning import COUNTS, demonstrated, time_updates
from irl_dal.config import RunConfig


def small() -> RunConfig:
    """A narrow planner and small batches."""
    config = RunConfig()
    learning = replace(
        config.learning,
        cloning=replace(config.learning.cloning, batch_size=8),
        diffusion=replace(config.learning.diffusion, batch_size=8),
    )
    return replace(config, learning=learning, planner=replace(config.planner, width=8))


def test_updates_are_timed_on_each_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Policy and planner take turns; the first round of each only warms up."""
    with demonstrated(small(), 60) as learners:
        seen: dict[str, list[tuple[int, int]]] = {"clone": [], "plan": []}
        assert learners.diffusion is not None
        for name, learner in (("clone", learners.cloning), ("plan", learners.diffusion)):
            update = learner.update

            def watched(*args: object, _name=name, _update=update, **kwargs: object) -> float:
                seen[_name].append((torch.get_num_threads(), args[1]))
                return _update(*args, **kwargs)

            monkeypatch.setattr(learner, "update", watched)
        found = time_updates(learners, rounds=2, steps=1)
    assert seen == {"clone": [(1, 1), (2, 1)] * 3, "plan": [(1, 1), (2, 1)] * 3}
    assert set(found) == {"behaviour cloning", "planner"}
    assert all(len(times) == len(COUNTS) and (times > 0.0).all() for times in found.values())


def test_the_command_prints_a_table(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a short demonstration."""
    monkeypatch.setattr("irl_dal.bench.learning.DEMONSTRATION", 60)
    monkeypatch.setattr("irl_dal.bench.learning.STEPS", 1)
    monkeypatch.setattr("irl_dal.bench.__main__.RunConfig", small)
    main(["learning", "--rounds", "1"])
    text = capsys.readouterr().out
    for words in ("2 threads [ms]", "behaviour cloning", "ratio"):
        assert words in text
