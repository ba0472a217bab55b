"""The steps of a case: each makes a folder with its result, which appears whole, or a refusal in its place."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

from dynamics.errors import AlulaError, RequestError
from dynamics.files import make_folder, write_json
from dynamics.progress import Progress
from dynamics.recorded_vehicle import system_chosen
from studio.work.adding import add
from studio.work.checking import check
from studio.work.comparing import compare
from studio.work.diagnosing import diagnose
from studio.work.evidence import explain
from studio.work.making import make
from studio.work.memory import CaseMemory
from studio.work.proving import fly, prove
from studio.work.task import REFUSED, Refusal, Task

Step = Callable[[CaseMemory, Task, Path, Progress], None]


def export(memory: CaseMemory, task: Task, folder: Path, progress: Progress) -> None:
    """Step "export", which alone needs torch: 200 MB that the other steps do without."""
    from studio.work import exporting

    exporting.export(memory, task, folder, progress)


STEPS: Mapping[str, Step] = {
    "check": check,
    "compare": compare,
    "diagnose": diagnose,
    "explain": explain,
    "add": add,
    "make": make,
    "prove": prove,
    "fly": fly,
    "export": export,
}


class StepRunner:
    """Does tasks one after the other, and keeps what the next one may use."""

    def __init__(self) -> None:
        self._memory = CaseMemory()

    def do(self, task: Task, progress: Progress) -> None:
        """Do a task; its result's folder appears under its name when all is in it.

        A step that the user's data or request refuses leaves a folder with the message, so that the page shows it as
        long as nothing changes. Raises RequestError where nothing can be written.
        """
        result = Path(task.result)
        part = result.with_name(f"{result.name}.part{os.getpid()}")
        shutil.rmtree(part, ignore_errors=True)
        make_folder(part, advice="Make room on the disk, or give a folder that can be written.")
        try:
            with system_chosen(task.system):
                STEPS[task.step](self._memory, task, part, progress)
        except AlulaError as error:
            write_json(Refusal(str(error), error.exit_code), part / REFUSED)
        except OSError as error:
            shutil.rmtree(part, ignore_errors=True)
            raise RequestError(f"cannot write {result}: {error.strerror or error}. Make room on the disk.") from error
        except BaseException:
            shutil.rmtree(part, ignore_errors=True)
            raise
        shutil.rmtree(result, ignore_errors=True)
        part.rename(result)
