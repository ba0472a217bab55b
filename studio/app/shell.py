"""The frame of every page: steps on the left, what runs at the top, and the actions that change a case."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import dash
import dash_mantine_components as dmc
from dash import ALL, Input, Output, State, ctx, dcc, html, no_update

from dynamics.errors import AlulaError, RequestError
from studio.app import (
    add_page,
    check_page,
    compare_page,
    diagnose_page,
    evidence_card,
    home_page,
    log_page,
    prove_page,
    result_page,
)
from studio.app.opened import PAGES, OpenCase, page_of
from studio.app.parts import message
from studio.app.place import opened_at, place_of, result_of
from studio.app.studio import Studio
from studio.app.theme import EMPTY

TICK = 250  # ms between two looks at what runs
LABELS = {
    "log": ("Log", "flights and vehicle"),
    "check": ("Check", "good for what?"),
    "compare": ("Compare", "model and measurement"),
    "diagnose": ("Diagnose", "which effect is missing?"),
    "add": ("Add", "and watch the error fall"),
    "prove": ("Prove", "held out, and in flight"),
}
MARKS = {"done": "✓", "running": "…", "locked": "–", "refused": "!", "out of date": "↻", "open": "○"}
COLOURS = {
    "done": "teal",
    "running": "blue",
    "refused": "red",
    "out of date": "yellow",
    "locked": "gray",
    "open": "blue",
}
CASE_PAGES: Mapping[str, Callable[[OpenCase, str, str], Any]] = {
    "log": log_page.layout,
    "check": check_page.layout,
    "compare": compare_page.layout,
    "diagnose": diagnose_page.layout,
    "add": add_page.layout,
    "prove": prove_page.layout,
}


def build(app: dash.Dash, studio: Studio) -> None:
    """Set the app's layout and callbacks."""
    app.layout = _frame
    app.index_string = app.index_string.replace("<html>", '<html lang="en">')
    app.callback(
        Output("navigation", "children"),
        Output("heading", "children"),
        Output("main", "children"),
        Output("signature", "data"),
        Input("revision", "data"),
        Input("url", "pathname"),
        Input("scheme", "data"),
        State("signature", "data"),
    )(lambda *arguments: _show(studio, *arguments))
    app.callback(
        Output("work", "children"),
        Output("revision", "data"),
        Input("tick", "n_intervals"),
        State("url", "pathname"),
        State("revision", "data"),
    )(lambda _, path, last: _look(studio, path, last))
    app.callback(
        Output("notices", "sendNotifications"),
        Output("url", "pathname"),
        Input({"act": ALL, "step": ALL, "value": ALL}, "n_clicks"),
        State("url", "pathname"),
        State({"field": ALL}, "value"),
        State({"field": ALL}, "id"),
        prevent_initial_call=True,
    )(lambda clicks, path, values, names: _act(studio, clicks, path, values, names))
    app.callback(
        Output("theme", "forceColorScheme"),
        Output("scheme", "data"),
        Input("scheme-switch", "checked"),
    )(lambda dark: ("dark", "dark") if dark else ("light", "light"))
    for page in (log_page, compare_page, evidence_card):
        page.register(app, studio)
    result_page.register(app)


def _frame() -> Any:
    """The layout that stays."""
    header = dmc.Group(
        [
            dcc.Link(dmc.Text("Alula studio", fw=700, size="lg"), href="/", className="home"),
            html.Div(id="heading"),
            dmc.Switch(id="scheme-switch", label="dark", persistence=True, persistence_type="local", checked=False),
        ],
        justify="space-between",
        h="100%",
        px="md",
        wrap="nowrap",
    )
    return dmc.MantineProvider(
        id="theme",
        forceColorScheme="light",
        theme={"primaryColor": "blue", "primaryShade": {"light": 8, "dark": 8}},
        children=[
            dcc.Location(id="url"),
            dcc.Interval(id="tick", interval=TICK),
            dcc.Store(id="revision"),
            dcc.Store(id="signature"),
            dcc.Store(id="scheme", data="light"),
            html.Div(dcc.Graph(figure=EMPTY), hidden=True),  # so that Plotly is there when the first picture is
            dmc.NotificationContainer(id="notices", position="bottom-right", autoClose=8000),
            dmc.AppShell(
                [
                    dmc.AppShellHeader(header),
                    dmc.AppShellNavbar(html.Nav(id="navigation", **{"aria-label": "steps"}), p="sm"),
                    dmc.AppShellMain([html.Div(id="main"), html.Div(id="work", **{"aria-live": "polite"})]),
                ],
                header={"height": 56},
                navbar={"width": 220, "breakpoint": "sm", "collapsed": {"mobile": False}},
                padding="md",
                className="shell",
            ),
        ],
    )


