"""What may run: own effects by their approved content, read once from plain text files; nothing else."""

import ast
import os
import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

from dynamics import trust
from dynamics.approvals import approve, is_listed, read_approvals, store_path, withdraw
from dynamics.codegen import build_library, cache_folder
from dynamics.effect_source import EffectFile, effect_file, read_effect_file, read_effect_file_below
from dynamics.errors import RequestError
from dynamics.own_effects import effects_of
from dynamics.trust import approve_given, load_given_library, require_approved, run_effect_file
from dynamics.vehicle_file import effect_files_in, parse_vehicle, read_vehicle, tables_toml, vehicle_text, with_texts
from vehicles import FOLDER

ROOT = Path(__file__).parents[2]
BUNDLED = (FOLDER / "arpl_250g.toml").read_text(encoding="utf-8")


@pytest.fixture
def payload(tmp_path: Path) -> Callable[[str], str]:
    """Python that leaves a file behind when it runs."""
    return lambda name: f"import pathlib\npathlib.Path({str(tmp_path / 'RAN')!r}).touch()\nNAME = {name!r}\n"


@pytest.fixture(autouse=True)
def nothing_ran(tmp_path: Path, nothing_approved: Path) -> object:
    """Of a payload, in any of these tests that does not say so."""
    yield
    assert not (tmp_path / "RAN").exists() or (tmp_path / "MAY_RUN").exists()


def _named(folder: Path, name: str) -> Path:
    path = folder / "v.toml"
    path.write_text(f"effect_files = [{msgspec.json.encode(name).decode()}]\n{BUNDLED}")
    return path


def test_a_refusal_says_file_hash_first_lines_and_the_command(tmp_path: Path, payload: Callable[[str], str]) -> None:
    (tmp_path / "mine.py").write_text(payload("mine") + "\x1b".encode("unicode_escape").decode() + "\n" * 20)
    with pytest.raises(RequestError) as refusal:
        read_vehicle(_named(tmp_path, "mine.py"))
    text, file = str(refusal.value), read_effect_file(tmp_path / "mine.py")
    assert refusal.value.exit_code == 2
    assert file.path in text
    assert file.sha256 in text
    assert "1 | import pathlib" in text
    assert "more lines" in text
    assert f"`alula trust {file.path}`" in text
    assert f"--effects {file.path}" in text


def test_what_is_shown_cannot_write_to_the_terminal() -> None:
    file = effect_file("x\x1b[2J.py", "import os  # \u202e gnp.txt\x1b]0;title\x07\n")
    with pytest.raises(RequestError) as refusal:
        require_approved([file])
    assert all(c == "\n" or c.isprintable() for c in str(refusal.value))


@pytest.mark.parametrize(
    "name", ["../mine.py", "/ABSOLUTE/mine.py", "below/../../mine.py", "link.py", "linked/mine.py"]
)
def test_names_that_lead_out_of_the_folder_are_refused_although_approved(
    tmp_path: Path, payload: Callable[[str], str], name: str
) -> None:
    outside, inside = tmp_path / "mine.py", tmp_path / "inside"
    outside.write_text(payload("mine"))
    (inside / "below").mkdir(parents=True)
    (inside / "link.py").symlink_to(outside)
    (inside / "linked").symlink_to(tmp_path)
    approve_given([outside])
    with pytest.raises(RequestError, match="does not lie beside the vehicle file or below it"):
        read_vehicle(_named(inside, name.replace("/ABS", str(tmp_path))))


def _zip(path: Path, payload: str) -> None:
    with path.open("wb") as file:
        file.write(b"\x89MCAP0\r\n" + bytes(64))
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr("__main__.py", payload)


def _pipe(path: Path, _: str) -> None:
    os.mkfifo(path)


def _folder(path: Path, payload: str) -> None:
    path.mkdir()
    (path / "__main__.py").write_text(payload)


