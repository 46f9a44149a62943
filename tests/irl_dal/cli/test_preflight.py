import ast
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import irl_dal
from irl_dal.cli.preflight import EXTRAS, preflight

ROOT = Path(irl_dal.__file__).resolve().parents[1]


@pytest.mark.parametrize("name", ["expert.py", "shield/__init__.py"])
@pytest.mark.parametrize("command", ["train", "evaluate", "compare", "report", "bench"])
def test_a_file_that_hides_a_package_is_named(tmp_path: Path, command: str, name: str) -> None:
    """`python -m` looks into the working folder first, and our names are everyday ones."""
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("x = 1\n")
    done = subprocess.run(
        [sys.executable, "-m", f"irl_dal.{command}"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    (line,) = done.stderr.splitlines()
    assert done.returncode == 2 and str(tmp_path / name) in line and "irl-dal-" in line


def test_a_missing_module_is_answered_with_what_brings_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One line with pip's, exit code 2."""
    preflight(*EXTRAS)
    monkeypatch.setitem(EXTRAS, "drive", ("numpy", "no_such_module"))
    with pytest.raises(SystemExit) as end:
        preflight("drive")
    assert end.value.code == 2
    line = "error: no_such_module is not installed: pip install 'irl-dal[drive]'\n"
    assert capsys.readouterr().err == line


def test_preflight_needs_only_the_standard_library() -> None:
    """Else the import of what names the missing module would fail first."""
    for name in ("__init__.py", "cli/__init__.py", "cli/preflight.py"):
        tree = ast.parse((ROOT / "irl_dal" / name).read_text())
        for node in ast.walk(tree):
            if isinstance(node, ast.Import | ast.ImportFrom):
                modules = [alias.name for alias in node.names]
                if isinstance(node, ast.ImportFrom):
                    modules = [node.module or ""]
                assert {module.split(".")[0] for module in modules} <= sys.stdlib_module_names


@pytest.mark.parametrize(
    ("command", "module", "extra"),
    [
        ("train", "hydra", "drive"),
        ("evaluate", "torch", "drive"),
        ("compare", "pydantic", "drive"),
        ("report", "rliable", "report"),
        ("bench", "pybullet", "drive"),
    ],
)
def test_a_command_names_the_extra_that_it_lacks(command: str, module: str, extra: str) -> None:
    """Without a traceback, before anything else is imported."""
    code = (
        f"import runpy, sys; sys.modules[{module!r}] = None;"
        f"runpy.run_module('irl_dal.{command}', run_name='__main__', alter_sys=True)"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True
    )
    (line,) = done.stderr.splitlines()
    assert done.returncode == 2 and line.endswith(f"pip install 'irl-dal[{extra}]'")


INTERRUPTED_IMPORT = """
import os, runpy, signal, sys
class Terminal:
    def find_spec(name, path=None, target=None):
        if name == {module!r}:
            try:
                os.kill(os.getpid(), signal.SIGINT)
            except BaseException:
                pass  # libraries do that
            raise KeyboardInterrupt
sys.meta_path.insert(0, Terminal)
signal.signal(signal.SIGINT, signal.default_int_handler)
{start}
"""
"""A process in which Ctrl-C is typed while `module` is imported."""


@pytest.mark.parametrize(
    ("command", "module"),
    [
        ("train", "omegaconf.base"),
        ("evaluate", "omegaconf.base"),
        ("compare", "omegaconf.base"),
        ("report", "omegaconf.base"),
        ("bench.__main__", "rich.console"),
    ],
)
@pytest.mark.parametrize(
    "start", ["runpy.run_module({0!r}, run_name='__main__', alter_sys=True)", "import {0}"]
)
def test_ctrl_c_while_modules_are_imported_is_one_line(
    command: str, module: str, start: str
) -> None:
    """With `python -m` as with the console scripts; nothing has begun that could be lost."""
    code = INTERRUPTED_IMPORT.format(module=module, start=start.format(f"irl_dal.{command}"))
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "interrupted\n")


def test_ctrl_c_raises_again_after_the_imports(monkeypatch: pytest.MonkeyPatch) -> None:
    """From where a command has its `main`, which tidies up; a process that ignores it goes on."""
    module = ModuleType("command")
    monkeypatch.setitem(sys.modules, "command", module)
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        preflight(command="command")
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
        signal.signal(signal.SIGINT, signal.default_int_handler)
        preflight(command="command")
        monkeypatch.setattr(module, "main", None, raising=False)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)
