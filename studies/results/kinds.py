"""Which result lies at a path, by the names of its files; reading one takes more libraries than that."""

from __future__ import annotations

from pathlib import Path

from dynamics.errors import RequestError
from runtime.record.recording import newest_recording
from studies.fleet.files import LINES
from studies.sweep.about import ABOUT
from training.folder import CARD_SUFFIX
from training.progress_file import SUFFIX, progress_file

FLEET, SWEEP, TRAINING, EVALUATION, RECORDING = "fleet", "sweep", "training", "evaluation", "recording"
WHERE = {
    FLEET: "the --out folder of alula diagnose --fleet",
    SWEEP: "the --out folder of alula sweep",
    TRAINING: "a model (.pt) of alula train, or its .progress.jsonl",
    EVALUATION: "the --json file of alula evaluate",
    RECORDING: "a recording (.mcap) of alula fly, or a folder of them",
}
EVALUATED, BEGINNING = b'"evaluated"', 4096  # in the first bytes of an evaluation


def kind_of(path: Path) -> str:
    """The kind of a result. Raises RequestError for a path that holds none."""
    if (path / LINES).is_file():
        return FLEET
    if (path / ABOUT).is_file():
        return SWEEP
    if progress_file(model_of(path)).is_file():
        return TRAINING
    if path.suffix == ".json" and path.is_file() and _is_evaluation(path):
        return EVALUATION
    if path.suffix == ".mcap" if path.is_file() else path.is_dir() and any(path.glob("*.mcap")):
        return RECORDING
    if not path.exists():
        raise RequestError(f"{path} is not there. Give the path of a file or folder on this computer.")
    raise RequestError(f"{path} is no result that can be shown. These can: {'; '.join(WHERE.values())}.")


def stamp(path: Path) -> str:
    """Stamp of a result, which changes with it: times and sizes of its files. Raises RequestError as `kind_of`."""
    stamps = []
    for file in _files(path, kind_of(path)):
        try:
            stat = file.stat()
        except OSError:
            continue
        stamps.append((file.name, stat.st_mtime_ns, stat.st_size))
    return repr(stamps)


def model_of(path: Path) -> Path:
    """A training's model of any of its files: `m.pt`, `m.pt.run`, `m.progress.jsonl`; another path as it is."""
    name = path.name.removesuffix(SUFFIX).removesuffix(".run").removesuffix(".pt")
    return path if name == path.name else path.with_name(f"{name}.pt")


def _files(path: Path, kind: str) -> list[Path]:
    """The files that change while a result is made."""
    if kind == FLEET:
        return [path / LINES]
    if kind == SWEEP:
        return [path / ABOUT, *sorted(path.glob("*.json")), *sorted(path.glob("*.failed"))]
    if kind == TRAINING:
        model = model_of(path)
        return [progress_file(model), model.with_suffix(CARD_SUFFIX)]
    return [newest_recording(path) if kind == RECORDING else path]


def _is_evaluation(path: Path) -> bool:
    with path.open("rb") as file:
        return EVALUATED in file.read(BEGINNING)
