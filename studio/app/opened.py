"""A case that is open in the server: its steps, what may run now, and the work that runs."""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Literal, TypeVar

import msgspec

from dynamics.decoding import decode_json
from dynamics.errors import AlulaError, RequestError
from dynamics.files import make_folder, write_whole
from dynamics.vehicle_plausibility import require_in_range
from studio.case.case import Case
from studio.case.commands import command
from studio.case.state import ChannelLevel
from studio.case.state_file import ADVICE
from studio.work.results import FILES, FLIGHTS, VEHICLE, Added, Checked, Diagnosed, FlightInfo
from studio.work.task import Refusal, Task, refusal_of
from studio.work.worker import Outcome, Worker

Status = Literal["locked", "open", "running", "done", "refused", "out of date"]
Result = TypeVar("Result", bound=msgspec.Struct)
PAGES = ("log", "check", "compare", "diagnose", "add", "prove")
CHAINED = {"check": "compare", "add": "compare"}  # what begins by itself when a step is done


@dataclass(frozen=True)
class Job:
    """A step that runs. share: of it that is done, 0 to 1; began: s, monotonic."""

    step: str
    share: float
    stage: str
    began: float


class OpenCase:
    """A case and the process that works on it.

    case: its folder and state.
    failure: what went wrong in the last job by a fault that is not the user's, empty after one that ended well.
    """

    def __init__(self, case: Case, make_worker: Callable[[], Worker]) -> None:
        self.case = case
        self.failure = ""
        self._make_worker = make_worker
        self._worker: Worker | None = None
        self._job: Job | None = None
        self._running = ""  # folder of the result that is being made
        self._queue: list[tuple[str, Task]] = []
        self._lock = threading.Lock()
        self._making = ""  # folder of the vehicle that was asked for last, empty where another one was chosen since

    @property
    def job(self) -> Job | None:
        """Job that runs now."""
        return self._job

    @property
    def busy(self) -> bool:
        """Whether something runs or waits."""
        with self._lock:
            return self._job is not None or bool(self._queue)

    def start(self, step: str, *, effect: str = "", reference: str = "") -> None:
        """Begin a step, or put it behind the one that runs; a step that has its result is not done again.

        Raises RequestError for a step that is locked.
        """
        if self.status(page_of(step)) == "locked":
            raise RequestError(f"{step} is locked: {self.lock_reason(page_of(step))}")
        name = ":".join(filter(None, (step, effect or reference)))
        self._enqueue(name, self._task(step, name, effect=effect, reference=reference))

    def make_vehicle(self, name: str, command: str, frame: str = "", **numbers: float | None) -> None:
        """Begin to make a vehicle of the logs; it becomes the case's unless another one is asked for meanwhile.

        numbers: mass (kg), arm (m) and speed_max (rad/s), None where they are not given. command: that makes the same.
        frame: empty where the logs state the layout.
        Raises RequestError for numbers that no vehicle has.
        """
        if not self.case.state.logs:
            raise RequestError("there is no log to make a vehicle of. Drop one above.")
        measured = {key: value for key, value in numbers.items() if value is not None}
        if "mass" not in measured:
            raise RequestError("the mass is open, and flights cannot show it. Weigh the vehicle as flown, in kg.")
        require_in_range(mass=measured["mass"], arm=measured.get("arm"))
        step = f"make:{name}"
        task = self._task("check", step, effect="", reference="")  # a step that needs no vehicle either
        key = sha256(repr((self.case.key("make"), name, frame, sorted(measured.items()))).encode()).hexdigest()[:16]
        result = str(self.case.result_folder(step, key))
        task = msgspec.structs.replace(
            task, step="make", result=result, numbers=measured, name=name, frame=frame, command=command
        )
        if self._making == result and self._is_made(result):
            return
        with self._lock:
            self._making = result
        if self._is_made(result):
            self._take_made(task, Path(result))
        else:
            self._end_making(result)
            self._enqueue(step, task)

    def choose_vehicle(self, choose: Callable[[], None]) -> None:
        """Choose a vehicle in another way: one that is still being made is given up."""
        making, self._making = self._making, ""
        try:
            choose()
        except AlulaError:
            self._making = making
            raise
        self._end_making("")

    @staticmethod
    def _is_made(result: str) -> bool:
        return Path(result).is_dir() and refusal_of(Path(result)) is None

    def _end_making(self, result: str) -> None:
        """End the making of vehicles other than the one of this result."""
        with self._lock:
            self._queue = [(name, task) for name, task in self._queue if task.step != "make" or task.result == result]
            job, worker = self._job, self._worker
            old = job is not None and job.step.startswith("make:") and self._running != result
        if old and worker is not None:
            worker.cancel()

    def _enqueue(self, name: str, task: Task) -> None:
        """Put a task behind what runs, unless its result is there or on the way."""
        with self._lock:
            if Path(task.result).is_dir() and refusal_of(Path(task.result)) is None:
                return
            if task.result == self._running or any(queued.result == task.result for _, queued in self._queue):
                return
            self._queue = [(other, queued) for other, queued in self._queue if other != name]  # of a state that is gone
            self._queue.append((name, task))
            if self._job is None:
                self._next()

    def start_if_open(self, step: str) -> None:
        """Begin a step, unless it is locked or done."""
        if self.status(page_of(step)) in ("open", "out of date"):
            self.start(step)

    def cancel(self) -> None:
        """End what runs and what waits."""
        with self._lock:
            self._queue.clear()
            worker, running = self._worker, self._job is not None
        if worker is not None and running:
            worker.cancel()

    @property
    def has_idle_worker(self) -> bool:
        """Whether a process holds this case's flights and has nothing to do."""
        return self._worker is not None and not self.busy

    def release(self) -> None:
        """End the process of a case that is not worked on; the next step starts another one."""
        with self._lock:
            if self._job is None and not self._queue and self._worker is not None:
                self._worker.close()
                self._worker = None

    def close(self) -> None:
        """End the work, and let other processes open the case."""
        self.cancel()
        if self._worker is not None:
            self._worker.close()
        self.case.close()

    def wait(self, timeout: float = 120.0) -> None:
        """Wait until nothing runs. Raises TimeoutError."""
        deadline = time.monotonic() + timeout
        while self.busy:
            if time.monotonic() > deadline:
                raise TimeoutError(f"{self._job} still runs")
            time.sleep(0.02)

    def result(self, kind: type[Result], step: str, *, shown: bool = True) -> Result | None:
        """A step's result; None where there is none, or the step was refused.

        shown: also one that is out of date.
        """
        folder = self.case.shown_result(step) if shown else self.case.result_folder(step)
        if folder is None or not (folder / FILES[kind]).is_file():
            return None
        return decode_json((folder / FILES[kind]).read_bytes(), kind)

    def refusal(self, step: str) -> Refusal | None:
        """Why the step was refused in the present state, None where it was not."""
        folder = self.case.result_folder(step)
        return refusal_of(folder) if folder.is_dir() else None

    def flights(self) -> tuple[Path, tuple[FlightInfo, ...]] | None:
        """The folder of the logs' tables, and what is in it; None before they are read."""
        folder = self.case.result_folder("flights")
        if not (folder / FLIGHTS).is_file():
            return None
        return folder, decode_json((folder / FLIGHTS).read_bytes(), tuple[FlightInfo, ...])

    def is_fresh(self, step: str) -> bool:
        """Whether the step's result is of the present state."""
        return self.case.has_result(step)

    def status(self, page: str) -> Status:
        """Of a page of the path."""
        if page == "log":
            return "done" if self.case.state.logs and self.case.version is not None else "open"
        if self.lock_reason(page):
            return "locked"
        if self._job is not None and page_of(self._job.step) == page:
            return "running"
        if page == "add":
            version = self.case.version
            return "done" if version is not None and version.parent else "open"
        if self.refusal(page) is not None:
            return "refused"
        if self.is_fresh(page):
            return "done"
        return "open" if self.case.shown_result(page) is None else "out of date"

    def lock_reason(self, page: str) -> str:
        """Why a page cannot be worked on yet, empty where it can."""
        if page == "log":
            return ""
        if not self.case.state.logs:
            return "add a log first."
        if page == "check":
            return ""
        checked = self.result(Checked, "check", shown=False)
        if checked is None:
            return "the logs are not checked yet."
        if not checked.usable:
            return "none of the logs can be used; the check says why."
        if self.case.version is None:
            return "choose a vehicle first."
        if page in ("compare", "diagnose"):
            return ""
        if page == "add":
            diagnosed = self.result(Diagnosed, "diagnose") is not None or bool(self.case.version.parent)
            return "" if diagnosed else "diagnose first: it says what can be added."
        return "" if self.case.version.parent else "nothing was added yet; there is nothing to prove."

    def command(self, step: str, **what: str) -> str:
        """The command line that does the same as a step. what: see `studio.case.commands.command`."""
        return command(self.case, step, **what)

    def _task(self, step: str, name: str, *, effect: str, reference: str) -> Task:
        case = self.case
        make_folder(case.result_folder(name).parent, advice=ADVICE)
        first = case.first_version
        return Task(
            step=step,
            result=str(case.result_folder(name)),
            flights=str(case.result_folder("flights")),
            logs=tuple(map(str, case.log_paths)),
            vehicle=str(case.vehicle_path()) if case.version else "",
            first_vehicle=str(case.vehicle_path(first)) if first else "",
            effect_files=tuple(file.path for file in case.effect_files()),
            mapping=str(case.mapping_path or ""),
            pose=case.state.options.pose,
            hold_out=case.state.options.hold_out,
            data_key=case.key("flights"),
            vehicle_key=case.key("compare"),
            effect=effect,
            reference=reference,
            command=self.command(step, effect=effect, reference=reference),
        )

    def _next(self) -> None:
        """Begin the first task that waits. The lock is held."""
        if not self._queue:
            self._job = None
            return
        name, task = self._queue.pop(0)
        self._running = task.result
        self._job = Job(name, 0.0, "starting", time.monotonic())
        self.case.touch()
        threading.Thread(target=self._run, args=(name, task), daemon=True, name=f"studio {name}").start()

    def _run(self, name: str, task: Task) -> None:
        if self._worker is None:
            self._worker = self._make_worker()
        outcome = self._worker.run(task, lambda share, stage: self._advance(name, share, stage))
        try:
            self._finish(name, task, outcome)
        except AlulaError as error:
            self.failure = str(error)
        with self._lock:
            self._job, self._running = None, ""
            self._next()
        self.case.touch()

    def _advance(self, name: str, share: float, stage: str) -> None:
        job = self._job
        if job is not None:
            self._job = Job(name, share, stage, job.began)
        if name == "check":
            self.case.touch()  # the first picture is there before the step is done

    def _finish(self, name: str, task: Task, outcome: Outcome) -> None:
        """Take over what a task has left."""
        self.failure = outcome.text if outcome.kind in ("failed", "refused") else ""
        result = Path(task.result)
        if outcome.kind != "done":
            for part in result.parent.glob("*.part*"):  # of a process that was ended in the middle
                shutil.rmtree(part, ignore_errors=True)
            return
        key = result.name.rpartition("-")[2]
        refused = refusal_of(result) is not None
        if not refused:
            self.case.set_shown(name, key)
        if task.step == "add" and not refused:
            if task.result != str(self.case.result_folder(name)):
                self.failure = "The case was changed while effects were added: they are not taken. Add them again."
                return
            self._take_version(task, result)
        if task.step == "make":
            refusal = refusal_of(result)
            if task.result != self._making:
                return  # another vehicle was asked for since
            if refusal is not None:
                self.failure = refusal.message
            else:
                self._take_made(task, result)
        following = CHAINED.get(name)
        if following and not refused:
            self.start_if_open(following)

    def _take_made(self, task: Task, result: Path) -> None:
        """The vehicle that was made becomes the case's, as a new first version."""
        text = (result / VEHICLE).read_text(encoding="utf-8")
        path = self.case.folder / f"{task.name}.toml"
        action = f"made {task.name} from the log"
        self.case.set_vehicle_text(text, source=str(path), action=action, command=task.command)
        write_whole(path, lambda part: part.write_text(text, encoding="utf-8"), advice=ADVICE)
        self.start("check")
        self.start_if_open("compare")

    def _take_version(self, task: Task, result: Path) -> None:
        added = decode_json((result / FILES[Added]).read_bytes(), Added)
        levels = {k: ChannelLevel(e.before, e.after, e.floor, e.unit) for k, e in added.report.channels.items()}
        self.case.add_version(
            (result / VEHICLE).read_text(encoding="utf-8"),
            action=added.action,
            command=task.command,
            effects=added.report.effects,
            channels=levels,
            data=task.data_key,
        )


def page_of(step: str) -> str:
    """The page of the path that a step belongs to."""
    name = step.partition(":")[0]
    return {"explain": "diagnose", "fly": "prove", "export": "prove", "make": "log"}.get(name, name)
