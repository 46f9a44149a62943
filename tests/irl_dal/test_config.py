from dataclasses import FrozenInstanceError, fields, is_dataclass, replace
from functools import cache
from importlib import import_module
from inspect import signature
from pathlib import Path
from pkgutil import walk_packages
from typing import Any

import pytest
import yaml
from hydra import compose, initialize_config_dir

import expert
import irl_dal
import shield
from irl_dal.build import build_planner, supervision
from irl_dal.cli.command import CONFIG_FOLDER
from irl_dal.config import (
    GROUPS,
    ConfigError,
    RunConfig,
    config_hash,
    did_you_mean,
    known_keys,
    parse,
    register,
    to_mapping,
)
from shield import HorizonProjector

MAX_FIELDS = 200
"""Of all dataclasses called ...Config together."""


@cache
def composed(*overrides: str, command: str = "train") -> RunConfig:
    """What a command line makes of the configuration."""
    register()
    with initialize_config_dir(str(CONFIG_FOLDER), version_base="1.3"):
        return parse(compose(command, overrides=list(overrides)))


def test_the_files_only_say_what_differs() -> None:
    """Without overrides Hydra composes the dataclasses' own defaults: each number has one place."""
    assert composed() == RunConfig()
    extent = replace(RunConfig().evaluation, episodes=100)
    assert composed(command="evaluate") == replace(RunConfig(), evaluation=extent)


def test_a_configuration_survives_its_file() -> None:
    """What is written into a run folder is read back equal."""
    config = composed("variant=paper", "preset=smoke", "limits.max_lateral_acceleration=null")
    assert parse(yaml.safe_load(yaml.safe_dump(to_mapping(config)))) == config


def test_a_configuration_is_frozen() -> None:
    """Nothing changes it after it was checked."""
    with pytest.raises(FrozenInstanceError):
        RunConfig().seed = 3  # type: ignore[misc]


@pytest.mark.parametrize(
    ("variant", "sampling", "planner", "mask", "saec", "projection", "shield"),
    [
        ("ppo_uniform", "uniform", False, False, "off", "none", False),
        ("fsm_replay", "balanced", False, False, "off", "none", False),
        ("diffusion", "balanced", True, False, "off", "none", False),
        ("irl_dal", "balanced", True, True, "label", "none", False),
        ("shielded", "balanced", True, True, "label", "final", True),
        ("paper", "balanced", True, True, "paper", "none", False),
    ],
)
def test_variants_add_one_part_after_the_other(
    variant: str,
    sampling: str,
    planner: bool,
    mask: bool,
    saec: str,
    projection: str,
    shield: bool,
) -> None:
    """Each variant has the switches of the paper's table, ours has projection and shield on top."""
    config = composed(f"variant={variant}")
    assert config.variant == variant
    assert config.learning.sampling == sampling
    assert config.planner.enabled is planner
    assert config.perception.adaptive_mask is mask
    assert config.learning.saec == saec
    assert config.planner.projection == projection
    assert config.shield.enabled is shield


@pytest.mark.parametrize("variant", ["ppo_uniform", "fsm_replay", "diffusion", "irl_dal", "paper"])
def test_only_ours_asks_the_planner_otherwise_than_the_paper(variant: str) -> None:
    """A trigger by prediction and further steps of guidance are ours."""
    theirs, ours = composed(f"variant={variant}"), composed("variant=shielded")
    assert (theirs.shield.trigger.form, ours.shield.trigger.form) == ("printed", "predicted")
    assert theirs.planner.guidance.max_final_iterations <= 1
    assert ours.planner.guidance.max_final_iterations > 1


def test_the_paper_preset_is_everything_as_printed() -> None:
    """Printed schedule, energies, mask, reward and Eq. 28, with Table II's numbers."""
    config = composed("preset=paper")
    assert (config.variant, config.preset) == ("paper", "paper")
    planner, learning = config.planner, config.learning
    assert (planner.schedule, planner.sampler, planner.energy.forms) == (
        "printed",
        "ddpm",
        "printed",
    )
    assert config.perception.normalisation == "printed"
    assert (learning.reward.form, learning.saec) == ("printed", "paper")
    assert (learning.imitation_steps, learning.mixed_steps) == (20_000, 30_000)
    assert (planner.horizon, planner.diffusion_steps) == (8, 100)


def test_the_smoke_preset_is_small_and_still_has_every_part() -> None:
    """A few hundred steps per phase, every update due at least once, two episodes."""
    learning = composed("preset=smoke").learning
    assert learning.total_steps <= 1_000
    for interval in ("bc_interval_imitation", "diffusion_interval"):
        assert getattr(learning, interval) <= learning.imitation_steps
    for interval in ("bc_interval_mixed", "discriminator_interval", "sync_interval"):
        assert getattr(learning, interval) <= learning.mixed_steps
    assert learning.mixed_steps % learning.ppo.n_steps == 0
    assert composed("preset=smoke").evaluation.episodes == 2


def test_the_command_line_has_the_last_word() -> None:
    """A stated group or value wins against a preset."""
    config = composed("preset=paper", "variant=shielded", "learning.mixed_steps=8", "seed=3")
    assert (config.variant, config.learning.mixed_steps, config.seed) == ("shielded", 8, 3)


def test_shared_quantities_are_stated_once() -> None:
    """The fastest speed and the LiDAR's range reach every part that needs them."""
    config = composed("limits.max_speed=9", "env.lidar_range=30")
    assert config.perception.max_speed == 9.0
    assert config.env.scanner.max_range == 30.0


