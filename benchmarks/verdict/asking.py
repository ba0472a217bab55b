"""Asking the public API a case's question, and keeping the answer with what it is scored by."""

from __future__ import annotations

import json
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

import alula
from benchmarks.verdict.cases import Case
from benchmarks.verdict.posing import LostFlightsError, Posed, pose
from benchmarks.verdict.record import Record
from benchmarks.verdict.scoring import SURE, Answer, Expected, HeldStatement
from dynamics.errors import AlulaError
from fixtures.real_flights import SETS, RealSet, diagnose
from fixtures.real_flights import Answer as RealAnswer

MAX_LENGTH = 800  # of a traceback


def ask(case: Case) -> Record:
    """The record of a case."""
    if case.entry.source == "statements":
        return _ask_statements(case)
    with tempfile.TemporaryDirectory() as folder:
        try:
            posed = pose(case, Path(folder))
        except LostFlightsError:
            return Record(case.key, case.set_name, case.seed, Expected(), Answer(), 0.0, lost=True)
        began = time.process_time()
        answer = _answered(lambda: _report(posed), folder)
        took = time.process_time() - began
    return Record(case.key, case.set_name, case.seed, posed.expected, answer, took, dict(posed.conditions))


def killed(case: Case) -> Record:
    """The record of a case whose process was killed, as where it took all memory."""
    error = Answer(error="the process that answered was killed")
    return Record(case.key, case.set_name, case.seed, Expected(), error, 0.0)


def _report(posed: Posed) -> Answer:
    if posed.normal:
        trim = alula.compare_hover([str(log) for log in posed.logs], [str(log) for log in posed.normal], posed.vehicle)
        return Answer(json.loads(msgspec.json.encode(trim)))
    result = alula.diagnose(list(posed.logs), posed.vehicle, hold_out=posed.hold_out)
    return Answer(json.loads(msgspec.json.encode(result.report)))


def _answered(report: Callable[[], Answer], folder: str) -> Answer:
    """The answer, or its refusal or error; warnings are for a user's terminal."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return report()
        except AlulaError as error:
            return Answer(refusal=str(error).replace(folder, ""))
        except Exception as error:  # a traceback is an answer, too, and the worst one
            text = f"{type(error).__name__}: {error}; {traceback.format_exc(limit=-3)}"
            return Answer(error=text[:MAX_LENGTH])


def _ask_statements(case: Case) -> Record:
    real = next(real for real in SETS if real.name == case.entry.name)
    began = time.process_time()
    answer = _answered(lambda: _stated(real), "")
    return Record(case.key, case.set_name, case.seed, Expected(), answer, time.process_time() - began)


def _stated(real: RealSet) -> Answer:
    """The answer to a real flight, and which statements about it hold."""
    given_answer = diagnose(real)
    sure = RealAnswer(_sure_part(given_answer), given_answer.notes, given_answer.refusal)
    held = tuple(
        HeldStatement(s.text, s.forbids, s.holds(given_answer), not sure.effects or s.holds(sure))
        for s in real.statements
    )
    return Answer(dict(given_answer.report), given_answer.refusal, statements=held)


def _sure_part(answer: RealAnswer) -> dict[str, Any]:
    effects = [effect for effect in answer.report.get("effects", ()) if effect["confidence"] >= SURE]
    return {**answer.report, "effects": effects}
