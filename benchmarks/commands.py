"""The commands: what each does with bad input, and size and start of the flight computer's install."""

from __future__ import annotations

import gzip
import re
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import distributions
from pathlib import Path

import numpy as np

from benchmarks.measurement import ROOT, Page, options_of
from dynamics.vehicle_file import read_vehicle
from fixtures.planted import planted_flights
from flights import Flight
from flights.parallel import parallel_map
from vehicles import FOLDER

REQUEST, DATA, REFUSED = 2, 3, 4
MANOEUVRES = (
    "line:laps=3,ramp=1",
    "yaw_spin:laps=3,ramp=1",
    "bob:laps=4,ramp=1,height=0.25",
    "Lemniscate:laps=3,ramp=1",
)
PATIENCE = 300.0  # s for one command
Columns = dict[str, np.ndarray]


@dataclass(frozen=True)
class Case:
    """A command line that must be refused.

    group: what is bad. words: of the command, {here} for the folder. code: that it must end with.
    names: what the message must hold, without regard to case.
    """

    group: str
    words: tuple[str, ...]
    code: int
    names: str


@dataclass(frozen=True)
class Answer:
    """Outcome of a command line. wrong: why it does not count as handled, empty where it does."""

    case: Case
    code: int
    message: str
    wrong: str


# --- vehicle files: the bundled one with one thing spoilt ---------------------------------------------------------

VEHICLES: dict[str, tuple[Callable[[str], str], str]] = {
    "no_mass": (lambda t: re.sub(r"mass = .*\n", "", t, count=1), "mass"),
    "negative_mass": (lambda t: t.replace("mass = 0.25 ", "mass = -0.25 "), "mass"),
    "zero_mass": (lambda t: t.replace("mass = 0.25 ", "mass = 0.0 "), "mass"),
    "nan_mass": (lambda t: t.replace("mass = 0.25 ", "mass = nan "), "mass"),
    "text_mass": (lambda t: t.replace("mass = 0.25 ", 'mass = "250 g" '), "mass"),
    "two_inertias": (lambda t: t.replace("[6.01e-4, 5.89e-4, 1.076e-3]", "[6.01e-4, 5.89e-4]"), "inertia"),
    "negative_inertia": (lambda t: t.replace("6.01e-4", "-6.01e-4"), "inertia"),
    "unknown_key": (lambda t: t.replace("mass =", "weight =", 1), "weight"),
    "unknown_table": (lambda t: t + "\n[engine]\npower = 3\n", "engine"),
    "two_rotors": (lambda t: re.sub(r"position = .*\n", "position = [[0.1, 0, 0], [-0.1, 0, 0]]\n", t), "rotor"),
    "spin_of_two": (lambda t: t.replace("[1, -1, 1, -1]", "[2, -1, 1, -1]"), "spin"),
    "one_spin_less": (lambda t: t.replace("[1, -1, 1, -1]", "[1, -1, 1]"), "spin"),
    "no_thrust": (lambda t: t.replace("3.994e-7", "0.0"), "thrust_constant"),
    "too_weak": (lambda t: t.replace("3.994e-7", "3.994e-9"), "thrust"),
    "slow_rotors": (lambda t: t.replace("speed_min = 0.0 ", "speed_min = 2000.0 "), "speed"),
    "unknown_effect": (lambda t: t + '\n[[effects]]\nname = "warp"\n', "warp"),
    "unknown_parameter": (lambda t: t + '\n[[effects]]\nname = "mass"\n[effects.parameters]\nsize = 1\n', "size"),
    "outside_bounds": (lambda t: t + '\n[[effects]]\nname = "mass"\n[effects.parameters]\nratio = -3\n', "ratio"),
    "no_rotor": (lambda t: t + '\n[[effects]]\nname = "weak_rotor"\n[effects.parameters]\nloss = 0.1\n', "rotor"),
    "ninth_rotor": (
        lambda t: t + '\n[[effects]]\nname = "weak_rotor"\nrotor = 9\n[effects.parameters]\nloss = 0.1\n',
        "rotor",
    ),
    "twice": (lambda t: t + 2 * '\n[[effects]]\nname = "mass"\n[effects.parameters]\nratio = 1.1\n', "mass"),
    "empty": (lambda _: "", "name"),
    "no_toml": (lambda t: t.replace("[body]", "[body"), "toml"),
    "no_effect_file": (lambda t: t.replace("[body]", 'effect_files = ["gone.py"]\n[body]'), "gone.py"),
    "broken_effect_file": (lambda t: t.replace("[body]", 'effect_files = ["broken.py"]\n[body]'), "broken.py"),
}

