import json
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import pytest

from irl_dal.config import ConfigError, RunConfig, config_hash
from irl_dal.storage.run_folder import create_run, default_run_dir, open_run, provenance

CONFIG = replace(RunConfig(), seed=4, variant="irl_dal")


def test_a_run_folder_is_read_back(tmp_path: Path) -> None:
    """It holds the configuration, where it comes from, and nothing else yet."""
    path = tmp_path / "runs" / "one"
    create_run(path, CONFIG)
    folder = open_run("run", path)
    assert folder.config == CONFIG and folder.path == path
    assert not folder.has_checkpoint
    started = json.loads((path / "run.json").read_text())
    assert started["config_hash"] == config_hash(CONFIG)
    assert sorted(entry.name for entry in path.iterdir()) == ["config.yaml", "run.json"]
    assert [entry.name for entry in path.parent.iterdir()] == ["one"]


def test_a_run_folder_is_never_overwritten(tmp_path: Path) -> None:
    """An existing folder is refused and left alone."""
    path = tmp_path / "one"
    create_run(path, CONFIG)
    before = (path / "run.json").read_bytes()
    with pytest.raises(ConfigError, match="run_dir = .*exists already"):
        create_run(path, RunConfig())
    assert (path / "run.json").read_bytes() == before


def test_default_names_tell_runs_apart() -> None:
    """Date, time, variant and seed."""
    name = default_run_dir(CONFIG, datetime(2026, 11, 22, 3, 4, 5))
    assert name == Path("runs/20261122-030405-irl_dal-seed4")


def test_folders_that_are_no_runs_are_named(tmp_path: Path) -> None:
    """Missing, empty, foreign, of another version, damaged: one line with key and folder."""
    cases = {name: tmp_path / name for name in ("missing", "empty", "foreign", "other", "damaged")}
    cases["empty"].mkdir()
    cases["foreign"].mkdir()
    (cases["foreign"] / "letter.txt").write_text("dear")
    for name in ("other", "damaged"):
        create_run(cases[name], CONFIG)
    (cases["other"] / "run.json").write_text('{"format": 99}')
    (cases["damaged"] / "config.yaml").write_text("env: [")
    words = {
        "missing": "no such folder",
        "empty": "empty",
        "foreign": "run.json is missing",
        "other": "format 99",
        "damaged": "config.yaml is damaged",
    }
    for name, path in cases.items():
        with pytest.raises(ConfigError, match=words[name]) as caught:
            open_run("resume", path)
        line = str(caught.value)
        assert line.startswith(f"resume = '{path}'") and "\n" not in line


def test_a_changed_file_in_a_run_folder_is_checked(tmp_path: Path) -> None:
    """A configuration edited into nonsense is refused like one from the command line."""
    path = tmp_path / "one"
    create_run(path, CONFIG)
    text = (path / "config.yaml").read_text().replace("horizon: 8", "horizon: 7")
    (path / "config.yaml").write_text(text)
    with pytest.raises(ConfigError, match=r"planner\.horizon.*Got 7"):
        open_run("run", path)


@pytest.mark.parametrize(
    "content", ["shield:\n", "shield: [1]\nplanner: {}\n", "env: null\n", "learning: {}\n", "- a\n"]
)
def test_a_damaged_section_names_the_run(tmp_path: Path, content: str) -> None:
    """Empty, a list, missing: never the defaults in its place."""
    path = tmp_path / "one"
    create_run(path, CONFIG)
    (path / "config.yaml").write_text(content)
    with pytest.raises(ConfigError, match="config.yaml") as caught:
        open_run("run", path)
    line = str(caught.value)
    assert line.startswith(f"run = '{path}'") and "\n" not in line


@pytest.mark.parametrize(
    ("old", "new"),
    [("trigger:", "trigger: null\n  other:"), ("limits:\n", "limits: []\nother:\n")],
)
def test_a_section_within_a_run_that_is_none_names_the_run(
    tmp_path: Path, old: str, new: str
) -> None:
    """Whatever else the file says."""
    path = tmp_path / "one"
    create_run(path, CONFIG)
    text = (path / "config.yaml").read_text()
    assert old in text
    (path / "config.yaml").write_text(text.replace(old, new))
    with pytest.raises(ConfigError, match=f"run = '{path}': config.yaml"):
        open_run("run", path)


def test_an_unknown_key_or_section_of_a_run_is_refused(tmp_path: Path) -> None:
    """A version that does not know a key cannot know what the run did with it."""
    path = tmp_path / "one"
    create_run(path, CONFIG)
    text = (path / "config.yaml").read_text()
    (path / "config.yaml").write_text(text + "supervision:\n  activation: always\n")
    with pytest.raises(ConfigError, match="one.*supervision.activation.*no such key"):
        open_run("run", path)


def test_a_run_folder_that_cannot_be_made_leaves_nothing(tmp_path: Path) -> None:
    """Below a file, or with a name that is too long: one line with the key."""
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file" / "R", tmp_path / ("n" * 300)):
        with pytest.raises(ConfigError, match="run_dir = .*cannot be made"):
            create_run(path, CONFIG)
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]


def test_provenance_is_complete() -> None:
    """Hash, commit and version are there, the commit is one or says that it is unknown."""
    origin = provenance(CONFIG)
    assert set(origin) == {"config_hash", "commit", "version"}
    commit = origin["commit"].removesuffix("-dirty")
    assert commit == "unknown" or (len(commit) == 40 and int(commit, 16) >= 0)
