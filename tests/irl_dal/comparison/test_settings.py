from dataclasses import replace

import pytest

from irl_dal.comparison.config import (
    ComparisonConfig,
    Setting,
    all_settings,
    parse_comparison,
    planning_settings,
)
from irl_dal.config import ConfigError, RunConfig


def test_settings_are_the_product_and_one_without_guidance() -> None:
    """Two activations, five modes, with and without shield, and the run's own mode unguided."""
    comparison = ComparisonConfig(activations=("trigger", "always"))
    settings = all_settings(comparison, "xt")
    assert len(settings) == 2 * 5 * 2 + 2 and len({setting.name for setting in settings}) == len(
        settings
    )
    unguided = [setting for setting in settings if not setting.guided]
    assert [(setting.projection, setting.shielded) for setting in unguided] == [("xt", True)] * 2
    assert {setting.baseline for setting in settings} == {
        Setting("trigger", "none", False),
        Setting("always", "none", False),
    }
    assert len(planning_settings(comparison, "xt")) == 6


def test_a_setting_changes_only_the_supervision() -> None:
    """Projection, activation, shield, guidance; never the network or the city."""
    config = RunConfig()
    changed = Setting("always", "xt", shielded=False, guided=False).configure(config, candidates=4)
    assert changed.planner.projection == "xt" and changed.planner.candidates == 4
    assert changed.planner.guidance.scale == 0.0
    assert changed.planner.activation == "always" and not changed.shield.enabled
    undone = replace(changed, planner=config.planner, shield=config.shield)
    assert undone == config


def test_alone_the_planner_has_all_the_weight() -> None:
    """What is executed is the plan's first command, whatever the risk."""
    alone = Setting("alone", "x0", shielded=False).configure(RunConfig())
    assert alone.planner.blend.base == 1.0 and alone.planner.activation == "always"
    always = Setting("always", "x0", shielded=False).configure(RunConfig())
    assert always.planner.blend == RunConfig().planner.blend


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"episodes": 0}, "`episodes` must be finite and at least 1. Got 0"),
        ({"episodes": "many"}, "episodes = 'many'"),
        ({"projections": ["none", "always"]}, r"projections\.1 = 'always': .*'adaptive'"),
        ({"projections": ["x0", "xt"]}, "`projections` must hold none"),
        ({"projections": ["none", "x0", "x0"]}, "`projections` must name each choice once"),
        ({"activations": ["never"]}, r"activations\.0 = 'never': .*'alone'"),
        ({"first_seed": -1}, "`first_seed` must be finite and at least 0. Got -1"),
    ],
)
def test_nonsense_is_refused(values: dict[str, object], words: str) -> None:
    """One line names key and value."""
    with pytest.raises((ConfigError, ValueError), match=words):
        parse_comparison(values)
