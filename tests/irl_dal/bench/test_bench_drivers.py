"""Bad drivers ask for what they say, and their trials tell what happened."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from irl_dal.bench.__main__ import main
from irl_dal.bench.drivers import DRIVERS
from irl_dal.bench.trial import Trial, drive, driver_tables, driver_trials, search
from irl_dal.build import build_loop
from irl_dal.config import RunConfig
from irl_dal.envs import CityConfig
from irl_dal.loop import ControlLoop, Supervision
from shield import SafetyFilter

SHORT = CityConfig(
    route_length=80.0, route_spread=0.0, time_limit=6.0, difficulty="easy", lane_sensor="odometry"
)


def config(level: str = "P0") -> RunConfig:
    """On a short road."""
    whole = RunConfig(env=SHORT)
    return replace(whole, shield=replace(whole.shield, level=level))


@pytest.fixture
def loop() -> Iterator[ControlLoop]:
    """A car without any promise but the limits."""
    made = build_loop(config(), Supervision())
    made.supervision = Supervision(safety_filter=SafetyFilter(made.limits))
    made.city.camera_on = False
    yield made
    made.close()


@pytest.mark.parametrize("name", DRIVERS)
def test_every_driver_drives_and_repeats_itself(loop: ControlLoop, name: str) -> None:
    """Finite commands, the same for the same generator, others for another one that draws."""

    def commands(seed: int) -> list[list[float]]:
        driver = DRIVERS[name](loop, np.random.default_rng(seed))
        observation, info = loop.reset(seed=2)
        asked = []
        for _ in range(12):
            asked.append(driver(observation, info).tolist())
            observation, *_, info = loop.step(loop.limits.to_action(np.array(asked[-1])))
        return asked

    one = commands(0)
    assert np.isfinite(one).all() and np.shape(one) == (12, 2)
    assert commands(0) == one
    draws = {"expert with noise", "random", "held random", "bang-bang", "untrained policy"}
    assert (commands(1) != one) == (name in draws)


def test_held_commands_are_held(loop: ControlLoop) -> None:
    """Between half a second and three seconds each."""
    driver = DRIVERS["held random"](loop, np.random.default_rng(0))
    asked = np.array([driver({}, {}) for _ in range(400)])
    changes = np.flatnonzero((np.diff(asked, axis=0) != 0.0).any(axis=1))
    assert 5 <= np.diff(changes).min() and np.diff(changes).max() <= 30


def test_a_drive_ends_with_what_happened(loop: ControlLoop) -> None:
    """Without a promise a hard turn leaves the lanes, and standing ends by itself."""
    turned = drive(loop, lambda *_: np.array([0.5, 6.0]), 2)
    assert (turned.end, turned.fault) == ("departure", "at_fault")
    assert 0.0 < turned.distance < 60.0 and len(turned.clearance) == len(turned.shield_time)
    loop.city.config = replace(SHORT, time_limit=60.0)
    stood = drive(loop, lambda *_: np.zeros(2), 2)
    assert (stood.end, stood.fault) == ("stood", None)
    assert 200 <= len(stood.clearance) < 230 and np.isinf(stood.clearance[-1])
    assert drive(loop, lambda *_: np.array([0.0, 1.0]), 2).end in {"contact", "departure", "goal"}


def test_a_clear_road_ends_at_the_goal_or_in_time() -> None:
    """The expert under the promise, with time for it and without."""
    (late,) = driver_trials(config(), "expert", [4])
    assert late.end == "timeout" and late.fault is None and late.distance > 5.0
    patient = replace(config(), env=replace(SHORT, time_limit=60.0))
    (trial,) = driver_trials(patient, "expert", [4])
    assert trial.end == "goal" and trial.fault is None and trial.distance > 75.0


def test_the_adversary_keeps_its_worst_drive(loop: ControlLoop) -> None:
    """A fault is the worst; it needs few drives without a promise."""
    trial = search(loop, np.random.default_rng(0), 2)
    assert trial.fault == "at_fault"
    calm = Trial(0, "goal", None, 1.0, 0.0, np.ones(1), np.array([2.0]), ())
    near = replace(calm, clearance=np.array([np.inf, 1.0]))
    assert trial.badness > near.badness > calm.badness


def test_tables_count_and_events_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seed, step, verdict and the reasons of the last steps; then both tables."""
    trials = {
        "random": [
            Trial(7, "departure", "at_fault", 4.0, 0.5, np.ones(3), np.ones(3), ("", "why"))
        ],
        "expert": [Trial(7, "goal", None, 8.0, 0.0, np.ones(3), np.ones(3), ("",))],
    }
    monkeypatch.setattr("irl_dal.bench.trial.driver_trials", lambda _, name, *__: trials[name])
    event, happened, price = driver_tables(config(), list(trials), [7])
    assert str(event).splitlines() == ["random, seed 7, step 3: departure, at_fault", "  3: why"]
    columns = {str(column.header): list(column.cells) for column in happened.columns}
    cells = {name: [str(cell) for cell in column] for name, column in columns.items()}
    assert cells["at fault"] == cells["departures"] == ["1", "0"]
    assert cells["arrived"] == ["0", "1"] and cells["at rest"] == ["0", "0"]
    assert [str(cell) for cell in price.columns[1].cells] == ["4", "8"]


def test_the_command_prints_both_tables(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """For the drivers that were chosen, at the level that was chosen."""
    monkeypatch.setattr("irl_dal.bench.__main__._city", lambda _: SHORT)
    drivers = ["--driver", "straight on", "brake-accelerate"]
    main(["drivers", "--episodes", "1", "--jobs", "1", "--level", "P1", *drivers])
    text = capsys.readouterr().out
    for words in ("under P1", "straight on", "brake-accelerate", "at fault", "p99"):
        assert words in text
    assert "adversary" not in text


@pytest.mark.parametrize(("option", "value"), [("--driver", "nobody"), ("--level", "P9")])
def test_an_unknown_name_is_one_line(
    option: str, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2, and what there is."""
    with pytest.raises(SystemExit, match="2"):
        main(["drivers", option, value])
    line = capsys.readouterr().err
    assert value in line and line.count("\n") == 1