def _show(studio: Studio, revision: Any, path: str, scheme: str, last: str | None) -> tuple[Any, ...]:
    if result_of(path):
        return _show_result(studio, path, scheme, last)
    name, page = place_of(path)
    if not name:
        signature = f"home {len(studio.entries())} {len(studio.results)} {scheme}"
        return (), "", no_update if signature == last else home_page.layout(studio), signature
    try:
        opened = studio.case(name)
    except AlulaError as error:
        return (), "", message(str(error), title="This case cannot be opened", colour="red"), ""
    if opened is None:
        return (), "", message("There is no such case on this computer.", title="No case", colour="red"), ""
    try:
        signature = f"{path} {scheme} {signature_of(opened, page)}"
        main = no_update if signature == last else CASE_PAGES[page](opened, name, scheme)
        return _navigation(opened, name, page), _heading(opened, name), main, signature
    except AlulaError as error:  # a file of the case that is gone, or a link out of it
        return (), "", message(str(error), title="This page cannot be shown", colour="red"), ""


def _show_result(studio: Studio, path: str, scheme: str, last: str | None) -> tuple[Any, ...]:
    name = result_of(path)
    place = studio.results.get(name)
    if place is None:
        return (), "", message("There is no such result open. Open it on the first page.", title="No result"), ""
    signature = f"{path} {scheme} {result_page.signature(studio, place)}"
    links = [
        dmc.NavLink(label=one.name, description=str(one.parent), href=f"/result/{key}", active=key == name)
        for key, one in studio.results.items()
    ]
    main = no_update if signature == last else result_page.layout(studio, place, scheme)
    return [dcc.Link("All cases and results", href="/"), *links], dmc.Text(place.name, fw=600), main, signature


def signature_of(opened: OpenCase, page: str) -> str:
    """Signature of a page; while it stays the same the page is left as the user has it."""
    case = opened.case
    state = case.state
    if page == "log":  # what is read from the logs has parts of its own
        return repr([state.current, state.options, state.vehicle, state.effect_files])
    running = opened.job.step if opened.job is not None else ""
    parts: list[Any] = [
        opened.status(page),
        running == page,
        opened.failure,
        opened.lock_reason(page),
        case.key("prove"),
    ]
    parts += [case.shown_result(step) for step in ("check", "compare", "diagnose", "prove")]
    parts += [state.current, state.undone, state.options, state.vehicle, case.has_result("flights")]
    if page == "add":
        parts.append(opened.refusal("add"))
    if page == "prove":
        parts += [running, *(p.name for p in sorted((case.folder / "results").glob("fly-*")))]
        parts.append(case.has_result("export"))
    return repr(parts)


def _look(studio: Studio, path: str, last: Any) -> tuple[Any, Any]:
    """Running job, and whether anything changed."""
    result = studio.results.get(result_of(path))
    if result is not None:
        revision: Any = result_page.signature(studio, result)
        return None, revision if revision != last else no_update
    opened = opened_at(studio, path)
    if opened is None:
        return None, no_update
    job = opened.job
    revision = [opened.case.revision, job.step if job else "", opened.failure]
    bar = None
    if job is not None:
        label, effect = LABELS.get(page_of(job.step), (job.step, ""))[0], job.step.partition(":")[2]
        seconds = time.monotonic() - job.began
        text = f"{label}{f' ({effect})' if effect else ''}: {job.stage} — {100 * job.share:.0f} %, {seconds:.0f} s"
        progress = dmc.Progress(value=100 * job.share, size="md", **{"aria-label": text})
        stop = dmc.Button(
            "Cancel", id={"act": "cancel", "step": "", "value": ""}, size="compact-sm", variant="default", n_clicks=0
        )
        bar = dmc.Paper(
            dmc.Stack([dmc.Group([dmc.Text(text, size="sm"), stop], justify="space-between"), progress], gap=4),
            withBorder=True,
            p="xs",
            mb="sm",
        )
    return bar, revision if revision != last else no_update