@pytest.mark.parametrize(
    ("override", "named"),
    [
        ("limits.min_speed=13", ["limits.min_speed", "13"]),
        ("planner.horizon=0", ["planner.horizon", "0"]),
        ("seed=abc", ["seed", "'abc'"]),
        ("seed=1.5", ["seed", "1.5"]),
        ("seed=-1", ["seed", "-1"]),
        ("limits.max_speed=fast", ["limits.max_speed", "'fast'"]),
        ("limits.max_speed=nan", ["limits.max_speed", "nan"]),
        ("learning.sampling=often", ["learning.sampling", "'often'"]),
        ("learning.ppo.gamma=1.5", ["learning.ppo.gamma", "1.5"]),
        ("env.reward=3", ["env.reward", "3"]),
        ("env.min_brightness=2", ["env.min_brightness", "2"]),
        ("+env.lanes=3", ["env.lanes", "3"]),
        ("evaluation.episodes=-1", ["evaluation.episodes", "-1"]),
        ("evaluation.first_seed=-5", ["evaluation.first_seed", "-5"]),
        ("shield.solver=OSQP", ["shield.solver", "'OSQP'", "osqp"]),
        ("shield.solver=null", ["shield.solver", "None"]),
        ("env.lidar_range=${nowhere}", ["env.lidar_range", "nowhere"]),
        ("planner.activation=sometimes", ["planner.activation", "'sometimes'"]),
    ],
)
def test_impossible_values_are_named(override: str, named: list[str]) -> None:
    """One line with the full key and the value."""
    with pytest.raises(ConfigError) as caught:
        composed(override)
    line = str(caught.value)
    assert "\n" not in line
    for part in named:
        assert part in line


@pytest.mark.parametrize(
    ("key", "meant"),
    [
        ("shield.max_speed", "limits.max_speed"),
        ("supervision.activation", "planner.activation"),
        ("planner.horizons", "planner.horizon"),
        ("learning.gamma", "learning.ppo.gamma"),
    ],
)
def test_an_unknown_key_is_answered_with_the_nearest_known_one(key: str, meant: str) -> None:
    """By its last part first: that is what remains of a key that moved to another section."""
    assert did_you_mean(key) == f"; did you mean {meant}?"
    with pytest.raises(ConfigError, match=r"shield\.max_speed = 9: .* mean limits\.max_speed\?"):
        parse({"shield": {"max_speed": 9}})


def test_the_configuration_fits_in_two_hundred_fields() -> None:
    """A number that nobody should turn is a constant beside its code, with unit and reason."""
    names = set()
    for package in (irl_dal, expert, shield):
        for module in walk_packages(package.__path__, f"{package.__name__}."):
            if module.name.endswith("__main__"):
                continue
            for name, kind in vars(import_module(module.name)).items():
                if name.endswith("Config") and is_dataclass(kind):
                    names |= {f"{name}.{entry.name}" for entry in fields(kind)}
    assert len(names) > 100, "the search is broken"
    assert len(names) <= MAX_FIELDS, sorted(names)


def test_the_solver_of_the_shield_is_that_of_every_projector(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The planner's projections too."""
    solvers = []
    build = HorizonProjector.__init__

    def record(self: HorizonProjector, *arguments: Any, **named: Any) -> None:
        solvers.append(signature(build).bind(self, *arguments, **named).arguments.get("solver"))
        build(self, *arguments, **named)

    monkeypatch.setattr(HorizonProjector, "__init__", record)
    config = composed("shield.solver=daqp")
    supervision(config, build_planner(config))
    assert len(solvers) >= 3 and set(solvers) == {"daqp"}


def test_an_empty_section_is_no_section() -> None:
    """Where a file lost its values, the defaults do not take their place."""
    for mapping in ({"shield": {}}, {"shield": {"trigger": {}}}):
        with pytest.raises(ConfigError, match="shield.* is empty"):
            parse(mapping)


def test_the_sections_are_the_groups() -> None:
    """A section is the dataclass of its part, field by field: no mapping stands between."""
    mapping = to_mapping(RunConfig())
    for group in GROUPS:
        assert list(mapping[group]) == [entry.name for entry in fields(getattr(RunConfig(), group))]


def test_evaluation_never_uses_a_training_seed() -> None:
    """An extent that reaches the training's seeds is refused."""
    first = RunConfig().learning.first_seed
    assert composed(f"evaluation.first_seed={first - 20}", "evaluation.episodes=20")
    with pytest.raises(ConfigError, match=r"evaluation\.first_seed"):
        composed(f"evaluation.first_seed={first - 19}", "evaluation.episodes=20")


def test_the_hash_says_which_runs_can_be_compared() -> None:
    """Seed and evaluation do not change it; whatever changes the training does."""
    config = RunConfig()
    same = replace(config, seed=9, evaluation=replace(config.evaluation, episodes=3))
    other = replace(config, limits=replace(config.limits, max_speed=11.0))
    assert config_hash(config) == config_hash(same)
    assert config_hash(config) != config_hash(other)
    assert len(config_hash(config)) == 12


def test_every_group_has_its_base_and_a_default() -> None:
    """Each section is a Hydra group, each known key belongs to one."""
    for group in GROUPS:
        assert (Path(CONFIG_FOLDER) / group / "default.yaml").is_file()
    keys = known_keys()
    assert "shield.trigger.form" in keys and "planner.blend.base" in keys
    assert {key.split(".")[0] for key in keys} == {*GROUPS, "seed", "variant", "preset"}
