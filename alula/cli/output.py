"""Output of a command: quietly, with more detail, into a file as well; and the command to run next.

-v, -q and --log-file stand before or behind the command's name. Imports nothing but the standard library.
"""

from __future__ import annotations

import contextlib
import io
import os
import shlex
import sys
import time
import traceback
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO

from alula.cli.escaping import Escaping

SWITCHES = {"-v": "verbose", "--verbose": "verbose", "-q": "quiet", "--quiet": "quiet"}
LOG_FILE = "--log-file"
SECRETS = ("--token",)  # options whose values are written to no log file
MUTING = "PYTHONWARNINGS"


@dataclass
class Output:
    """The options of output, and the streams that they have replaced.

    verbose: print versions, time and exit code at the end, the traceback of an error, and warnings of libraries.
    quiet: print errors and JSON alone.
    log_file: that everything printed is appended to, with time, command and exit code.
    """

    verbose: bool = False
    quiet: bool = False
    log_file: str | None = None
    _began: float = field(default_factory=time.monotonic)
    _stack: contextlib.ExitStack = field(default_factory=contextlib.ExitStack)
    _log: TextIO | None = None

    def start(self, words: Sequence[str]) -> None:
        """Print as requested from now on. Raises OSError for a log file that cannot be written."""
        if self.log_file is not None:
            if not self.log_file or self.log_file.startswith("-"):
                raise OSError(0, "no name was given behind --log-file")
            log = Path(self.log_file).open("a", encoding="utf-8")  # noqa: SIM115
            self._log = self._stack.enter_context(log)  # until `finish`
            self._log.write(
                f"# {time.strftime('%Y-%m-%d %H:%M:%S %z')} {shlex.join(['alula', *_without_secrets(words)])}\n"
            )
        if self.quiet or self._log is not None:
            stdout: Any = Printed(sys.stdout, self._log, muted=self.quiet)
            self._stack.enter_context(contextlib.redirect_stdout(stdout))
        if self._log is not None:
            stderr: Any = Printed(sys.stderr, self._log)
            self._stack.enter_context(contextlib.redirect_stderr(stderr))
        if not self.verbose:
            self._mute_warnings()
        escaped: Any = Escaping(sys.stdout), Escaping(sys.stderr)
        self._stack.enter_context(contextlib.redirect_stdout(escaped[0]))
        self._stack.enter_context(contextlib.redirect_stderr(escaped[1]))

    def _mute_warnings(self) -> None:
        """Keep warnings of libraries, which name their own lines of code, out of this process and those it starts."""
        self._stack.callback(setattr, warnings, "showwarning", warnings.showwarning)
        warnings.showwarning = lambda *_, **__: None
        if MUTING not in os.environ:
            self._stack.callback(os.environ.pop, MUTING, None)
            os.environ[MUTING] = "ignore"

    def finish(self, code: object, error: BaseException | None = None) -> None:
        """Print what belongs to the end, and give the streams back."""
        number = code if isinstance(code, int) else int(code is not None)
        ending = f"exit code {number} after {time.monotonic() - self._began:.1f} s"
        if self.verbose:
            if error is not None:
                traceback.print_exception(error)
            from dynamics.version import __version__

            print(f"alula {__version__}, Python {sys.version.split()[0]}: {ending}", file=sys.stderr)
        if self._log is not None:
            self._log.write(f"# {ending}\n")
        self._stack.close()


class Printed(io.TextIOBase):
    """A stream that also writes to a log file, and to the terminal unless it is muted; JSON passes in any case."""

    def __init__(self, stream: TextIO, log: TextIO | None, *, muted: bool = False) -> None:
        super().__init__()
        self._stream, self._log, self._muted = stream, log, muted

    @property
    def buffer(self) -> Any:
        """The stream's own bytes, which JSON is written to."""
        return self._stream.buffer

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """Of the stream."""
        return self._stream.encoding

    def write(self, text: str) -> int:
        """Write text."""
        if self._log is not None:
            self._log.write(text)
        if not self._muted:
            self._stream.write(text)
        return len(text)

    def write_secret(self, text: str, logged: str) -> None:
        """Write text to the terminal, and in its place another one to the log file."""
        if self._log is not None:
            self._log.write(logged)
        if not self._muted:
            self._stream.write(text)

    def flush(self) -> None:
        """Flush what was written."""
        self._stream.flush()
        if self._log is not None:
            self._log.flush()

    def isatty(self) -> bool:
        """Whether colours and bars make sense: not in a log file."""
        return self._log is None and not self._muted and self._stream.isatty()

    def fileno(self) -> int:
        """Of the stream."""
        return self._stream.fileno()


def split_output(words: Sequence[str]) -> tuple[list[str], Output]:
    """The words of a command line without the options of output, and these. Words behind `--` are left alone."""
    rest: list[str] = []
    output = Output()
    remaining = iter(words)
    for word in remaining:
        if word == "--":
            rest += [word, *remaining]
        elif word in SWITCHES:
            setattr(output, SWITCHES[word], True)
        elif word == LOG_FILE:
            output.log_file = next(remaining, "")
        elif word.startswith(f"{LOG_FILE}="):
            output.log_file = word.partition("=")[2]
        else:
            rest.append(word)
    return rest, output


def command(*words: object) -> str:
    """Words as one command line of `alula`, None left out."""
    return shlex.join(["alula", *(str(word) for word in words if word is not None)])


def options(values: Iterable[tuple[str, object]]) -> list[str]:
    """Options with their values, one that was not used left out, one of several values repeated; flags alone."""
    words: list[str] = []
    for name, value in values:
        if isinstance(value, bool):
            words += [name] * value
            continue
        several = value if isinstance(value, list | tuple) else [] if value is None else [value]
        words += [word for one in several for word in (name, str(one))]
    return words


def print_next(*words: object) -> None:
    """Print the literal next command, a command's last line."""
    print(f"next: {command(*words)}", flush=True)


def print_secret(text: str, *, logged: str) -> None:
    """Print a line that holds a secret, of which the log file gets another line."""
    stream: Any = sys.stdout.stream if isinstance(sys.stdout, Escaping) else sys.stdout
    if isinstance(stream, Printed):
        stream.write_secret(f"{text}\n", f"{logged}\n")
    else:
        stream.write(f"{text}\n")
    stream.flush()


def _without_secrets(words: Sequence[str]) -> list[str]:
    """Words of a command line with *** in place of each secret."""
    masked: list[str] = []
    for number, word in enumerate(words):
        name, equals, _ = word.partition("=")
        if equals and name in SECRETS:
            word = f"{name}=***"
        masked.append("***" if number and words[number - 1] in SECRETS else word)
    return masked


def print_written(files: Sequence[Path], folder: Path) -> None:
    """Print how many files were written into a folder, as a message beside the output."""
    print(f"written: {len(files)} files in {folder}", file=sys.stderr)


def terminal_width() -> int:
    """Characters in a line of the terminal; 80 where there is none."""
    try:
        return int(os.environ.get("COLUMNS", "")) or 80
    except ValueError:
        pass
    try:
        return os.get_terminal_size().columns
    except OSError:
        return 80