# --- logs: a good flight with one thing spoilt --------------------------------------------------------------------


def scaled(factor: float, *names: str) -> Callable[[Columns], Columns]:
    """These quantities in another unit."""
    return lambda c: {k: v * factor if k.startswith(names) else v for k, v in c.items()}


def without(*names: str) -> Callable[[Columns], Columns]:
    """The log without these quantities."""
    return lambda c: {k: v for k, v in c.items() if not k.startswith(names)}


def renamed(pairs: dict[str, str]) -> Callable[[Columns], Columns]:
    """Columns under each other's names."""
    return lambda c: {k: c[pairs.get(k, k)] for k in c}


def filled(value: float, *names: str) -> Callable[[Columns], Columns]:
    """These quantities with one value."""
    return lambda c: {k: np.full_like(v, value) if k.startswith(names) else v for k, v in c.items()}


ROTORS = {f"rotor_speed_{i}": f"rotor_speed_{3 - i}" for i in range(4)}
COLUMNS: dict[str, tuple[Callable[[Columns], Columns], str]] = {
    "millimetres": (scaled(1e3, "position_x", "position_y", "position_z"), "position"),
    "degrees": (scaled(57.3, "rate_x", "rate_y", "rate_z"), "rate"),
    "in_g": (scaled(1 / 9.81, "specific_force"), "specific"),
    "neither_pose_nor_gyro": (without("attitude_", "rate_x", "rate_y", "rate_z"), "attitude"),
    "no_rotors": (without("rotor"), "rotor"),
    "rotors_reversed": (renamed(ROTORS), "rotor"),
    "scalar_last": (
        renamed(
            {
                "attitude_w": "attitude_x",
                "attitude_x": "attitude_y",
                "attitude_y": "attitude_z",
                "attitude_z": "attitude_w",
            }
        ),
        "attitude",
    ),
    "axes_swapped": (renamed({"rate_x": "rate_y", "rate_y": "rate_x"}), "rate"),
    "other_sign": (scaled(-1.0, "velocity_x", "velocity_y", "velocity_z"), "velocity"),
    "all_nan": (filled(np.nan, "position", "velocity", "attitude", "rate", "specific", "rotor"), ""),
    "infinite": (filled(np.inf, "specific_force_z"), "specific"),
    "rotors_stand": (filled(0.0, "rotor_speed"), "rotor"),
    "backwards": (lambda c: c | {"t": c["t"][::-1].copy()}, "time"),
    "one_time": (lambda c: c | {"t": np.zeros_like(c["t"])}, "time"),
    "at_5_hertz": (lambda c: {k: v[::20] for k, v in c.items()}, "hz"),
    "one_second": (lambda c: {k: v[:100] for k, v in c.items()}, "s"),
    "one_row": (lambda c: {k: v[:1] for k, v in c.items()}, ""),
    "no_rows": (lambda c: {k: v[:0] for k, v in c.items()}, "row"),
}

