"""A case: logs, a vehicle, the versions of its file and the results of each step, all in one folder.

Results lie under a key made of what they were made from, so that whether one is out of date is a comparison of keys,
and an undone change shows the results of before at once. A case may come from a stranger: each path in it goes through
`studio.case.state_file.inside`.
"""

from __future__ import annotations

import datetime
import getpass
import hashlib
import threading
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import msgspec

from dynamics.decoding import editable_toml, parse_toml
from dynamics.effect_source import EffectFile, read_effect_file, read_effect_file_below
from dynamics.errors import RequestError
from dynamics.files import make_folder, write_json, write_whole
from dynamics.own_effects import effects_of
from dynamics.trust import require_approved
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import effect_files_in, find_vehicle, parse_vehicle, read_vehicle, vehicle_text
from flights.source import sha256
from studio.case.links import LinkedLog, links_of, set_links
from studio.case.state import CaseLog, CaseState, ChannelLevel, Options, Version
from studio.case.state_file import (
    ADVICE,
    EFFECTS,
    LOGS,
    MAPPINGS,
    STATE_FILE,
    VERSIONS,
    inside,
    locked,
    read_state,
    require_confined,
    result_name,
)

STEPS = ("check", "compare", "diagnose", "add", "prove")  # that have results
MAX_MAPPING = 1 << 20  # bytes
DEVICES = {"con", "prn", "aux", "nul", *(f"{name}{n}" for name in ("com", "lpt") for n in range(1, 10))}


