"""A case: logs, a vehicle, the versions of its file and the results of each step, all in one folder.

Results lie under a key made of what they were made from, so that whether one is out of date is a comparison of keys,
and an undone change shows the results of before at once.
"""

from __future__ import annotations

import datetime
import fcntl
import getpass
import hashlib
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import msgspec

from dynamics.decoding import decode_json, editable_toml, parse_toml
from dynamics.effect_source import EffectFile, read_effect_file, read_effect_file_below
from dynamics.errors import RequestError
from dynamics.files import make_folder, write_json, write_whole
from dynamics.own_effects import effects_of
from dynamics.trust import require_approved
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import effect_files_in, find_vehicle, parse_vehicle, read_vehicle, vehicle_text
from flights.source import sha256
from studio.case.state import FORMAT, CaseLog, CaseState, ChannelLevel, Options, Version

STATE_FILE = "case.json"
LOGS, VERSIONS, RESULTS, EFFECTS = "logs", "versions", "results", "effects"
STEPS = ("check", "compare", "diagnose", "add", "prove")  # that have results
ADVICE = "Give a folder that can be written."


class Case:
    """A case that is open in this process, and in no other.

    folder: where it lies.
    """

    def __init__(self, folder: Path, state: CaseState, lock: IO[str]) -> None:
        self.folder = folder
        self._state = state
        self._lock_file = lock
        self._lock = threading.RLock()
        self.revision = 1  # grows with every change

    @classmethod
    def create(cls, folder: Path, *, name: str = "") -> Case:
        """A new case in a folder that is empty or does not exist. Raises RequestError where there is something."""
        if folder.exists() and not folder.is_dir():
            raise RequestError(f"{folder} is a file. Give a case's folder, or a new one; logs stand before --case.")
        if folder.exists() and any(folder.iterdir()):
            raise RequestError(f"{folder} is not empty. Give a new folder for a case, or open the case in it.")
        make_folder(folder, advice=ADVICE)
        case = cls(folder.resolve(), CaseState(name=name or folder.name), _locked(folder))
        case._save(case._state)
        return case

    @classmethod
    def open(cls, folder: Path) -> Case:
        """The case of a folder, as it stood. Raises RequestError for a folder without one, or of another version."""
        return cls(folder.resolve(), _read_state(folder), _locked(folder))

    def close(self) -> None:
        """Let other processes open the case."""
        self._lock_file.close()

    @property
    def state(self) -> CaseState:
        """As it is now."""
        return self._state

    @property
    def log_paths(self) -> tuple[Path, ...]:
        """The logs' files."""
        return tuple(self.folder / log.path for log in self._state.logs)

    @property
    def version(self) -> Version | None:
        """The version that is worked on, None before a vehicle is chosen."""
        return self.version_number(self._state.current)

    @property
    def first_version(self) -> Version | None:
        """The version that the current one goes back to."""
        version = self.version
        while version is not None and version.parent:
            version = self.version_number(version.parent)
        return version

    @property
    def line(self) -> tuple[Version, ...]:
        """The versions from the first to the current one, and those undone behind it."""
        versions: list[Version] = []
        version = self.version
        while version is not None:
            versions.insert(0, version)
            version = self.version_number(version.parent)
        undone = [v for number in reversed(self._state.undone) if (v := self.version_number(number)) is not None]
        return (*versions, *undone)

    def version_number(self, number: int) -> Version | None:
        """A version by its number, None where there is none."""
        return next((v for v in self._state.versions if v.number == number), None)

    def vehicle_path(self, version: Version | None = None) -> Path:
        """The file of a version, by default the current one. Raises RequestError before a vehicle is chosen."""
        version = version or self.version
        if version is None:
            raise RequestError("no vehicle is chosen. Choose a bundled one, upload a file, or make one from the log.")
        return self.folder / version.file

    def vehicle(self, version: Version | None = None) -> Vehicle:
        """The vehicle of a version, with the case's own effect files.

        Raises RequestError as `vehicle_path`, and for effects that the user has not approved.
        """
        files = [file.path for file in self.effect_files()]
        return read_vehicle(self.vehicle_path(version), effect_files=files)

    def vehicle_name(self, version: Version | None = None) -> str:
        """The name in a version's file, whatever else stands there; no effects run. Raises as `vehicle_path`."""
        path = self.vehicle_path(version)
        try:
            name = parse_toml(path.read_text(encoding="utf-8")).get("name")
        except (OSError, ValueError):  # of TOML and UTF-8
            name = None
        return name if isinstance(name, str) else path.stem

    def effect_files(self) -> list[EffectFile]:
        """The case's own effect files; none are run. Raises RequestError for one outside of the case's folder."""
        return [read_effect_file_below(self.folder, name) for name in self._state.effect_files]

    def add_logs(self, paths: Sequence[Path]) -> None:
        """Add logs; one that is there already, by its content, stays alone. Raises RequestError for a missing file."""
        with self._lock:
            logs = {log.sha256: log for log in self._state.logs}
            for path in paths:
                log = self._log(path)
                logs.setdefault(log.sha256, log)
            self._change(logs=tuple(logs.values()))

    def remove_log(self, path: str) -> None:
        """Take a log out of the case; a file outside its folder stays where it is."""
        with self._lock:
            self._change(logs=tuple(log for log in self._state.logs if log.path != path))
            inside = self.folder / path
            if not Path(path).is_absolute() and inside.is_file():
                inside.unlink()

    def set_options(self, options: Options) -> None:
        """How the logs are read."""
        self._change(options=options)

    def set_vehicle(self, vehicle: str | Path) -> None:
        """Choose a vehicle: a file, or the name of a bundled one; versions of another vehicle end there.

        Raises RequestError for a file that cannot be used.
        """
        path = find_vehicle(vehicle)
        self.set_vehicle_text(vehicle_text(path), source=str(vehicle), action=f"chose {path.stem}")

    def set_vehicle_text(self, text: str, *, source: str, action: str, command: str = "") -> None:
        """Choose a vehicle by the text of its file, which holds the texts of its effect files.

        source: where it came from, as `--vehicle` takes it; command: that made it. Raises RequestError for a text that
        is no vehicle, or has effects that the user has not approved.
        """
        require_approved(effect_files_in(text), carrier=source)
        vehicle = parse_vehicle(text)
        with self._lock:
            self._copy_effects(vehicle.effect_files)
            self._new_version(text, parent=0, action=action, command=command)
            self._change(vehicle=source)

    def add_effect_file(self, path: Path) -> None:
        """Add a file with effects of the user's own.

        Raises RequestError for one that defines none, or that the user has not approved: it is then in the case's
        folder, to be approved there, and the case is without it.
        """
        file = read_effect_file(path)
        with self._lock:
            place = self.folder / self._placed(file)
            effects_of(read_effect_file(place))
            self._copy_effects([file])

    def add_version(
        self,
        text: str,
        *,
        action: str,
        command: str = "",
        effects: Sequence[str] = (),
        channels: Mapping[str, ChannelLevel] | None = None,
        data: str = "",
    ) -> Version:
        """A new version after the current one, which becomes current; versions that were undone are left behind."""
        with self._lock:
            return self._new_version(
                text,
                parent=self._state.current,
                action=action,
                command=command,
                effects=tuple(effects),
                channels=dict(channels or {}),
                data=data,
            )

    def undo(self) -> bool:
        """Go back to the version before. Returns False at the first one."""
        with self._lock:
            version = self.version
            if version is None or not version.parent:
                return False
            self._change(current=version.parent, undone=(*self._state.undone, version.number))
            return True

    def redo(self) -> bool:
        """Go forward to what was undone last. Returns False where nothing was."""
        with self._lock:
            if not self._state.undone:
                return False
            self._change(current=self._state.undone[-1], undone=self._state.undone[:-1])
            return True

    def key(self, step: str, version: Version | None = None) -> str:
        """What a step's result depends on, as a digest; of a step and a part of it, "diagnose:mass", likewise.

        Logs and the way they are read for the check; the vehicle too for all that follows; for the proof also the
        vehicle that the current one goes back to. version: instead of the current one.
        """
        state = self._state
        parts: list[Any] = [[log.sha256 for log in state.logs], state.options.mapping, state.options.pose]
        parts.append([self._digest(name) for name in state.effect_files])
        name = step.partition(":")[0]
        if name not in ("check", "flights", "make"):
            versions = [version or self.version, self.first_version if name == "prove" else None]
            parts += [state.options.hold_out, *(v and self._digest(v.file) for v in versions)]
        return hashlib.sha256(msgspec.json.encode([step, *parts])).hexdigest()[:16]

    def result_folder(self, step: str, key: str | None = None) -> Path:
        """Where the result of a step lies, or will lie. key: by default that of the present state."""
        return self.folder / RESULTS / f"{step.replace(':', '-').replace('/', '-')}-{key or self.key(step)}"

    def has_result(self, step: str) -> bool:
        """Whether a step's result of the present state is there."""
        return self.result_folder(step).is_dir()

    def shown_result(self, step: str) -> Path | None:
        """The result that a page shows: the present one, else the last one that was made, which is out of date."""
        if self.has_result(step):
            return self.result_folder(step)
        key = self._state.shown.get(step)
        folder = self.result_folder(step, key) if key else None
        return folder if folder is not None and folder.is_dir() else None

    def set_shown(self, step: str, key: str) -> None:
        """Remember the result that was made last."""
        self._change(shown={**self._state.shown, step: key})

    def touch(self) -> None:
        """Count a change that is none of the state, such as of a job."""
        with self._lock:
            self.revision += 1

    def new_log_path(self, name: str) -> Path:
        """A free place for a log that is uploaded. name: of the user's file."""
        folder = self.folder / LOGS
        make_folder(folder, advice=ADVICE)
        return _free_path(folder, _safe_name(name))

    def _log(self, path: Path) -> CaseLog:
        if not path.exists():
            raise RequestError(f"{path} does not exist. Give a log, or a folder of logs.")
        resolved = path.resolve()
        inside = resolved.is_relative_to(self.folder)
        place = resolved.relative_to(self.folder) if inside else resolved
        return CaseLog(str(place), sum(file.stat().st_size for file in files_of(resolved)), sha256(resolved))

    def _copy_effects(self, files: Sequence[EffectFile]) -> None:
        """Effect files into the case's folder, those that are there already once."""
        contents = [file.sha256 for file in self.effect_files()]
        names = [self._placed(file) for file in files if file.sha256 not in contents]
        self._change(effect_files=(*self._state.effect_files, *dict.fromkeys(names)))

    def _placed(self, file: EffectFile) -> str:
        """The name below the case's folder of a copy of an effect file, made where there is none."""
        folder = self.folder / EFFECTS
        make_folder(folder, advice=ADVICE)
        for place in sorted(folder.glob("*.py")):
            if not place.is_symlink() and place.is_file() and place.read_bytes() == file.text.encode():
                return str(place.relative_to(self.folder))
        target = _free_path(folder, file.name)
        write_whole(target, lambda part: part.write_bytes(file.text.encode()), advice=ADVICE)
        return str(target.relative_to(self.folder))

    def _new_version(self, text: str, *, parent: int, action: str, **more: Any) -> Version:
        number = max((v.number for v in self._state.versions), default=0) + 1
        name = f"{VERSIONS}/{number:04d}.toml"
        make_folder(self.folder / VERSIONS, advice=ADVICE)
        write_whole(
            self.folder / name,
            lambda part: part.write_text(_without_effect_files(text), encoding="utf-8"),
            advice=ADVICE,
        )
        now = datetime.datetime.now(tz=datetime.UTC).isoformat(timespec="seconds")
        version = Version(number, parent, name, action, _user(), now, **more)
        self._change(versions=(*self._state.versions, version), current=number, undone=())
        return version

    def _digest(self, name: str) -> str:
        return hashlib.sha256((self.folder / name).read_bytes()).hexdigest()

    def _change(self, **changed: Any) -> None:
        with self._lock:
            self._save(msgspec.structs.replace(self._state, **changed))

    def _save(self, state: CaseState) -> None:
        write_json(state, self.folder / STATE_FILE)
        self._state = state
        self.revision += 1