# files, the code that each is refused with, and what the message names: 2 for what is no log at all
TEXTS: dict[str, tuple[Callable[[bytes], bytes], int, str]] = {
    "empty.csv": (lambda _: b"", DATA, "empty"),
    "prose.csv": (lambda _: b"Dear all,\nhere is the flight.\nRegards\n", REQUEST, "column"),
    "bytes.csv": (lambda _: bytes(range(256)) * 20, REQUEST, ""),
    "ragged.csv": (lambda t: t.replace(b"\n", b",1,2\n", 40).replace(b",1,2\n", b"\n", 20), DATA, "row"),
    "decimal_comma.csv": (lambda t: t.replace(b",", b";").replace(b".", b","), REQUEST, "comma"),
    "words.csv": (lambda t: re.sub(rb"\n0\.5,[^,]*", b"\n0.5,north", t, count=1), DATA, "north"),
    "cut.csv.gz": (lambda t: gzip.compress(t)[:4000], DATA, "cut"),
    "no_gzip.csv.gz": (lambda t: t[:4000], REQUEST, "gz"),
    "cut.ulg": (lambda _: b"ULog\x01\x12\x35\x01" + bytes(8), DATA, "ulg"),
    "no_ulog.ulg": (lambda _: b"hello, world" * 50, REQUEST, "ulog"),
    "no_parquet.parquet": (lambda _: b"PAR1 and nothing more", DATA, "parquet"),
    "no_mcap.mcap": (lambda _: b"\x89MCAP0\r\n and nothing more", DATA, "mcap"),
    "no_time.csv": (lambda t: t.replace(b"t,", b"", 1), REQUEST, "column"),
}

# --- command lines ------------------------------------------------------------------------------------------------