class Case:
    """A case that is open in this process, and in no other.

    folder: where it lies.
    """

    def __init__(self, folder: Path, state: CaseState, lock: IO[str], links: Sequence[LinkedLog] = ()) -> None:
        self.folder = folder
        self._state = state
        self._links = tuple(links)
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
        case = cls(folder.resolve(), CaseState(name=name or folder.name), locked(folder))
        set_links(case.folder, ())  # of a case that was there before
        case._save(case._state)
        return case

    @classmethod
    def open(cls, folder: Path, *, logs: Sequence[Path] = (), mapping: Path | None = None) -> Case:
        """The case of a folder, as it stood.

        logs, mapping: files of the user's that the case has, and that lie elsewhere now; it takes them in. Raises
        RequestError for a folder without a case, one of another version, logs that are none of it, and paths in it that
        lead elsewhere.
        """
        folder = folder.resolve()
        state = read_state(folder)
        case = cls(folder, state, locked(folder), links_of(folder))
        try:
            if mapping is not None:
                case.set_options(msgspec.structs.replace(state.options, mapping=str(mapping)))
            for log in logs:
                case._find_again(log)
            require_confined(case._state, folder)
        except BaseException:
            case.close()
            raise
        return case

    def close(self) -> None:
        """Let other processes open the case."""
        self._lock_file.close()

    @property
    def state(self) -> CaseState:
        """As it is now."""
        return self._state

    @property
    def log_paths(self) -> tuple[Path, ...]:
        """The logs' files. Raises RequestError for one that lies elsewhere and that the user has not given."""
        return tuple(self.log_path(log) for log in self._state.logs)

    def log_path(self, log: CaseLog) -> Path:
        """The file of a log: in the case's folder, or where the user has it. Raises as `log_paths`."""
        linked = self._linked(log)
        return inside(self.folder, log.path) if linked is None else Path(linked.path)

    def is_linked(self, log: CaseLog) -> bool:
        """Whether a log lies where the user has it, outside of the case's folder."""
        return self._linked(log) is not None

    @property
    def mapping_path(self) -> Path | None:
        """The case's column mapping. Raises RequestError for one outside of the case's folder."""
        mapping = self._state.options.mapping
        return inside(self.folder, mapping) if mapping else None

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
        return inside(self.folder, version.file)

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
            for path in paths:
                log, linked = self._log(path)
                others = [other for other in self._state.logs if other.sha256 != log.sha256]
                if len(others) == len(self._state.logs) or not self._is_there(log.sha256):
                    self._keep_link(log, linked)
                    self._change(logs=(*others, log))

    def remove_log(self, path: str) -> None:
        """Take a log out of the case; a file outside its folder for logs stays where it is. path: as the case has it.

        Raises RequestError for a path that leads out of the case's folder.
        """
        with self._lock:
            removed = [log for log in self._state.logs if log.path == path]
            files = [inside(self.folder, log.path) for log in removed if not self.is_linked(log)]
            self._change(logs=tuple(log for log in self._state.logs if log.path != path))
            self._set_links(link for link in self._links if link.log != path)
            for file in files:
                if file.is_file() and file.resolve().is_relative_to(self.folder / LOGS):
                    file.unlink()

    def set_options(self, options: Options) -> None:
        """How the logs are read. A mapping is copied into the case's folder, as it is now.

        Raises RequestError for a mapping that cannot be read.
        """
        with self._lock:
            is_own = options.mapping == self._state.options.mapping and not Path(options.mapping).is_absolute()
            if options.mapping and not is_own:
                options = msgspec.structs.replace(options, mapping=self._copied_mapping(Path(options.mapping)))
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
            place = inside(self.folder, self._placed(file))
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
        """Digest of a step's inputs; of a step and a part of it, "diagnose:mass", likewise.

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
        return inside(self.folder, result_name(step, key or self.key(step)))

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
        folder = inside(self.folder, LOGS)
        make_folder(folder, advice=ADVICE)
        return self._free_log(safe_name(name))

    def _free_log(self, name: str) -> Path:
        """A path for a log, which is no log's yet, whether its file lies there or elsewhere."""
        return _free_path(inside(self.folder, LOGS), name, [self.folder / log.path for log in self._state.logs])

    def _log(self, path: Path) -> tuple[CaseLog, Path | None]:
        """A log as the case names it, and where it lies if that is elsewhere."""
        if not path.exists():
            raise RequestError(f"{path} does not exist. Give a log, or a folder of logs.")
        resolved = path.resolve()
        is_inside = resolved.is_relative_to(self.folder)
        place = resolved if is_inside else self._free_log(safe_name(resolved.name))
        size = sum(file.stat().st_size for file in files_of(resolved))
        log = CaseLog(str(place.relative_to(self.folder)), size, sha256(resolved))
        return log, None if is_inside else resolved

    def _linked(self, log: CaseLog) -> LinkedLog | None:
        return next((link for link in self._links if link.is_of(log)), None)

    def _is_there(self, digest: str) -> bool:
        """Whether the file of a log that the case has is where it was."""
        try:
            return all(self.log_path(log).exists() for log in self._state.logs if log.sha256 == digest)
        except RequestError:
            return False

    def _keep_link(self, log: CaseLog, path: Path | None) -> None:
        """Note where a log lies. path: None in the case's folder."""
        links = [link for link in self._links if link.sha256 != log.sha256]
        added = [] if path is None else [LinkedLog(str(self.folder), log.path, log.sha256, str(path))]
        self._set_links([*links, *added])

    def _set_links(self, links: Iterable[LinkedLog]) -> None:
        links = tuple(links)
        set_links(self.folder, links)
        self._links = links

    def _find_again(self, path: Path) -> None:
        """Take in a log that the case has, and whose file was elsewhere. Raises RequestError for any other file."""
        log, linked = self._log(path)
        for number, other in enumerate(self._state.logs):
            if log.sha256 == other.sha256 or str(linked) == other.path:
                if log.sha256 == other.sha256 and not Path(other.path).is_absolute():
                    log = msgspec.structs.replace(log, path=other.path) if linked is not None else log
                self._keep_link(log, linked)
                self._change(logs=(*self._state.logs[:number], log, *self._state.logs[number + 1 :]))
                return
        raise RequestError(f"{self.folder} holds a case already. Open it alone, and add logs on its page.")

    def _copied_mapping(self, path: Path) -> str:
        """The name of a mapping's copy in the case's folder."""
        try:
            with path.expanduser().open("rb") as file:
                content = file.read(MAX_MAPPING + 1)
        except (OSError, RuntimeError) as error:
            reason = getattr(error, "strerror", None) or error
            raise RequestError(f"cannot read the mapping {path}: {reason}. Give a TOML file.") from None
        if len(content) > MAX_MAPPING:
            raise RequestError(f"the mapping {path} has more than {MAX_MAPPING >> 20} MB. Give a TOML file.")
        folder = inside(self.folder, MAPPINGS)
        make_folder(folder, advice=ADVICE)
        for place in sorted(folder.iterdir()):
            if not place.is_symlink() and place.is_file() and place.read_bytes() == content:
                return str(place.relative_to(self.folder))
        target = _free_path(folder, safe_name(path.name))
        write_whole(target, lambda part: part.write_bytes(content), advice=ADVICE)
        return str(target.relative_to(self.folder))

    def _copy_effects(self, files: Sequence[EffectFile]) -> None:
        """Effect files into the case's folder, those that are there already once."""
        contents = [file.sha256 for file in self.effect_files()]
        names = [self._placed(file) for file in files if file.sha256 not in contents]
        self._change(effect_files=(*self._state.effect_files, *dict.fromkeys(names)))

    def _placed(self, file: EffectFile) -> str:
        """The name below the case's folder of a copy of an effect file, made where there is none."""
        folder = inside(self.folder, EFFECTS)
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
        make_folder(inside(self.folder, VERSIONS), advice=ADVICE)
        write_whole(
            inside(self.folder, name),
            lambda part: part.write_text(_without_effect_files(text), encoding="utf-8"),
            advice=ADVICE,
        )
        now = datetime.datetime.now(tz=datetime.UTC).isoformat(timespec="seconds")
        version = Version(number, parent, name, action, _user(), now, **more)
        self._change(versions=(*self._state.versions, version), current=number, undone=())
        return version

    def _digest(self, name: str) -> str:
        return hashlib.sha256(inside(self.folder, name).read_bytes()).hexdigest()

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


def safe_name(name: str) -> str:
    """A file name without folders and control characters, that is no device's on any system."""
    last = name.replace("\\", "/").rsplit("/", 1)[-1]
    plain = "".join(c for c in last if c.isprintable()).lstrip(".").rstrip(". ") or "log"
    return f"_{plain}" if is_device(plain) else plain


def is_device(name: str) -> bool:
    """Whether a file's name is a device's on some system, whatever its ending."""
    return name.partition(".")[0].rstrip().lower() in DEVICES


def _free_path(folder: Path, name: str, taken: Collection[Path] = ()) -> Path:
    """A path of that name in a folder, numbered where there is a file already, or where one is to be."""
    stem, dot, ending = name.partition(".")
    path, number = folder / name, 1
    while path.exists() or path.is_symlink() or path in taken:
        number += 1
        path = folder / f"{stem}_{number}{dot}{ending}"
    return path