def _compiled(path: Path, payload: str) -> None:
    import py_compile

    source = path.with_name("source.txt")
    source.write_text(payload)
    py_compile.compile(str(source), cfile=str(path))


def _huge(path: Path, payload: str) -> None:
    path.write_text(payload + "#" * (1 << 20))


def _latin(path: Path, payload: str) -> None:
    path.write_bytes(f"# -*- coding: latin-1 -*- \xe9\n{payload}".encode("latin-1"))


@pytest.mark.parametrize("make", [_zip, _pipe, _folder, _compiled, _huge, _latin])
@pytest.mark.parametrize("name", ["flight.mcap", "mine.py", "mine.pyc"])
def test_only_plain_text_files_are_read(
    tmp_path: Path, payload: Callable[[str], str], make: Callable[[Path, str], None], name: str
) -> None:
    make(tmp_path / name, payload("x"))
    for read in (lambda: read_effect_file(tmp_path / name), lambda: read_vehicle(_named(tmp_path, name))):
        with pytest.raises(RequestError, match="is no file with effects"):
            read()


@pytest.mark.parametrize(
    "text", ["a = 1\r\nb = '''x'''\n", "\ufeffa = 1\n", "a = '\\u202e'\n\f\n", "'", "\n\n", "é\t\n"]
)
def test_a_text_comes_back_from_a_vehicle_file_with_the_same_hash(tmp_path: Path, text: str) -> None:
    (tmp_path / "mine.py").write_bytes(text.encode())
    file = read_effect_file(tmp_path / "mine.py")
    (read,) = effect_files_in(vehicle_text(_named(tmp_path, "mine.py")))
    assert read == file
    assert effect_files_in(with_texts(BUNDLED, [read])) == (file,)


def test_a_text_of_another_hash_is_refused(tmp_path: Path, payload: Callable[[str], str]) -> None:
    good, evil = effect_file("mine.py", "EFFECTS = []\n"), effect_file("mine.py", payload("x"))
    approve([("effects", good.sha256, "mine.py")])
    text = BUNDLED + tables_toml([evil]).replace(evil.sha256, good.sha256)
    for read in (effect_files_in, parse_vehicle):
        with pytest.raises(RequestError, match="edited or damaged"):
            read(text)


def test_a_file_that_changes_after_its_approval_does_not_run(tmp_path: Path, payload: Callable[[str], str]) -> None:
    path = tmp_path / "mine.py"
    path.write_text("x = 1\n")
    approve_given([path])
    held = read_effect_file(path)
    path.write_text(payload("other"))
    assert run_effect_file(held)["x"] == 1  # what was read runs; the path is not opened again
    with pytest.raises(RequestError, match="you have not approved"):
        run_effect_file(read_effect_file(path))


def test_an_approval_is_for_good_until_it_is_taken_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "mine.py"
    path.write_text("x = 1\n")
    file = read_effect_file(path)
    approve([("effects", file.sha256, file.path)])
    assert (store_path().stat().st_mode & 0o777, store_path().parent.stat().st_mode & 0o777) == (0o600, 0o700)
    assert run_effect_file(file)["x"] == 1
    approve([("effects", file.sha256, file.path)])
    assert [approval.name for approval in read_approvals()] == [file.path]
    assert withdraw([file.sha256[:7]]) == ()  # too short to mean one
    assert len(withdraw([file.sha256[:8]])) == 1
    monkeypatch.setattr(trust, "_approved", set())  # as in the next process
    with pytest.raises(RequestError, match="not approved"):
        run_effect_file(file)


def test_a_manifest_that_is_approved_is_no_approval_of_the_same_bytes_as_python(payload: Callable[[str], str]) -> None:
    file = effect_file("mine.py", payload("x"))
    approve([("bundle", file.sha256, "b"), ("library", file.sha256, "l")])
    with pytest.raises(RequestError, match="not approved"):
        run_effect_file(file)