GOOD = "{here}/good"
V = ("--vehicle", "arpl_250g")
LINES: tuple[Case, ...] = (
    Case("logs", ("diagnose", *V), REQUEST, "log"),
    Case("logs", ("diagnose", "{here}/nowhere.csv", *V), REQUEST, "nowhere.csv"),
    Case("logs", ("diagnose", "{here}/nothing_here", *V), REQUEST, "nothing_here"),
    Case("logs", ("diagnose", "{here}/*.nothing", *V), REQUEST, "*.nothing"),
    Case("logs", ("diagnose", "{here}/good/flight_0.csv", "{here}/good/flight_0.csv", *V), DATA, ""),
    Case("options", ("diagnose", GOOD), REQUEST, "--vehicle"),
    Case("options", ("diagnose", GOOD, "--vehicle", "{here}/gone.toml"), REQUEST, "gone.toml"),
    Case("options", ("diagnose", GOOD, "--vehicle", "{here}"), REQUEST, ""),
    Case("options", ("diagnose", GOOD, "--vehicle", "arpl_251g"), REQUEST, "arpl_251g"),
    Case("options", ("diagnose", GOOD, *V, "--hold-out", "nothing*"), REQUEST, "nothing*"),
    Case("options", ("diagnose", GOOD, *V, "--hold-out", "*"), REQUEST, "*"),
    Case("options", ("diagnose", GOOD, *V, "--pose", "sextant"), REQUEST, "sextant"),
    Case("options", ("diagnose", GOOD, *V, "--mapping", "{here}/gone.toml"), REQUEST, "gone.toml"),
    Case("options", ("diagnose", GOOD, *V, "--effects", "{here}/gone.py"), REQUEST, "gone.py"),
    Case("options", ("diagnose", GOOD, *V, "--effects", "{here}/broken.py"), REQUEST, "broken.py"),
    Case("options", ("diagnose", GOOD, *V, "--effects", "{here}/raises.py"), REQUEST, "raises.py"),
    Case("options", ("diagnose", GOOD, *V, "--json", "{here}/no/such/folder/a.json"), REQUEST, "a.json"),
    Case("options", ("diagnose", GOOD, *V, "--html", "{here}/no/such/folder/a.html"), REQUEST, "a.html"),
    Case("options", ("diagnoze", GOOD, *V), REQUEST, "diagnoze"),
    Case("options", ("diagnose", GOOD, *V, "--colour", "red"), REQUEST, "--colour"),
    Case("adding", ("add", "warp", GOOD, *V, "--out", "{here}/out.toml"), REQUEST, "warp"),
    Case("adding", ("add", "weak_rotor", GOOD, *V, "--rotor", "9", "--out", "{here}/out.toml"), REQUEST, "rotor"),
    Case("adding", ("add", "rotor_drag", GOOD, *V, "--rotor", "1", "--out", "{here}/out.toml"), REQUEST, "rotor"),
    Case("adding", ("add", "gust", GOOD, *V, "--out", "{here}/out.toml"), DATA, "gust"),
    Case("adding", ("add", "rotor_drag", *V, "--out", "{here}/out.toml"), REQUEST, "log"),
    Case("vehicle", ("vehicle", "new", "x", "--mass", "-1", "--arm", "0.2", "--propeller", "10in", "--kv", "900",
                     "--cells", "4", "--frame", "quad_x", "--out", "{here}/out.toml"), REQUEST, "mass"),
    Case("vehicle", ("vehicle", "new", "x", "--mass", "1 stone", "--arm", "0.2", "--propeller", "10in", "--kv", "900",
                     "--cells", "4", "--frame", "quad_x", "--out", "{here}/out.toml"), REQUEST, "stone"),
    Case("vehicle", ("vehicle", "new", "x", "--mass", "1", "--arm", "0.2", "--propeller", "10in", "--kv", "900",
                     "--cells", "4", "--frame", "tricycle", "--out", "{here}/out.toml"), REQUEST, "tricycle"),
    Case("vehicle", ("vehicle", "from-log", GOOD, "--out", "{here}/out.toml"), DATA, ""),
    Case("vehicle", ("vehicle", "from-log", "{here}/nowhere.ulg", "--out", "{here}/out.toml"), REQUEST, "nowhere.ulg"),
    Case("vehicle", ("vehicle", "show", "{here}/gone.toml"), REQUEST, "gone.toml"),
    Case("vehicle", ("vehicle", "check", "arpl_250g"), REQUEST, "log"),
    Case("vehicle", ("effects", "warp"), REQUEST, "warp"),
    Case("flying", ("fly", *V), REQUEST, "--reference"),
    Case("flying", ("fly", *V, "--reference", "loop_the_loop"), REQUEST, "loop_the_loop"),
    Case("flying", ("fly", *V, "--reference", "circle:speed=fast"), REQUEST, "fast"),
    Case("flying", ("fly", *V, "--reference", "circle:colour=1"), REQUEST, "colour"),
    Case("flying", ("fly", *V, "--reference", "circle:speed=80"), REQUEST, "speed"),
    Case("flying", ("fly", *V, "--reference", "{here}/gone.csv"), REQUEST, "gone.csv"),
    Case("flying", ("fly", *V, "--reference", "hover", "--height", "-2"), REQUEST, "--height"),
    Case("flying", ("fly", *V, "--reference", "hover", "--rate", "0"), REQUEST, "--rate"),
    Case("flying", ("fly", *V, "--reference", "hover", "--set", "colour=red"), REQUEST, "colour"),
    Case("flying", ("fly", *V, "--reference", "hover", "--link", "pigeon:12"), REQUEST, "pigeon"),
    Case("flying", ("fly", *V, "--reference", "hover", "--link", "udpin:127.0.0.1:99999"), REQUEST, "99999"),
    Case("flying", ("fly", *V, "--reference", "hover", "--link", "serial:/dev/ttyNONE:921600", "--timeout", "2"),
         REFUSED, "ttynone"),
    Case("flying", ("fly", *V, "--reference", "hover", "--link", "udpin:127.0.0.1:{port}", "--timeout", "2"),
         REFUSED, "{port}"),
    Case("flying", ("fly", "--bundle", "{here}/gone", "--reference", "hover"), REQUEST, "gone"),
    Case("flying", ("fly", "--bundle", "{here}/good", "--reference", "hover"), REQUEST, "good"),
    Case("flying", ("link", "--link", "udpin:127.0.0.1:{port}", "--timeout", "2"), REFUSED, "{port}"),
    Case("flying", ("link", "--link", "tcp:127.0.0.1:{port}", "--timeout", "2"), REFUSED, "{port}"),
    Case("flying", ("replay", "nothere"), REQUEST, "nothere"),
    Case("flying", ("replay", "{here}/no_mcap.mcap"), DATA, "no_mcap.mcap"),
    Case("flying", ("mock", "--vehicle", "gone"), REQUEST, "gone"),
    Case("flying", ("mock", *V, "--effect", "warp"), REQUEST, "warp"),
    Case("flying", ("mock", *V, "--effect", "mass:ratio=-1"), REQUEST, "ratio"),
    Case("flying", ("mock", *V, "--estimator", "sextant"), REQUEST, "sextant"),
    Case("flying", ("mock", *V, "--scenario", "{here}/gone.toml"), REQUEST, "gone.toml"),
    Case("flying", ("mock", *V, "--scenario", "{here}/no_toml.toml"), REQUEST, "no_toml.toml"),
    Case("flying", ("mock", *V, "--slope", "95"), REQUEST, "slope"),
    Case("flying", ("campaign", "--out", "{here}/out", "--flights", "nothing*"), REQUEST, "nothing*"),
    Case("flying", ("campaign", "--out", "{here}/empty.csv/out"), REQUEST, "out"),
    Case("flying", ("demo", "--all", "--manoeuvre", "hover", "--out", "{here}/out"), REQUEST, "--all"),
    Case("flying", ("demo", "--manoeuvre", "nonsense", "--out", "{here}/out"), REQUEST, "nonsense"),
    Case("learning", ("train", GOOD, *V, "--model", "gpt", "--out", "{here}/out.pt"), REQUEST, "gpt"),
    Case("learning", ("train", *V, "--model", "pi_tcn", "--out", "{here}/out.pt"), REQUEST, "log"),
    Case("learning", ("train", GOOD, *V, "--model", "pi_tcn", "--steps", "0", "--out", "{here}/out.pt"), REQUEST,
         "--steps"),
    Case("learning", ("train", GOOD, *V, "--model", "pi_tcn", "--recipe", "soup", "--out", "{here}/out.pt"), REQUEST,
         "soup"),
    Case("learning", ("train", GOOD, *V, "--model", "pi_tcn", "--device", "cuda:7", "--out", "{here}/out.pt"),
         REQUEST, "cuda:7"),
    Case("learning", ("evaluate", "{here}/gone.pt", GOOD), REQUEST, "gone.pt"),
    Case("learning", ("evaluate", "{here}/broken.pt", GOOD), REQUEST, "broken.pt"),
    Case("learning", ("evaluate", GOOD), REQUEST, "model"),
    Case("learning", ("export", "{here}/gone.pt", "--out", "{here}/out"), REQUEST, "gone.pt"),
    Case("learning", ("export", "{here}/broken.pt", "--out", "{here}/out"), REQUEST, "broken.pt"),
    Case("learning", ("export", "arpl_250g", "--processor", "abacus", "--out", "{here}/out"), REQUEST, "abacus"),
    Case("learning", ("export", "arpl_250g", "--nodes", "1", "--out", "{here}/out"), REQUEST, "--nodes"),
    Case("learning", ("export", "--verify", "{here}/gone"), REQUEST, "gone"),
    Case("learning", ("sweep", "soup", GOOD, *V, "--test", "{here}/held", "--out", "{here}/out"), REQUEST, "soup"),
    Case("learning", ("sweep", "grid", GOOD, *V, "--test", "{here}/held", "--grid", "colour=1,2", "--out",
                      "{here}/out"), REQUEST, "colour"),
)  # fmt: skip