def files_of(log: Path) -> list[Path]:
    """The files of a log: itself, or those below it where it is a folder, as a ROS bag is."""
    return sorted(file for file in log.rglob("*") if file.is_file()) if log.is_dir() else [log]


def is_case(folder: Path) -> bool:
    """Whether a folder holds a case."""
    return (folder / STATE_FILE).is_file()


def _read_state(folder: Path) -> CaseState:
    path = folder / STATE_FILE
    try:
        content = path.read_bytes()
    except OSError as error:
        advice = "Give the folder of a case; `alula studio LOG... --case FOLDER` makes one."
        raise RequestError(f"{folder} holds no case ({STATE_FILE}: {error.strerror or error}). {advice}") from None
    try:
        number = decode_json(content, dict[str, Any]).get("format")
        if number != FORMAT:
            advice = f"This Alula reads format {FORMAT}; its logs and vehicle files are as they were, in {folder}."
            raise RequestError(f"{path} is of format {number!r}. {advice}")
        return decode_json(content, CaseState)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise RequestError(f"{path} is damaged: {error}. Its logs and vehicle files lie beside it.") from None


def _locked(folder: Path) -> IO[str]:
    """A lock on a case's folder, which ends with this process. Raises RequestError where another one has it."""
    try:
        file = (folder / ".lock").open("w", encoding="utf-8")
    except OSError as error:
        raise RequestError(f"cannot write in {folder}: {error.strerror or error}. {ADVICE}") from error
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        raise RequestError(f"{folder} is open in another studio. Close that one first, or use its page.") from None
    return file


def _without_effect_files(text: str) -> str:
    """A vehicle file without its list of effect files, which the case has."""
    import tomlkit

    document = editable_toml(text)
    document.pop("effect_files", None)
    return tomlkit.dumps(document)


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return "unknown user"


def _safe_name(name: str) -> str:
    """A file name without folders and control characters."""
    last = name.replace("\\", "/").rsplit("/", 1)[-1]
    return "".join(c for c in last if c.isprintable()).lstrip(".") or "log"


def _free_path(folder: Path, name: str) -> Path:
    """A path of that name in a folder, numbered where there is a file already."""
    stem, dot, ending = name.partition(".")
    path, number = folder / name, 1
    while path.exists():
        number += 1
        path = folder / f"{stem}_{number}{dot}{ending}"
    return path
