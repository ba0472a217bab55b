"""Step 4: the verdict, and the ranking with the evidence of each effect."""

from __future__ import annotations

from typing import Any

import dash_mantine_components as dmc
from dash import dcc, html

from diagnosis.report import in_flight_sentence, refusal_sentence, score_sentence
from studio.app.heads import head, lock, refusal
from studio.app.opened import OpenCase
from studio.app.parts import action, badge, card, command_box, graph, grid, out_of_date, table
from studio.app.theme import figure_of
from studio.work.results import FOLLOWED, Diagnosed


def layout(opened: OpenCase, name: str, scheme: str) -> Any:
    """Verdict, ranking, evidence of one effect."""
    parts = head(opened, "Which effect is missing?")
    if refused := refusal(opened, "diagnose", "These flights cannot answer", colour="red"):
        return dmc.Stack(parts + refused, gap="md")
    diagnosed = opened.result(Diagnosed, "diagnose")
    running = opened.job is not None and opened.job.step == "diagnose"
    if diagnosed is None:
        if locked := lock(opened, "diagnose"):
            parts += locked
        elif not running:
            text = "All effects of the catalogue compete over the flights; held-out flights decide."
            parts += [dmc.Text(text), action("start", "Diagnose", step="diagnose")]
        parts.append(command_box(opened.command("diagnose")))
        return dmc.Stack(parts, gap="md")
    if not opened.is_fresh("diagnose"):
        parts.append(out_of_date("diagnose", running=running))
    parts += [
        _verdict(diagnosed, name),
        card("Error of each channel, held out", _picture(diagnosed, "bars", scheme)),
        _ranking(diagnosed),
        html.Div(id="evidence"),
        dcc.Store(id="evidence-shown"),
        grid(
            card("Residual spectra against the noise", _picture(diagnosed, "spectrum", scheme)),
            card(
                "Who cannot be told from whom",
                _picture(diagnosed, "likeness", scheme),
                note="Share of its signal that each effect has in common with each other on these flights.",
            ),
        ),
        *(
            card("What the model followed in flight", _picture(diagnosed, key, scheme), note="Dashed: the diagnosis.")
            for key in diagnosed.pictures
            if key.startswith(FOLLOWED)
        ),
        command_box(opened.command("diagnose")),
    ]
    return dmc.Stack(parts, gap="md")


def _picture(diagnosed: Diagnosed, key: str, scheme: str) -> Any:
    picture = diagnosed.pictures[key]
    return graph(f"diagnose-{key}", figure_of(picture, scheme), picture.description)


def _verdict(diagnosed: Diagnosed, name: str) -> Any:
    """The sentence first, then what is left and what to do."""
    diagnosis = diagnosed.diagnosis
    parts: list[Any] = [
        dmc.Group([badge(diagnosis.verdict), dmc.Text(diagnosed.sentence, fw=600, size="lg", id="verdict-sentence")])
    ]
    if diagnosed.leftovers:
        parts += [dmc.Text("What is left:"), html.Ul([html.Li(line) for line in diagnosed.leftovers])]
    hints = [refusal_sentence(r, diagnosis.rotors) for r in diagnosis.refused if r.is_hint]
    if hints:
        parts += [dmc.Text("Hints, for which these flights are too few:"), html.Ul([html.Li(h) for h in hints])]
    if diagnosis.in_flight:
        texts = [in_flight_sentence(one, diagnosis.rotors) for one in diagnosis.in_flight]
        parts += [dmc.Text("Beside what the model followed in flight:"), html.Ul([html.Li(text) for text in texts])]
    if diagnosis.held_out_score is not None:
        parts.append(dmc.Text(f"{score_sentence(diagnosis.held_out_score)}."))
    if diagnosis.not_excited:
        text = f"Not excited, so neither present nor absent: {', '.join(diagnosis.not_excited)}."
        parts.append(dmc.Text(text, size="sm", c="dimmed"))
    parts += [html.Ul([html.Li(note) for note in diagnosed.notes])] if diagnosed.notes else []
    if diagnosis.next_flight:
        parts.append(dmc.Text([html.B("Next flight: "), diagnosis.next_flight]))
    if diagnosed.addable:
        parts.append(dcc.Link("Next: add it and watch the error fall", href=f"/case/{name}/add"))
    return card("The verdict", *parts)


def _ranking(diagnosed: Diagnosed) -> Any:
    rows = [
        {
            "effect": one.key + (" (yours)" if one.own else ""),
            "key": one.key,
            "outcome": one.outcome.replace("_", " "),
            "score": one.score,
            "value": one.value,
            "reason": one.reason,
            "summary": one.summary,
        }
        for one in diagnosed.ranking
    ]
    columns: list[dict[str, Any]] = [
        {"field": "effect", "headerName": "effect", "pinned": "left", "width": 190},
        {"field": "outcome", "headerName": "outcome", "width": 120},
        {
            "field": "score",
            "headerName": "log odds",
            "width": 120,
            "type": "numericColumn",
            "valueFormatter": {"function": "params.value == null ? '' : d3.format(',.4~g')(params.value)"},
        },
        {"field": "value", "headerName": "value", "flex": 2},
        {"field": "reason", "headerName": "why not", "flex": 3},
        {"field": "summary", "headerName": "what it is", "flex": 2},
    ]
    return card(
        "Ranking",
        table(
            "ranking",
            rows,
            columns,
            height=420,
            options={"rowSelection": {"mode": "singleRow", "checkboxes": False, "enableClickSelection": True}},
            selectedRows=rows[:1],
            getRowId="params.data.key",
        ),
        note="Select an effect to see what it explains, and to try other values of it by hand.",
    )
