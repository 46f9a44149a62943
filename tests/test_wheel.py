"""The wheel, installed in an empty environment outside the checkout."""

import os
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200)]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the programs of an environment that holds the wheel.

    Foreign packages are those of the environment of the tests: its own links to the checkout are
    not followed, because only an environment's own folder is searched for them.
    """
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    wheel = [*pip, "wheel", str(ROOT), "--no-deps", "--quiet", "--wheel-dir", str(folder)]
    subprocess.run(wheel, check=True, cwd=folder)
    (archive,) = folder.glob("irl_dal-*.whl")
    venv.create(folder / "env", with_pip=False)
    programs = folder / "env" / "bin"
    python = programs / "python"
    subprocess.run(
        [*pip, "--python", str(python), "install", "--quiet", "--no-deps", str(archive)],
        check=True,
        cwd=folder,
    )
    (own,) = (folder / "env" / "lib").glob("python*/site-packages")
    (own / "foreign.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return programs


def call(folder: Path, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run a program in a folder that knows nothing of the checkout."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    return subprocess.run(
        [str(argument) for argument in arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
    )


def test_the_wheel_holds_three_packages_and_its_configuration(
    installed: Path, tmp_path: Path
) -> None:
    """Imported from the environment, not from the checkout; no top-level name but ours."""
    code = (
        "import shield, expert, irl_dal; print(shield.__file__, expert.__file__, irl_dal.__file__)"
    )
    done = call(tmp_path, installed / "python", "-c", code)
    assert done.returncode == 0, done.stderr
    own = installed.parent / "lib"
    assert all(Path(file).is_relative_to(own) for file in done.stdout.split())
    (packages,) = own.glob("python*/site-packages")
    assert (packages / "irl_dal" / "configs" / "train.yaml").is_file()
    names = {entry.name for entry in packages.iterdir() if entry.is_dir()}
    assert {name for name in names if "." not in name} == {"irl_dal", "expert", "shield"}


def test_the_wheel_trains(installed: Path, tmp_path: Path) -> None:
    """`python -m irl_dal.train preset=smoke` ends with an evaluation."""
    done = call(tmp_path, installed / "python", "-m", "irl_dal.train", "preset=smoke", "run_dir=R")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "R" / "evaluation.json").is_file()


@pytest.mark.parametrize("command", ["train", "evaluate", "compare", "report"])
def test_the_commands_do_not_look_into_the_working_folder(
    installed: Path, tmp_path: Path, command: str
) -> None:
    """As programs they work where a file has the name of one of our packages."""
    (tmp_path / "expert.py").write_text("raise RuntimeError('not ours')")
    done = call(tmp_path, installed / f"irl-dal-{command}", "seed=abc", "shield.solver=no")
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1, done.stderr