def cases() -> list[Case]:
    """All of them."""
    made = [
        Case("vehicle file", ("compare", GOOD, "--vehicle", f"{{here}}/{name}.toml"), REQUEST, word)
        for name, (_, word) in VEHICLES.items()
    ]
    made += [Case("log", ("diagnose", f"{{here}}/{name}", *V), DATA, word) for name, (_, word) in COLUMNS.items()]
    made += [Case("log", ("diagnose", f"{{here}}/{name}", *V), code, word) for name, (_, code, word) in TEXTS.items()]
    return [*made, *LINES]


def prepare(here: Path) -> None:
    """Write the good flights, and what is spoilt."""
    vehicle = read_vehicle(FOLDER / "arpl_250g.toml")
    text = (FOLDER / "arpl_250g.toml").read_text()
    for name, (spoil, _) in VEHICLES.items():
        (here / f"{name}.toml").write_text(spoil(text))
    (here / "broken.py").write_text("def wrench(:\n")
    (here / "raises.py").write_text("raise ValueError('not today')\n")
    (here / "broken.pt").write_bytes(b"PK\x03\x04 and nothing more")
    (here / "nothing_here").mkdir()
    flights = planted_flights(vehicle, [], seed=3, manoeuvres=MANOEUVRES)
    for folder in ("good", *COLUMNS):
        (here / folder).mkdir()
        for number, flight in enumerate(flights):
            spoilt(flight, COLUMNS.get(folder, (dict, ""))[0], here / folder / f"flight_{number}.csv")
    (here / "held").mkdir()
    spoilt(flights[0], scaled(1.0001, "position_x"), here / "held" / "held_0.csv")
    good = (here / "good" / "flight_0.csv").read_bytes()
    for name, (change, *_) in TEXTS.items():
        (here / name).write_bytes(change(good))


