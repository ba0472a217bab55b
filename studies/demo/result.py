"""Results of the demo: flights, prediction errors, and what was added to the vehicle file."""

from __future__ import annotations

from typing import Any

import msgspec


class FlownManoeuvre(msgspec.Struct, frozen=True):
    """One flown manoeuvre.

    speed_max: m/s.
    position_rmse, position_max: against the reference, m.
    paper_rmse: the paper's with its model of the same kind, m.
    recording: path.
    px4_rmse: position_rmse of the same flight on PX4's estimate, by the estimate, m; None where it ended early.
    """

    name: str
    speed_max: float
    position_rmse: float
    position_max: float
    paper_rmse: float | None
    recording: str
    px4_rmse: float | None = None


class PredictionError(msgspec.Struct, frozen=True):
    """RMS of one channel's three axes on held-out flights.

    before, after: with the nominal and with the identified model.
    floor: of the sensors' noise alone.
    """

    before: float
    after: float
    floor: float
    unit: str


class Learned(msgspec.Struct, frozen=True):
    """The demo's second half.

    verdict: diagnosis' word for the first flights.
    sentence: the same as a sentence.
    added: effects, the most important first.
    channels: prediction errors by kind of channel.
    vehicle_file: its next version; empty when there was nothing to add, and then nothing is flown again.
    flown: with the identified model.
    diagnosis: as `alula diagnose --json` writes it.
    """

    verdict: str
    sentence: str = msgspec.field(name="said")
    added: tuple[str, ...]
    channels: dict[str, PredictionError]
    vehicle_file: str
    flown: tuple[FlownManoeuvre, ...]
    diagnosis: dict[str, Any]


class DemoReport(msgspec.Struct, frozen=True):
    """The demo's measurements and files.

    nominal: flights with the nominal model.
    learned: the second half, None without one.
    missing: libraries that the second half would have needed.
    files: of the report.
    """

    vehicle: str
    hidden_effects: tuple[str, ...]
    seed: int
    nominal: tuple[FlownManoeuvre, ...]
    lockstep: bool = False
    learned: Learned | None = None
    missing: tuple[str, ...] = ()
    files: tuple[str, ...] = ()

    @property
    def pairs(self) -> tuple[tuple[FlownManoeuvre, FlownManoeuvre | None], ...]:
        """Each manoeuvre with the nominal model and, if it was flown again, with the identified one."""
        after = self.learned.flown if self.learned is not None else ()
        return tuple((before, after[i] if i < len(after) else None) for i, before in enumerate(self.nominal))
