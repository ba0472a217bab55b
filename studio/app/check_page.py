"""Step 2: the verdict on each log: what it can answer, what it cannot, and what would make a better one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import dash_mantine_components as dmc
from dash import dcc, html

from flights.quality import Inspection
from studio.app.heads import head, lock
from studio.app.opened import OpenCase
from studio.app.parts import action, badge, card, command_box, graph, grid, message, table
from studio.app.theme import figure_of
from studio.case.commands import repair_command
from studio.work.results import Checked, FlightInfo


def layout(opened: OpenCase, name: str, scheme: str) -> Any:
    """One part for each log."""
    parts = head(opened, "Is the log good enough, and for what?")
    checked = opened.result(Checked, "check", shown=False)
    if checked is None:
        if opened.status("check") == "running":
            waiting: list[Any] = [dmc.Text("The logs are being read and inspected.", c="dimmed")]
        else:
            waiting = lock(opened, "check") or [action("start", "Check the logs", step="check")]
        return dmc.Stack(parts + waiting, gap="md")
    for number, (info, inspection) in enumerate(zip(checked.flights, checked.by_log, strict=True)):
        parts.append(_log(number, info, inspection, checked, scheme))
        if any(one.repair for one in info.hypotheses):
            parts.append(_repair(number, repair_command(opened.case, Path(info.path))))
    if checked.usable:
        parts.append(dcc.Link("Next: compare the model with the measurement", href=f"/case/{name}/compare"))
    else:
        parts.append(
            message("None of these logs can answer. What each lacks stands above.", title="Unusable", colour="red")
        )
    parts.append(command_box(opened.command("check")))
    return dmc.Stack(parts, gap="md")


def _log(number: int, info: FlightInfo, inspection: Inspection | None, checked: Checked, scheme: str) -> Any:
    if inspection is None:
        is_explained = bool(info.hypotheses) and all(one.text in info.refused for one in info.hypotheses)
        refused = None if is_explained else message(info.refused, title="This log cannot be read", colour="red")
        return card(info.name, refused, _hypotheses(info))
    able = [e for e in inspection.effects if e.answer != "no"]
    unable = [e for e in inspection.effects if e.answer == "no"]
    facts = (
        f"{inspection.format}, {inspection.duration:.1f} s, of these {inspection.free_flight:.1f} s of free flight; "
        f"pose: {inspection.pose_source}"
    )
    findings = html.Ul(
        [
            html.Li([html.B(f"{f.severity}: "), f.text, f". To do: {f.advice}." if f.advice else ""])
            for f in inspection.findings
        ]
    )
    pictures = checked.pictures[number] if number < len(checked.pictures) else {}
    drawn = [
        graph(f"check-{number}-{key}", figure_of(picture, scheme), picture.description)
        for key, picture in pictures.items()
    ]
    return card(
        info.name,
        dmc.Group([badge(inspection.verdict), dmc.Text(inspection.sentence, fw=600)]),
        dmc.Text(facts, size="sm", c="dimmed"),
        findings if inspection.findings else dmc.Text("Nothing was found wrong with it.", c="dimmed"),
        _advice(inspection),
        table(
            f"check-{number}-effects",
            [{"effect": e.name, "answer": e.answer, "why": e.why} for e in (*able, *unable)],
            [
                {"field": "effect", "headerName": "effect", "maxWidth": 230},
                {"field": "answer", "headerName": "can it be identified?", "maxWidth": 190},
                {"field": "why", "headerName": "why"},
            ],
        ),
        grid(*drawn) if drawn else None,
        _channels(number, inspection),
    )


def _hypotheses(info: FlightInfo) -> Any:
    """Statements about columns that are not what they declare, each with its evidence and what repairs it."""
    if not info.hypotheses:
        return None
    lines = [
        html.Li(
            [
                html.B(f"{one.text}. "),
                f"Evidence: {one.evidence}." if one.evidence else "",
                html.Pre(one.repair, className="command") if one.repair else " Convert it, or give a column mapping.",
            ]
        )
        for one in info.hypotheses
    ]
    convention = dmc.Text("Wanted: SI units, ENU and FLU, by one clock.", size="sm")
    title = "Columns of this log are not what they declare"
    return dmc.Alert([html.Ul(lines), convention], title=title, color="red", variant="light")


def _repair(number: int, command: str) -> Any:
    """The command that writes the repairs of a log, and what to do with its file."""
    return card(
        "Repair it",
        command_box(command, name=f"check-{number}-repair", label="Write a mapping file with these repairs:"),
        dmc.Text("Then name that file under Column mapping in step 1: the logs are read by it.", size="sm"),
    )


def _advice(inspection: Inspection) -> Any:
    if not inspection.advice:
        return None
    return dmc.Alert(html.Ul([html.Li(line) for line in inspection.advice]), title="For a better log", variant="light")


def _channels(number: int, inspection: Inspection) -> Any:
    rows = [
        {"channel": c.quantity, "rate": f"{c.rate:.0f} Hz", "gap": f"{1e3 * c.longest_gap:.0f} ms", "note": c.source}
        for c in inspection.channels
    ]
    listed = table(
        f"check-{number}-channels",
        rows,
        [
            {"field": "channel", "headerName": "channel"},
            {"field": "rate", "headerName": "rate", "maxWidth": 120},
            {"field": "gap", "headerName": "largest gap", "maxWidth": 140},
            {"field": "note", "headerName": "source"},
        ],
    )
    panel = dmc.AccordionItem([dmc.AccordionControl("Channels, rates and gaps"), dmc.AccordionPanel(listed)], value="c")
    return dmc.Accordion([panel], chevronPosition="left")
