"""A training: its losses while it runs and after it, and the errors of the model's card."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import msgspec
import numpy as np
import plotly.graph_objects as go

from dynamics.decoding import decode_json
from studies.results.kinds import TRAINING, model_of
from studio.pages.figure import AFTER, GREEN, ORANGE, PURPLE, SKY, VERMILION, Picture, line, picture
from studio.pages.shown import Shown
from studio.pages.tables import PageTable
from training.card import Card
from training.folder import CARD_SUFFIX
from training.prediction import pooled
from training.progress_file import Course, progress_file, read_course
from training.reports import Report

COLOURS = (AFTER, ORANGE, GREEN, PURPLE, SKY, VERMILION)


def show(path: Path) -> Shown:
    """The training as it stands. Raises RequestError for a file that holds none."""
    model = model_of(path)
    course, card = read_course(progress_file(model)), _card(model)
    members = {member: list(reports) for member, reports in groupby(_sorted(course), lambda r: r.member)}
    tables = [_members_table(members)] if members else []
    share = None
    if card is None:
        share = sum(reports[-1].step / reports[-1].steps for reports in members.values()) / course.beginning.members
    else:
        tables.append(_errors_table(card))
    return Shown(
        TRAINING,
        f"Training of {model.name}",
        _lines(course, card, members),
        pictures=_pictures(members) if members else {},
        tables=tables,
        share=share,
        command=course.beginning.command,
    )


def _card(model: Path) -> Card | None:
    """The card of a training that has ended, None while it runs."""
    file = model.with_suffix(CARD_SUFFIX)
    try:
        if file.stat().st_mtime_ns < progress_file(model).stat().st_mtime_ns:
            return None  # of the model that this training will replace
        return decode_json(file.read_bytes(), Card)
    except (OSError, msgspec.MsgspecError):
        return None


def _sorted(course: Course) -> list[Report]:
    return sorted(course.reports, key=lambda report: (report.member, report.step))


def _lines(course: Course, card: Card | None, members: dict[int, list[Report]]) -> list[str]:
    if card is not None and card.errors:
        errors = pooled(card.errors)
        line = f"RMSE on the validation flights {errors.combined:.3g}, {errors.combined / errors.nominal:.3g} of NOM's."
        return [f"{card.kind}, {len(card.seeds)} members, {card.parameters:,} parameters each. {line}", *card.notes]
    if not members:
        return ["The training has begun; no member was evaluated yet."]
    return [
        f"Member {member}: step {r[-1].step:,} of {r[-1].steps:,}, validation error {r[-1].validation:.4g}, best "
        f"{r[-1].best:.4g}."
        for member, r in members.items()
    ]


def _pictures(members: dict[int, list[Report]]) -> dict[str, Picture]:
    """Errors of each member over the steps, on logarithmic axes."""
    drawn = {}
    for title, fields in (
        ("Error over the steps", (("validation", "validation", "solid"), ("loss", "loss of the batch", "dot"))),
        ("Physics-inspired loss", (("physics_loss", "physics-inspired loss", "solid"),)),
        ("Learning rate", (("learning_rate", "learning rate", "solid"),)),
    ):
        figure = go.Figure()
        for member, reports in members.items():
            for field, name, dash in fields:
                _add_line(figure, reports, field, f"member {member}: {name}", COLOURS[member % len(COLOURS)], dash)
        if figure.data:
            figure.update_yaxes(type="log", exponentformat="power")
            figure.update_xaxes(title_text="step of the optimiser")
            drawn[title] = picture(figure, 340, f"Lines: {title.lower()}, by member.")
    return drawn


def _add_line(figure: go.Figure, reports: Sequence[Report], field: str, name: str, colour: str, dash: str) -> None:
    points = [(report.step, value) for report in reports if (value := getattr(report, field)) is not None]
    if points:
        x, y = np.array(points, dtype=float).T
        figure.add_trace(line(x, y, name=name, colour=colour, unit="", dash=dash).update(mode="lines+markers"))


def _members_table(members: dict[int, list[Report]]) -> PageTable:
    headings = ("member", "step", "of", "loss", "validation error", "best")
    rows = [
        (member, r[-1].step, r[-1].steps, r[-1].loss, r[-1].validation, r[-1].best) for member, r in members.items()
    ]
    return PageTable("Members", headings, rows, "Mean squared errors, standardised.", 4)


def _errors_table(card: Card) -> PageTable:
    headings = ("flight", "m/s²", "rad/s²", "both", "both, NOM", "/ NOM")
    rows = [(e.flight, e.linear, e.angular, e.combined, e.nominal, e.combined / e.nominal) for e in card.errors]
    return PageTable("RMSE on the validation flights", headings, rows)