@pytest.mark.parametrize("loosen", ["file", "folder", "link"])
def test_a_list_that_others_may_write_approves_nothing(loosen: str, tmp_path: Path) -> None:
    file = effect_file("mine.py", "x = 1\n")
    approve([("effects", file.sha256, "mine.py")])
    if loosen == "link":
        store_path().rename(tmp_path / "elsewhere.json")
        store_path().symlink_to(tmp_path / "elsewhere.json")
    else:
        (store_path() if loosen == "file" else store_path().parent).chmod(0o777)
    with pytest.raises(RequestError, match="cannot be used"):
        run_effect_file(file)


def test_a_folder_in_place_of_the_list_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    store_path().mkdir(parents=True)
    with pytest.raises(RequestError, match="cannot be used: Is a directory"):
        read_approvals()


def test_nothing_in_the_working_directory_approves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = effect_file("mine.py", "x = 1\n")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    approve([("effects", file.sha256, "mine.py")])
    assert is_listed("effects", file.sha256)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for relative in ("", ".", "alula/.."):
        monkeypatch.setenv("XDG_CONFIG_HOME", relative)
        assert not is_listed("effects", file.sha256)


def test_a_file_beside_an_effect_file_is_not_imported(
    tmp_path: Path, payload: Callable[[str], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "helper_of_nobody.py").write_text(payload("helper"))
    (tmp_path / "mine.py").write_text("import helper_of_nobody\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend("")
    monkeypatch.syspath_prepend(str(tmp_path))
    approve_given([tmp_path / "mine.py"])
    with pytest.raises(RequestError, match="An effect file stands alone"):
        effects_of(read_effect_file(tmp_path / "mine.py"))


def test_a_name_without_its_text_runs_nothing(tmp_path: Path, payload: Callable[[str], str]) -> None:
    (tmp_path / "mine.py").write_text(payload("x"))
    approve_given([tmp_path / "mine.py"])
    with pytest.raises(RequestError, match="its text is not here"):
        parse_vehicle(f'effect_files = ["{tmp_path / "mine.py"}"]\n{BUNDLED}')


def test_a_shared_library_that_came_along_is_loaded_only_as_the_bytes_that_are_approved(tmp_path: Path) -> None:
    code = {"given.c": "#include <stdio.h>\n__attribute__((constructor)) static void run(void) {"}
    code["given.c"] += f'fclose(fopen("{tmp_path}/RAN", "w"));}}\nint answer(void) {{ return 42; }}\n'
    built = build_library(code, entry="given.c")
    library = tmp_path / "given.so"
    library.write_bytes(built.read_bytes())
    with pytest.raises(RequestError, match="machine code that would run as you"):
        load_given_library(library)
    assert not (tmp_path / "RAN").exists()
    (tmp_path / "MAY_RUN").touch()
    trust.approve_here([("library", trust.hashlib.sha256(library.read_bytes()).hexdigest())])
    assert load_given_library(library).answer() == 42
    assert (tmp_path / "RAN").exists()


def test_compiled_code_of_others_is_not_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ALULA_CACHE", str(tmp_path / "cache"))
    library = build_library({"a.c": "int a(void) { return 1; }"}, entry="a.c")
    assert cache_folder().stat().st_mode & 0o777 == 0o700
    honest = library.read_bytes()
    for mode in (0o777, 0o775):
        library.write_bytes(b"planted")
        library.chmod(mode)
        cache_folder().chmod(mode)
        assert build_library({"a.c": "int a(void) { return 1; }"}, entry="a.c").read_bytes() == honest
        assert cache_folder().stat().st_mode & 0o777 == 0o700


RUNNING = {"exec", "eval", "compile", "__import__"}  # builtins
RUNNERS = {
    "runpy", "imp", "pickle.load", "pickle.loads", "pickle.Unpickler", "marshal", "shelve", "dill", "cloudpickle",
    "joblib", "ctypes.CDLL", "ctypes.PyDLL", "ctypes.cdll", "importlib.util.spec_from_file_location",
    "util.spec_from_file_location",
    "importlib.machinery.SourceFileLoader", "ca.external", "casadi.external", "yaml.load", "code.interact",
}  # fmt: skip
ALLOWED = {
    ("dynamics/trust.py", "compile"), ("dynamics/trust.py", "exec"), ("dynamics/trust.py", "ctypes.CDLL"),
    ("dynamics/trust.py", "ctypes.PyDLL"),  # of a library that is loaded already
    ("runtime/realtime.py", "ctypes.CDLL"),  # of None: this process
    ("alula/__init__.py", "import_module"), ("alula/cli/app.py", "import_module"),  # of names in a table
    ("runtime/link/dialect.py", "import_module"), ("studies/results/read.py", "import_module"),
}  # fmt: skip
ROOMS = (
    "alula", "diagnosis", "dynamics", "export", "flights", "runtime", "simulation", "sitl_mock", "studies", "studio",
    "training", "vehicles",
)  # fmt: skip


def _uses(path: Path) -> set[str]:
    """How a module may run what it has read: calls and imports by name."""
    uses = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        match node:
            case ast.Call(func=ast.Name(id=name)) if name in RUNNING:
                uses.add(name)
            case ast.Call(func=ast.Attribute(attr="import_module"), args=[ast.Constant()]):
                pass
            case ast.Call(func=ast.Attribute(attr="import_module") | ast.Name(id="import_module")):
                uses.add("import_module")
            case ast.Call(func=ast.Attribute(attr="load", value=ast.Name(id="torch")), keywords=keywords):
                safe = [
                    k
                    for k in keywords
                    if k.arg == "weights_only" and isinstance(k.value, ast.Constant) and k.value.value
                ]
                uses |= set() if safe else {"torch.load"}
            case ast.keyword(arg="allow_pickle", value=ast.Constant(value=True)):
                uses.add("allow_pickle")
            case ast.Import(names=names):
                uses |= {name.name for name in names} & RUNNERS
            case ast.ImportFrom(module=module, names=names):
                uses |= {f"{module}.{name.name}" for name in names} & RUNNERS | {str(module)} & RUNNERS
            case ast.Attribute() if (name := ast.unparse(node)) in RUNNERS:
                uses.add(name)
    return uses


def test_no_other_module_runs_what_a_user_or_a_file_names() -> None:
    files = [path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))]
    assert len(files) > 400
    uses = {(str(path.relative_to(ROOT)), use) for path in files for use in _uses(path)}
    assert uses == ALLOWED


