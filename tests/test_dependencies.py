"""What is imported is declared, what is declared is used."""

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from pathlib import Path

from irl_dal.cli.preflight import EXTRAS

ROOT = Path(__file__).resolve().parents[1]
OURS = {"irl_dal", "expert", "shield", "tests"}
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

UNIMPORTED = {
    "hydra-joblib-launcher": "Hydra finds it as a plugin",
    "imageio-ffmpeg": "imageio finds it as a plugin",
    "tensorboard": "torch.utils.tensorboard imports it",
    "pandas": "bounded for rliable",
}
"""Declared, though no file imports it."""

DECLARED_IN_TEST = {"highway-env", "diffusers"}
"""Peers that the benchmarks drive where they are installed."""


def declared(*extras: str) -> set[str]:
    """Distributions of the core and of some extras, with what those pull."""
    names, todo = set(), [*PROJECT["dependencies"]]
    for extra in extras:
        todo += PROJECT["optional-dependencies"][extra]
    for requirement in todo:
        pulled = re.match(r"irl-dal\[(.*)\]", requirement)
        names |= declared(*pulled[1].split(",")) if pulled else {_distribution(requirement)}
    return names


def _distribution(requirement: str) -> str:
    return re.split(r"[\[<>=!~; ]", requirement)[0].lower().replace("_", "-")


def imported(*folders: str) -> dict[str, set[str]]:
    """Foreign distributions that the files of some folders import, and in which files."""
    where = packages_distributions()
    found: dict[str, set[str]] = {}
    for folder in folders:
        for file in (ROOT / folder).rglob("*.py"):
            for module in _modules(file):
                if module not in OURS | sys.stdlib_module_names:
                    name = _distribution(where.get(module, [module])[0])
                    found.setdefault(name, set()).add(str(file.relative_to(ROOT)))
    return found


def _modules(file: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module.split(".")[0]


def test_shield_and_expert_need_the_core_alone() -> None:
    """`gymnasium` is for `shield.gym`, `matplotlib` for the figures of `shield.bench`."""
    extra = {"gymnasium": "shield/gym/", "matplotlib": "shield/bench/"}
    for name, files in imported("shield", "expert").items():
        allowed = name in declared() or all(f.startswith(extra.get(name, "?")) for f in files)
        assert allowed, (name, files)


def test_every_import_is_declared() -> None:
    """By the extra that its command needs; tests may use what `test` brings."""
    drive, report = declared("drive"), declared("report")
    for name, files in imported("irl_dal").items():
        if name in DECLARED_IN_TEST:
            continue
        sweep = all(file.startswith(("irl_dal/sweep", "irl_dal/figures/sweep")) for file in files)
        assert name in (report if sweep else drive), (name, files)
    undeclared = set(imported("tests", "examples")) - declared("test")
    assert not undeclared


def test_every_declared_dependency_is_used() -> None:
    """Or known to be used without an import."""
    used = set(imported("irl_dal", "expert", "shield"))
    assert declared("report") - used - set(UNIMPORTED) == set()


def test_preflight_asks_for_what_the_extras_bring() -> None:
    """A module that the core does not bring is looked for before it is imported."""
    where = packages_distributions()
    asked = {_distribution(where[module][0]) for names in EXTRAS.values() for module in names}
    assert asked | declared() | set(UNIMPORTED) >= declared("report")
    assert asked <= declared("report")


def test_the_tests_bring_all_that_is_tested() -> None:
    """`make test` needs one extra."""
    assert declared("test") >= declared("drive", "report", "gym")
