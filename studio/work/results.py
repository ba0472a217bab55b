"""Results of the steps of a case beside their tables, as JSON."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from diagnosis.addition_report import AdditionReport
from diagnosis.comparison import Comparison
from diagnosis.proof import Proof
from diagnosis.report import Diagnosis
from flights.events import Event
from flights.quality import Inspection
from simulation.versions_in_flight import VersionsInFlight


class ColumnInfo(msgspec.Struct, frozen=True):
    """A column of a flight's table: name, quantity that it is of, unit."""

    name: str
    quantity: str
    unit: str


class HypothesisInfo(msgspec.Struct, frozen=True):
    """A log's columns as they are and not as declared: statement, evidence, line of a mapping file that repairs it.

    repair: empty where none does.
    """

    text: str
    evidence: str
    repair: str


class FlightInfo(msgspec.Struct, frozen=True):
    """A log's table, or why there is none.

    name: of the file.
    path: of the log.
    duration: s.
    rate: of the rows, Hz.
    columns: in the order of the table's rows.
    refused: the reader's message.
    vehicle: text of the vehicle file that a recording holds, empty where there is none.
    events: the autopilot's modes and messages.
    hypotheses: about columns that are not what they declare.
    """

    name: str
    path: str
    duration: float = 0.0
    rate: float = 0.0
    columns: tuple[ColumnInfo, ...] = ()
    refused: str = ""
    vehicle: str = ""
    events: tuple[Event, ...] = ()
    hypotheses: tuple[HypothesisInfo, ...] = ()


class PictureInfo(msgspec.Struct, frozen=True):
    """A picture as Plotly's JSON, its height in px, and what it shows."""

    data: str
    height: int
    description: str


class Checked(msgspec.Struct, frozen=True):
    """The inspection of each log that could be read, and what a log says of its vehicle.

    by_log: the inspection, None where the log was refused.
    pictures: of each log, by name.
    has_layout: whether a vehicle file can be made of the logs' parameters.
    """

    flights: tuple[FlightInfo, ...]
    by_log: tuple[Inspection | None, ...]
    pictures: tuple[dict[str, PictureInfo], ...]
    has_layout: bool

    @property
    def usable(self) -> bool:
        """Whether at least one log can answer something."""
        return any(one is not None and one.verdict != "unusable" for one in self.by_log)


class SegmentInfo(msgspec.Struct, frozen=True):
    """An uninterrupted segment among the rows of a comparison.

    flight: name of the log's file; log: its place among the case's flights.
    start: of the first row, s in the log's time.
    first, stop: rows.
    held_out: whether nothing is fitted to it.
    """

    flight: str
    log: int
    start: float
    first: int
    stop: int
    held_out: bool


class QuantityInfo(msgspec.Struct, frozen=True):
    """A quantity of the regime maps: name with unit, and the edges of its cells."""

    name: str
    edges: list[float]


class Rows(msgspec.Struct, frozen=True):
    """The rows of a comparison or diagnosis. floor: (12,); rate: Hz."""

    segments: tuple[SegmentInfo, ...]
    rate: float
    floor: list[float]
    quantities: tuple[QuantityInfo, ...]


class Compared(msgspec.Struct, frozen=True):
    """A comparison, its rows and its pictures by name."""

    comparison: Comparison
    rows: Rows
    pictures: dict[str, PictureInfo]


class RankedEffect(msgspec.Struct, frozen=True):
    """A candidate as the ranking lists it.

    key: its name in a model, the rotor in brackets.
    summary: what it is, one sentence.
    score: as `diagnosis.report.Considered` has it; null where it is impossible.
    outcome: named, refused, not_selected or impossible.
    reason: why it is not named, empty where it is.
    value: fitted values in words, empty where it was not fitted.
    own: whether it is the user's.
    """

    key: str
    summary: str
    score: float | None
    outcome: str
    reason: str
    value: str
    own: bool


class Diagnosed(msgspec.Struct, frozen=True):
    """A diagnosis in words, its ranking, rows and pictures."""

    diagnosis: Diagnosis
    sentence: str
    notes: tuple[str, ...]
    leftovers: tuple[str, ...]
    ranking: tuple[RankedEffect, ...]
    addable: tuple[str, ...]
    rows: Rows
    pictures: dict[str, PictureInfo]


GRID = 17  # values of a slider; the best one in the middle


class Slider(msgspec.Struct, frozen=True):
    """A parameter of an effect that can be moved by hand.

    name, unit: of the parameter.
    values: (g,) of the grid, its best one among them.
    best: place of the value that fits best.
    std: its standard deviation, the others of the set free; 0 where it was held.
    rms: (g, 4) error of each kind of channel over its floor, null where a kind is absent.
    """

    name: str
    unit: str
    values: list[float]
    best: int
    std: float
    rms: list[list[float | None]]


class Evidence(msgspec.Struct, frozen=True):
    """Explained error of one effect.

    key: the effect; value: fitted values in words.
    score: as in the ranking.
    fitted_with: keys of the effects that it was fitted with.
    sliders: of its parameters.
    share: by kind of channel, the part of the squared error above the floor that it explains.
    """

    key: str
    formula: str
    value: str
    score: float | None
    fitted_with: tuple[str, ...]
    sliders: tuple[Slider, ...]
    share: dict[str, float]
    pictures: dict[str, PictureInfo]


class Added(msgspec.Struct, frozen=True):
    """An addition; the vehicle's file lies beside it."""

    report: AdditionReport
    action: str


class Exported(msgspec.Struct, frozen=True):
    """A bundle that was written: its folder and what was compared, in words."""

    folder: str
    summary: tuple[str, ...]


FLIGHTS, VEHICLE = "flights.json", "vehicle.toml"
FOLLOWED = "followed_"  # names of a diagnosis' pictures of what models followed in flight, before their number
FILES: Mapping[type[msgspec.Struct], str] = {
    Checked: "checked.json",
    Compared: "compared.json",
    Diagnosed: "diagnosed.json",
    Evidence: "evidence.json",
    Added: "added.json",
    Proof: "proved.json",
    VersionsInFlight: "flown.json",
    Exported: "exported.json",
}