def _navigation(opened: OpenCase, name: str, page: str) -> Any:
    """The path of six steps."""
    links = []
    for number, step in enumerate(PAGES, start=1):
        status, (label, about) = opened.status(step), LABELS[step]
        mark = dmc.ThemeIcon(
            MARKS[status], size="md", radius="xl", color=COLOURS[status], variant="light", autoContrast=True
        )
        links.append(
            dmc.NavLink(
                id=f"step-{step}",
                label=f"{number}. {label}",
                description=status if status in ("running", "out of date", "refused") else about,
                leftSection=mark,
                href=f"/case/{name}/{step}",
                active=step == page,
                disabled=status == "locked",
                **{
                    "data-status": status,
                    "aria-current": "step" if step == page else "false",
                    "aria-disabled": str(status == "locked").lower(),
                },
            )
        )
    return links


def _heading(opened: OpenCase, name: str) -> Any:
    """Case, vehicle and version, and the case as a file."""
    case, version = opened.case, opened.case.version
    vehicle = "no vehicle yet" if version is None else f"{case.vehicle_name()}, version {version.number}"
    send = html.A("Send the case as one file", href=f"/case/{name}/archive", download=True, className="send")
    script = html.A("Save it as a script", href=f"/case/{name}/script.sh", download=True, className="send")
    links = [send] if version is None else [send, script]
    return dmc.Group([dmc.Text(case.state.name, fw=600), dmc.Text(vehicle, c="dimmed", size="sm"), *links], gap="md")


def _act(studio: Studio, clicks: list[Any], path: str, values: list[Any], names: list[Any]) -> tuple[Any, Any]:
    """Do what a button is for. A refusal is shown as the error's message."""
    trigger = ctx.triggered_id
    if not trigger or not ctx.triggered or not ctx.triggered[0]["value"]:
        return no_update, no_update
    fields = {name["field"]: value for name, value in zip(names, values, strict=True)}
    name, _ = place_of(path)
    try:
        if trigger["act"] == "create":
            return no_update, f"/case/{studio.create(name=str(fields.get('case-name') or 'case'))}/log"
        if trigger["act"] == "example":
            return no_update, f"/case/{studio.open_example()}/log"
        if trigger["act"] == "open-result":
            return no_update, f"/result/{studio.open_result(Path(str(fields.get('result-path') or '')))}"
        if trigger["act"] == "open-log":
            return no_update, f"/case/{_case_of_log(studio, Path(str(fields['result-log'])))}/log"
        if trigger["act"] == "replay":
            studio.replays.start(Path(trigger["value"]))
            return no_update, no_update
        opened = studio.case(name)
        if opened is None:
            return no_update, no_update
        _change(opened, trigger["act"], trigger["step"], trigger["value"], fields)
    except AlulaError as error:
        return [_notice(str(error))], no_update
    return no_update, no_update


def _case_of_log(studio: Studio, log: Path) -> str:
    """A new case with a flight of a result."""
    name = studio.create(name=log.name.partition(".")[0])
    opened = studio.case(name)
    if opened is None:
        raise RequestError(f"the case of {log} cannot be opened.")
    opened.case.add_logs([log])
    opened.start("check")
    return name


def _notice(text: str) -> dict[str, Any]:
    return {"action": "show", "title": "Not done", "message": text, "color": "red", "autoClose": False}


def _change(opened: OpenCase, act: str, step: str, value: str, fields: dict[str, Any]) -> None:
    case = opened.case
    match act:
        case "start":
            effect = value if step in ("explain", "add") else ""
            opened.start(step, effect=effect, reference=str(fields.get("reference") or "") if step == "fly" else "")
        case "cancel":
            opened.cancel()
        case "undo":
            case.undo()
        case "redo":
            case.redo()
        case "remove-log":
            case.remove_log(value)
            if case.state.logs:
                opened.start("check")
        case "vehicle" | "make-vehicle" | "flown-vehicle" | "options":
            log_page.change(opened, act, value, fields)
