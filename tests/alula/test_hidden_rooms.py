"""A user's own folder or file with the name of one of Alula's packages breaks nothing, or is refused by its name."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import pytest

from alula.rooms import ROOMS, ROOT

Make = Callable[[Path, str], None]
SCRIPT = "from alula.__main__ import main; import sys; sys.argv[0] = 'alula'; main()"


def run(folder: Path, *arguments: str, path: tuple[str, ...] = ()) -> subprocess.CompletedProcess[str]:
    """Python in a user's folder, with our checkout behind whatever the user has on the path."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([*path, ROOT])}
    command = [sys.executable, *arguments]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=250, check=False
    )


def own_package(folder: Path, room: str) -> None:
    (folder / room).mkdir()
    (folder / room / "__init__.py").write_text("raise RuntimeError('a package of the user')\n")


def own_file(folder: Path, room: str) -> None:
    (folder / f"{room}.py").write_text("raise RuntimeError('a file of the user')\n")


def own_folder(folder: Path, room: str) -> None:
    (folder / room).mkdir()
    (folder / room / "notes.txt").write_text("no Python in here\n")


MAKERS = (own_package, own_file, own_folder)


@pytest.mark.parametrize("make", MAKERS)
def test_as_a_module_alula_starts_beside_folders_and_files_of_any_name(tmp_path: Path, make: Make) -> None:
    for room in (*ROOMS, "tests", "fixtures", "benchmarks"):
        make(tmp_path, room)
    done = run(tmp_path, "-m", "alula", "mock", "--vehicle", "absent.toml")
    assert done.returncode == 2
    assert "there is no vehicle file absent.toml" in done.stderr
    assert "Traceback" not in done.stderr


def test_export_runs_beside_a_folder_called_export(tmp_path: Path) -> None:
    own_folder(tmp_path, "export")
    done = run(tmp_path, "-m", "alula", "export", "absent.toml", "--out", "bundle")
    assert done.returncode == 2
    assert "there is no vehicle file absent.toml" in done.stderr


def test_the_script_starts_beside_folders_of_any_name(tmp_path: Path) -> None:
    script = Path(sys.executable).with_name("alula")
    if not script.exists():
        pytest.skip("the command is not installed beside this Python")
    for room in ROOMS:
        own_package(tmp_path, room)
    environment = {**os.environ, "PYTHONPATH": ROOT}
    done = subprocess.run(
        [script, "--version"], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(find_spec("torch") is None, reason="torchrun comes with torch")
def test_torchrun_starts_beside_folders_of_any_name(tmp_path: Path) -> None:
    for room in ROOMS:
        own_package(tmp_path, room)
    start = ("-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", "--no-python")
    python = (sys.executable, "-u", "-m", "alula", "--version")
    done = run(tmp_path, *start, *python)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("alula ") == 2


@pytest.mark.parametrize("room", ["dynamics", "export", "runtime", "studio", "training", "vehicles"])
@pytest.mark.parametrize("make", [own_package, own_file])
def test_a_room_hidden_by_pythonpath_is_refused_by_the_folders_name(tmp_path: Path, room: str, make: Make) -> None:
    make(tmp_path, room)
    for arguments in (["-m", "alula", "--help"], ["-c", SCRIPT, "--help"]):
        done = run(tmp_path, *arguments, path=(str(tmp_path),))
        assert done.returncode == 2
        assert str(tmp_path / room) in done.stderr
        assert "Rename it" in done.stderr
        assert "Traceback" not in done.stderr


def test_a_script_beside_a_folder_that_hides_a_room_is_refused(tmp_path: Path) -> None:
    own_package(tmp_path, "export")
    own_file(tmp_path, "training")
    (tmp_path / "mine.py").write_text("import alula\nprint('imported')\n")
    done = run(tmp_path, "mine.py")
    assert done.returncode == 2
    assert done.stdout == ""
    for name in ("export", "training.py"):
        assert f"{tmp_path / name} hides" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_script_beside_folders_of_other_names_imports_alula(tmp_path: Path) -> None:
    own_package(tmp_path, "tests")
    own_file(tmp_path, "flight")
    (tmp_path / "mine.py").write_text("import alula\nprint(alula.Vehicle.__name__)\n")
    done = run(tmp_path, "mine.py")
    assert (done.returncode, done.stderr) == (0, "")


def test_an_interactive_session_gets_an_import_error_and_continues(tmp_path: Path) -> None:
    own_package(tmp_path, "export")
    code = "import sys; sys.ps1 = '>>> '\ntry:\n    import alula\nexcept ImportError as error:\n    print(error)\n"
    done = run(tmp_path, "-c", code)
    assert done.returncode == 0
    assert f"{tmp_path / 'export'} hides" in done.stdout


def test_a_checkout_runs_from_its_own_folder() -> None:
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    code = "import alula, dynamics; print(alula.__file__, dynamics.__file__)"
    for arguments in (["-c", code], ["-m", "alula", "--version"]):
        done = subprocess.run(
            [sys.executable, *arguments], cwd=ROOT, env=environment, capture_output=True, text=True, check=False
        )
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout.count(ROOT) == (2 if "-c" in arguments else 0)