@pytest.mark.parametrize(
    ("text", "use"),
    [
        ("import runpy\nrunpy.run_path(p)", "runpy"),
        ("exec(open(p).read())", "exec"),
        ("from importlib import import_module\nimport_module(p)", "import_module"),
        ("from ctypes import CDLL\nCDLL(p)", "ctypes.CDLL"),
        ("import torch\ntorch.load(p, weights_only=False)", "torch.load"),
        ("np.load(p, allow_pickle=True)", "allow_pickle"),
        ("ca.external('f', p)", "ca.external"),
    ],
)
def test_the_contract_sees_ways_around_it(tmp_path: Path, text: str, use: str) -> None:
    (tmp_path / "module.py").write_text(text)
    assert use in _uses(tmp_path / "module.py")


def test_a_case_or_a_vehicle_may_name_files_below_it(tmp_path: Path) -> None:
    (tmp_path / "effects").mkdir()
    (tmp_path / "effects" / "mine.py").write_text("x = 1\n")
    (tmp_path / "here.py").symlink_to(tmp_path / "effects" / "mine.py")
    file = read_effect_file_below(tmp_path, "effects/mine.py")
    assert read_effect_file_below(tmp_path, "./here.py") == file == EffectFile(**msgspec.to_builtins(file))
    assert re.fullmatch("[0-9a-f]{64}", file.sha256)