def spoilt(flight: Flight, change: Callable[[Columns], Columns], path: Path) -> None:
    """Write a changed flight as CSV."""
    columns = change({"t": flight.time, **flight.columns})
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")


def answer(case: Case, here: Path) -> Answer:
    """Run one of them, in a copy of nothing: what it writes would lie in `here`."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    words = [word.format(here=here, port=port) for word in case.words]
    before = set(here.rglob("*"))
    command = [sys.executable, "-m", "alula", *words]
    done = subprocess.run(
        command, check=False, capture_output=True, text=True, timeout=PATIENCE, cwd=here, stdin=subprocess.DEVNULL
    )
    message = " ".join((done.stderr or done.stdout).split())
    left = set(here.rglob("*")) - before
    wrong = []
    if done.returncode != case.code:
        wrong.append(f"exit code {done.returncode} instead of {case.code}")
    if "Traceback" in done.stderr + done.stdout:
        wrong.append("a traceback")
    if case.names.format(port=port).lower() not in re.sub(r"[│\s]+", " ", message).lower():
        wrong.append(f"does not name {case.names!r}")
    if any(path.name.startswith("out") for path in left):
        wrong.append("something was written")
    return Answer(case, done.returncode, message.replace(str(here), ".").replace(f"{FOLDER}/", ""), ", ".join(wrong))


def table(answers: Sequence[Answer]) -> str:
    """How many were handled, by group, and those that were not."""
    lines = ["| what is bad | command lines | handled |", "| --- | --- | --- |"]
    groups = list(dict.fromkeys(one.case.group for one in answers))
    for group in (*groups, "all"):
        chosen = [one for one in answers if group in (one.case.group, "all")]
        lines.append(f"| {group} | {len(chosen)} | {sum(not one.wrong for one in chosen)} |")
    lines += ["", "Not handled:" if any(one.wrong for one in answers) else "All are handled.", ""]
    for one in answers:
        if one.wrong:
            lines.append(f"- `alula {' '.join(one.case.words)}`: {one.wrong}: {one.message[-220:]}")
    lines += ["", "| command line | code | message |", "| --- | --- | --- |"]
    for one in answers:
        words = " ".join(one.case.words).replace("{here}/", "").replace("|", "\\|")
        lines.append(f"| `{words}` | {one.code} | {one.message[-160:].replace('|', ' ')} |")
    return "\n".join(lines)


def bad_inputs(words: Sequence[str]) -> Page:
    """Bad input to every command: the exit code, what the message names, and that nothing is left behind.

    Each is a command line as a user would type it, run as a process of its own in a folder with good and spoilt files.
    Handled means: the exit code that docs/commands.md gives, no traceback, a message that names what was given or what
    is wrong with it, and no file written under --out.

        python -m benchmarks commands bad_inputs [--only WORD] [--jobs 1]
    """
    parser = options_of(bad_inputs.__doc__)
    parser.add_argument("--only", default="", help="a word of the command lines to run; writes no table")
    parser.add_argument("--jobs", type=int, default=1, help="more than one: files left behind count for all that run")
    chosen = parser.parse_args(words)
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        prepare(here)
        selected = [case for case in cases() if chosen.only in " ".join(case.words)]
        answers = []
        for _, one in parallel_map(partial(answer, here=here), selected, jobs=chosen.jobs):
            print(one.wrong or "handled", "|", " ".join(one.case.words), "|", one.message[-300:], flush=True)
            answers.append(one)
    return Page("bad_inputs", "Bad input to every command", table(answers), trial=bool(chosen.only))


OF_VENV = ("pip", "setuptools")  # which `python -m venv` brings
FLIGHT = ("alula.cli.fly", "runtime.daemon", "runtime.flight_setup", "simulation.flight_check")
COMMANDS = {
    "`alula --help`": ("-I", "-m", "alula", "--help"),
    "imports of `alula fly`": ("-I", "-c", f"import {', '.join(FLIGHT)}"),
}


def install_size(words: Sequence[str]) -> Page:
    """Size of the flight computer's install on disk, which packages take it, and how long its commands take to start.

    python -m benchmarks commands install_size
    """
    count = options_of(install_size.__doc__, starts=15).parse_args(words).starts
    with tempfile.TemporaryDirectory() as folder:
        python = f"{folder}/bin/python"
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        install = [python, "-m", "pip", "install", "--quiet", "--constraint", "constraints.txt", "."]
        subprocess.run(install, cwd=ROOT, check=True)
        site = next(Path(folder).glob("lib/python*/site-packages"))
        sizes = {distribution.metadata["Name"]: _size(distribution) for distribution in distributions(path=[str(site)])}
        total_size = sum(path.lstat().st_size for path in site.rglob("*") if path.is_file())
        byte_code = sum(path.lstat().st_size for path in site.rglob("*.pyc"))
        starts = {name: _seconds([python, *command], folder, count) for name, command in COMMANDS.items()}
    rows = ["| package | MB |", "| --- | --- |"]
    for name, size in sorted(sizes.items(), key=lambda item: -item[1])[:12]:
        rows.append(f"| {name} | {size / 1e6:.1f} |")
    brought = total_size - sum(sizes[name] for name in OF_VENV if name in sizes)
    rows.append(f"| all of site-packages, byte code included | {total_size / 1e6:.0f} |")
    rows.append(f"| of that byte code | {byte_code / 1e6:.0f} |")
    rows.append(f"| all without pip and setuptools, which the virtual environment brings | {brought / 1e6:.0f} |")
    rows += ["", f"| start, median of {count} | s |", "| --- | --- |"]
    rows += [f"| {name} | {seconds:.2f} |" for name, seconds in starts.items()]
    return Page("base_install_size", "Size of the base install", "\n".join(rows))


def _seconds(command: Sequence[str], folder: str, starts: int) -> float:
    """Median time of a command, s, after a first run that fills the caches."""
    seconds = []
    for _ in range(starts + 1):
        start = time.perf_counter()
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds[1:])


def _size(distribution: object) -> int:
    files = getattr(distribution, "files", None) or []
    return sum(Path(file.locate()).lstat().st_size for file in files if Path(file.locate()).exists())
