"""Real flights: what must be said of them and what must not. A statement that does not hold yet stands in `PENDING`."""

from __future__ import annotations

from functools import cache

import pytest

from fixtures.real_flights import SETS, Answer, RealSet, Statement, diagnose

# (flights, statement): why it does not hold yet. An entry that holds again must be taken out: xfail is strict.
PENDING = {
    (
        "Crazyflie, Lee controller",
        "names a drag of 0.26 to 0.36 1/s",
    ): "with gain and bend of the commands fitted beside the effects, the bend takes what lag and drag explain",
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
            marks = [pytest.mark.xfail(reason=reason, strict=True)] if reason else []
            made.append(pytest.param(real, statement, marks=marks, id=f"{real.name}: {statement.text}"))
    return made


@pytest.mark.parametrize(("real", "statement"), cases())
def test_statement(real: RealSet, statement: Statement) -> None:
    result = answer(real.name)
    assert statement.holds(result), str(result)


def test_every_pending_statement_exists() -> None:
    stated = {(real.name, statement.text) for real in SETS for statement in real.statements}
    assert set(PENDING) <= stated
