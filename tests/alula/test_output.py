"""What commands print: the next command as the last line, quietly, into a file; completion of the shell."""

import ast
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from alula.cli import app
from alula.cli.output import options, split_output

START = "import sys; sys.argv[0] = 'alula'; from alula.__main__ import main; main()"


def alula(*words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """The command line as a process."""
    return subprocess.run(
        [sys.executable, "-c", START, *words],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **environment},
    )


@pytest.mark.parametrize("name", app.COMMANDS)
def test_every_command_names_the_next_one(name: str) -> None:
    tree = ast.parse(Path(f"alula/cli/{name}.py").read_text(encoding="utf-8"))
    calls = {node.func.id for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)}
    assert calls & {"print_next", "command"}


@pytest.mark.parametrize(
    "words", [("effects",), ("effects", "weak_rotor", "--vehicle", "crazyflie"), ("vehicle", "show", "px4_sih")]
)
def test_the_last_line_is_a_command_that_the_command_line_takes(words: tuple[str, ...], tmp_path: Path) -> None:
    if words[0] == "vehicle":
        words += ("--out", str(tmp_path / "a.svg"))
    last = alula(*words).stdout.strip().splitlines()[-1]
    match = re.fullmatch(r"next: alula (\w+) (.*)", last)
    assert match, last
    app.load(match.group(1)).make_context(match.group(1), shlex.split(match.group(2)))


def test_options_of_output_stand_anywhere_before_a_double_dash() -> None:
    rest, output = split_output(["-q", "effects", "--log-file", "a.txt", "mass", "-v", "--", "-q"])
    assert rest == ["effects", "mass", "--", "-q"]
    assert (output.quiet, output.verbose, output.log_file) == (True, True, "a.txt")


def test_values_become_options() -> None:
    assert options([("--a", None), ("--b", 1), ("--c", ["x", Path("y")]), ("--d", [])]) == [
        "--b",
        "1",
        "--c",
        "x",
        "--c",
        "y",
    ]


def test_quiet_leaves_errors_and_json_alone() -> None:
    assert alula("-q", "effects", "mass").stdout == ""
    assert alula("effects", "mass", "--json", "-", "-q").stdout.startswith("[")
    assert "unknown effect" in alula("-q", "effects", "mas").stderr


def test_a_log_file_holds_command_output_and_exit_code(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    done = alula("effects", "mass", "--log-file", str(path))
    assert done.stdout in path.read_text()
    alula("-q", "effects", "mas", "--log-file", str(path))
    text = path.read_text()
    assert "alula effects mass\n" in text
    assert "unknown effect 'mas'" in text
    assert [line.split(" after")[0] for line in text.splitlines() if "exit code" in line] == [
        "# exit code 0",
        "# exit code 2",
    ]
    assert alula("effects", "--log-file", str(tmp_path / "no" / "log.txt")).returncode == 2


def test_verbose_shows_where_an_error_came_from() -> None:
    assert "Traceback" not in alula("effects", "mas").stderr
    shown = alula("-v", "effects", "mas").stderr
    assert "Traceback" in shown
    assert "exit code 2" in shown


@pytest.mark.parametrize(
    ("line", "word"),
    [("alula diag", "diagnose"), ("alula vehicle from", "from-log"), ("alula add --hold", "--hold-out")],
)
def test_commands_and_options_are_completed(line: str, word: str) -> None:
    count = str(len(line.split()) - 1)
    done = alula(_ALULA_COMPLETE="complete_bash", COMP_WORDS=line, COMP_CWORD=count)
    assert done.stdout.split() == [word]


SOURCED = {"bash": "source_bash", "zsh": "source_zsh", "fish": "source_fish"}  # as docs/install.md has it


@pytest.mark.parametrize("shell", SOURCED)
def test_each_shell_gets_a_script_without_anything_being_installed(shell: str, tmp_path: Path) -> None:
    page = Path("docs/install.md").read_text(encoding="utf-8")
    assert f"_ALULA_COMPLETE={SOURCED[shell]} alula" in page
    script = alula(_ALULA_COMPLETE=SOURCED[shell], HOME=str(tmp_path)).stdout
    assert "alula" in script
    assert f"complete_{shell}" in script
    assert not list(tmp_path.iterdir())
    if (program := shutil.which(shell)) is not None:
        checked = subprocess.run([program, "-n"], input=script, capture_output=True, text=True, check=False)
        assert checked.returncode == 0, checked.stderr


def test_installing_the_completion_writes_into_the_home_alone(tmp_path: Path) -> None:
    done = alula("--install-completion", "bash", HOME=str(tmp_path), _TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION="1")
    assert done.returncode == 0, done.stderr
    written = {path.name: path.read_text(encoding="utf-8") for path in tmp_path.rglob("*") if path.is_file()}
    assert "complete_bash" in written["alula.sh"]
    assert "alula.sh" in written[".bashrc"]


@pytest.mark.parametrize("words", [("--no-effects", "--effect", "mass"), ("--all", "--manoeuvre", "Lemniscate")])
def test_a_demo_of_contradictory_options_is_refused(words: tuple[str, ...]) -> None:
    done = alula("demo", *words)
    assert done.returncode == 2
    assert "contradict each other" in done.stderr


def test_a_rotor_that_is_not_there_is_a_wrong_request() -> None:
    log = "tests/data/px4_sih_flights/textbook_1_circle.ulg.gz"
    done = alula("add", "weak_rotor", log, "--vehicle", "px4_sih", "--rotor", "9")
    assert done.returncode == 2
    assert "give rotor = 0 to 3, not 9" in done.stderr
