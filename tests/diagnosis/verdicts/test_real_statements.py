"""Real flights: what must be said of them and what must not. A statement that does not hold yet stands in `PENDING`."""

from __future__ import annotations

from functools import cache

import pytest

from fixtures.real_flights import SETS, Answer, RealSet, Statement, diagnose

# (flights, statement): why it does not hold yet.
_GAIN = (
    "the gain of the commands is taken before drag and mass are fitted, and the estimator's velocity errs like a gust"
)
_REASONLESS = "the report of an unknown has no reasons yet"
PENDING = {
    ("PX4, the true file", "is explained"): "the estimator's velocity error is taken for a gust",
    ("PX4, the true file", "names nothing but nothing"): "the estimator's velocity error is taken for a gust",
    (
        "PX4, the true file, one flight",
        "names nothing but nothing",
    ): "the estimator's errors are taken for a gust and wind",
    ("PX4, the true file, one flight", "names no mere hint"): "a declared set of effects that no resample agrees on",
    **{
        (flights, statement.text): _GAIN
        for flights, held in (
            ("PX4, twice the drag", ("names no mere", "names no effect", "makes no")),
            ("PX4, a payload", ("names no effect", "makes no")),
            ("PX4, a payload, one flight", ("names no mere", "names no effect", "makes no")),
            ("PX4, slower motors than in the file", ("names no effect", "makes no")),
            ("PX4, a file without effects", ("names no effect", "makes no", "names linear_drag")),
        )
        for real in SETS
        if real.name == flights
        for statement in real.statements
        if not statement.text.startswith(held)
    },
    ("NanoBench", "an unknown has its reason"): _REASONLESS,
    ("Crazyflie, manual flight", "an unknown has its reason"): _REASONLESS,
    ("Crazyflie, Lee controller", "an unknown has its reason"): _REASONLESS,
}


@cache
def answer(name: str) -> Answer:
    """The answer to a set, found once."""
    return diagnose(next(real for real in SETS if real.name == name))


def cases() -> list[object]:
    """Every statement about every set."""
    made = []
    for real in SETS:
        for statement in real.statements:
            reason = PENDING.get((real.name, statement.text))
            marks = [pytest.mark.xfail(reason=reason, strict=False)] if reason else []
            made.append(pytest.param(real, statement, marks=marks, id=f"{real.name}: {statement.text}"))
    return made


@pytest.mark.parametrize(("real", "statement"), cases())
def test_statement(real: RealSet, statement: Statement) -> None:
    result = answer(real.name)
    assert statement.holds(result), str(result)


def test_every_pending_statement_exists() -> None:
    stated = {(real.name, statement.text) for real in SETS for statement in real.statements}
    assert set(PENDING) <= stated
