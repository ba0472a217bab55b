"""Step 1: logs and vehicle; the flights are drawn as soon as they are read."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import dash
import dash_mantine_components as dmc
import msgspec
import plotly.graph_objects as go
from dash import Input, Output, State, dcc, html, no_update

from dynamics.autopilot_frames import FRAMES
from dynamics.errors import RequestError
from dynamics.files import write_whole
from dynamics.vehicle_file import vehicle_name, with_effect_files, without_effect_files
from studio.app import redraw
from studio.app.opened import OpenCase
from studio.app.parts import action, card, command_box, message, sized
from studio.app.place import opened_at, place_of
from studio.app.studio import Studio
from studio.app.theme import LINE_COLOURS, styled
from studio.app.traces import flight_line, window_of, zoomed
from studio.case.case import Case
from studio.case.state import Options
from studio.pages.flight_panels import Panel, PanelLine, height_of, panels_figure, place_legends, shown_panels
from studio.work.results import FlightInfo
from vehicles import FOLDER

OWN_FILE, FROM_LOG = "a file of your own", "made from the log"


def layout(opened: OpenCase, name: str, scheme: str) -> Any:
    """Drop zone, the logs, the vehicle, how logs are read, and the first picture.

    What is read from the logs appears in parts of its own, so that a list that is open and a field that is half typed
    stay as they are.
    """
    shown = _parts_of_logs(opened, name)
    parts = [
        dmc.Title("Logs and vehicle", order=1, size="h2"),
        html.Div(shown["failure"], id="log-failure"),
        card(
            "Flight logs",
            drop_zone(
                "drop-logs",
                f"/case/{name}/upload",
                "Drop logs or a folder here (ULog, CSV, Parquet, MCAP, tlog, DataFlash, blackbox, ROS bag), or",
                many=True,
            ),
            html.Div(shown["list"], id="log-list"),
        ),
        card("Vehicle", *_vehicle_choice(opened, name)),
        html.Div(shown["flights"], id="log-flights"),
        dmc.Accordion([_options_item(opened)], chevronPosition="left"),
        html.Div(shown["next"], id="log-next"),
        dcc.Store(id="log-shown", data=_signatures(opened)),
    ]
    return dmc.Stack(parts, gap="md")


def _parts_of_logs(opened: OpenCase, name: str) -> dict[str, Any]:
    """Parts that depend on the logs and on what was read from them."""
    failure, following = [], []
    if opened.failure:
        failure.append(message(opened.failure, title="The last step failed", colour="red"))
    if opened.case.state.logs and opened.case.version is not None:
        following.append(dcc.Link("Next: is the log good enough?", href=f"/case/{name}/check", className="next"))
        following.append(command_box(opened.command("check")))
    return {"failure": failure, "list": _log_list(opened), "flights": _flight_card(opened), "next": following}


def _signatures(opened: OpenCase) -> list[str]:
    """Of each of these parts; while one stays the same its part is left as the user has it."""
    case = opened.case
    flights = [case.key("flights"), case.has_result("flights")]
    return [repr(part) for part in (opened.failure, flights, flights, case.state)]


def drop_zone(name: str, url: str, text: str, *, many: bool = False, goto: str = "") -> Any:
    """A place to drop files on; each is streamed to the address. goto: page to open then, ANSWER for the answer."""
    choose = html.Button("choose files" if many else "choose a file", type="button", className="choose")
    line = html.Div("", className="answer", role="status")
    data = {"data-url": url, "data-goto": goto, "data-many": "yes" if many else ""}
    return html.Div([html.Div([text + " ", choose]), line], id=name, className="drop", **data)


def _log_list(opened: OpenCase) -> Any:
    state = opened.case.state
    if not state.logs:
        return dmc.Text("No log yet.", c="dimmed")
    flights = opened.flights()
    infos = {info.path: info for info in flights[1]} if flights else {}
    rows = []
    for log, path in zip(state.logs, opened.case.log_paths, strict=True):
        info = infos.get(str(path))
        about = f"{log.size / 1e6:.1f} MB"
        if info is not None and not info.refused:
            about += f", {info.duration:.1f} s at {info.rate:.0f} Hz"
        refused = [dmc.Text(info.refused, c="red", size="sm")] if info is not None and info.refused else []
        remove = dmc.Button(
            "Remove",
            id={"act": "remove-log", "step": "", "value": log.path},
            size="compact-sm",
            variant="default",
            n_clicks=0,
            **{"aria-label": f"remove {Path(log.path).name}"},
        )
        flown = [] if info is None or not info.vehicle else [_flown_offer(info)]
        name = dmc.Text([html.B(Path(log.path).name), f" ({about})"])
        rows.append(html.Li(dmc.Stack([dmc.Group([name, remove, *flown]), *refused], gap=2)))
    return html.Ul(rows)


def _flown_offer(info: FlightInfo) -> Any:
    """A button that takes the vehicle that a recording holds."""
    return dmc.Button(
        f"Use the vehicle that flew it: {vehicle_name(info.vehicle)}",
        id={"act": "flown-vehicle", "step": "", "value": info.path},
        size="compact-sm",
        variant="light",
        n_clicks=0,
    )


def _vehicle_choice(opened: OpenCase, name: str) -> list[Any]:
    state, version = opened.case.state, opened.case.version
    bundled = sorted(path.stem for path in FOLDER.glob("*.toml"))
    now = "none chosen" if version is None else f"{opened.case.vehicle_name()} ({state.vehicle})"
    choose = dmc.Group(
        [
            dmc.Select(
                id={"field": "bundled"},
                label="A bundled vehicle",
                data=bundled,
                value=state.vehicle if state.vehicle in bundled else None,
                searchable=True,
                w=240,
            ),
            action("vehicle", "Use it", variant="light"),
        ],
        align="end",
    )
    made = dmc.Group(
        [
            dmc.TextInput(id={"field": "made-name"}, label="Name", value="vehicle", w=130),
            dmc.NumberInput(id={"field": "made-mass"}, label="Mass as flown, kg", min=0, step=0.01, w=150),
            dmc.Select(
                id={"field": "made-frame"},
                label="Frame (if not in the log)",
                data=list(FRAMES),
                clearable=True,
                w=180,
            ),
            dmc.NumberInput(id={"field": "made-arm"}, label="Arm, m (if not in the log)", min=0, step=0.005, w=190),
            dmc.NumberInput(id={"field": "made-speed"}, label="Full rotor speed, rad/s", min=0, step=10, w=180),
            action("make-vehicle", "Make it from the log", variant="light"),
        ],
        align="end",
    )
    upload = drop_zone("drop-vehicle", f"/case/{name}/vehicle", "Drop a vehicle file (TOML), or")
    effects = drop_zone("drop-effects", f"/case/{name}/effects", "Drop a Python file with effects of your own, or")
    return [
        dmc.Text(["Now: ", html.B(now)]),
        choose,
        dmc.Accordion(
            [
                _item("file", "A file of your own", upload),
                _item("made", "Made from the autopilot's parameters in the log", made),
                _item(
                    "effects", "Effects of your own, which compete with the catalogue's", effects, _effect_list(opened)
                ),
            ],
            chevronPosition="left",
        ),
    ]


def _effect_list(opened: OpenCase) -> Any:
    return html.Ul([html.Li(Path(file).name) for file in opened.case.state.effect_files])


def _item(value: str, label: str, *children: Any) -> Any:
    return dmc.AccordionItem([dmc.AccordionControl(label), dmc.AccordionPanel(list(children))], value=value)


def _options_item(opened: OpenCase) -> Any:
    options = opened.case.state.options
    fields = dmc.Group(
        [
            dmc.Select(
                id={"field": "pose"},
                label="Where the pose comes from",
                data=[
                    {"value": "", "label": "as the log tells"},
                    {"value": "mocap", "label": "motion capture"},
                    {"value": "estimator", "label": "the autopilot's estimator"},
                ],
                value=options.pose,
                w=240,
            ),
            dmc.TextInput(
                id={"field": "hold-out"}, label="Files to hold out", placeholder="hold_*", value=options.hold_out, w=180
            ),
            dmc.TextInput(
                id={"field": "mapping"}, label="Column mapping of a CSV (TOML)", value=options.mapping, w=280
            ),
            action("options", "Use these", variant="light"),
        ],
        align="end",
    )
    return _item("options", "How the logs are read", fields)


def _flight_card(opened: OpenCase) -> Any:
    flights = opened.flights()
    if flights is None:
        return card("Flights", dmc.Text("The logs are drawn here as soon as they are read.", c="dimmed"))
    readable = [(n, info) for n, info in enumerate(flights[1]) if not info.refused]
    if not readable:
        return card("Flights", dmc.Text("None of the logs can be read; each says why above.", c="dimmed"))
    choice = dmc.Select(
        id="log-flight",
        label="Flight",
        data=[{"value": str(number), "label": info.name} for number, info in readable],
        value=str(readable[0][0]),
        allowDeselect=False,
        w=320,
    )
    return card(
        "Flights",
        choice,
        redraw.lines_graph("log-lines", "Lines: the log's quantities over time", _height(readable[0][1])),
        note="Drag to zoom: the lines are drawn again from all rows. Double-click to see the whole flight.",
    )


def register(app: dash.Dash, studio: Studio) -> None:
    """The callbacks of what is read from the logs, and of the first picture."""
    app.callback(
        *(Output(f"log-{part}", "children") for part in ("failure", "list", "flights", "next")),
        Output("log-shown", "data"),
        Input("revision", "data"),
        State("log-shown", "data"),
        State("url", "pathname"),
        prevent_initial_call=True,
    )(lambda _, last, path: _refresh(studio, last, path))
    app.callback(
        Output("log-lines", "figure"),
        Output("log-lines", "style"),
        Input("log-flight", "value"),
        State("url", "pathname"),
        State("scheme", "data"),
    )(lambda flight, path, scheme: _draw(studio, flight, path, scheme))
    app.callback(
        Output(redraw.points_of("log-lines"), "data"),
        Input("log-lines", "relayoutData"),
        State("log-flight", "value"),
        State("url", "pathname"),
        prevent_initial_call=True,
    )(lambda zoom, flight, path: _zoom(studio, zoom, flight, path))
    redraw.register(app, "log-lines")


def _refresh(studio: Studio, last: list[str], path: str) -> tuple[Any, ...]:
    """The parts that have changed, and the signatures of all."""
    opened, (name, _) = opened_at(studio, path), place_of(path)
    if opened is None or (now := _signatures(opened)) == last:
        return (no_update,) * 5
    parts = _parts_of_logs(opened, name).values()
    return *(part if new != old else no_update for part, new, old in zip(parts, now, last, strict=True)), now


def _flight(studio: Studio, flight: str | None, path: str) -> tuple[Path, FlightInfo, int] | None:
    """The folder of the logs' tables, a log, and its place; None where there is none."""
    opened = opened_at(studio, path)
    flights = opened.flights() if opened else None
    if flights is None or flight is None or int(flight) >= len(flights[1]):
        return None
    return flights[0], flights[1][int(flight)], int(flight)


def _draw(studio: Studio, flight: str | None, path: str, scheme: str) -> tuple[Any, Any]:
    there = _flight(studio, flight, path)
    return (no_update, no_update) if there is None else (flight_figure(*there, scheme), sized(_height(there[1])))


def _zoom(studio: Studio, zoom: Any, flight: str | None, path: str) -> Any:
    """The lines again from all rows of the time that is shown."""
    there = _flight(studio, flight, path)
    if there is None or not zoomed(zoom):
        return no_update
    folder, info, number = there
    columns = [line.column for _, lines in panels_of(info) for line in lines]
    lines = [flight_line(folder, info, number, column, window_of(zoom)) for column in columns]
    return redraw.redrawn("log-lines", key_of(info, number), dict(enumerate(lines)))


def panels_of(info: FlightInfo) -> list[tuple[Panel, list[PanelLine]]]:
    """The panels of a log's picture, and the lines in each."""
    return shown_panels({column.name: column.quantity for column in info.columns})


def _height(info: FlightInfo) -> int:
    """The height of a log's picture, px."""
    return height_of(max(1, len(panels_of(info))))


def flight_figure(folder: Path, info: FlightInfo, number: int, scheme: str) -> go.Figure:
    """The quantities of a log over time, a panel each."""
    panels = panels_of(info)

    def points(column: str) -> tuple[Any, Any]:
        line = flight_line(folder, info, number, column)
        return line.x, line.y

    figure = panels_figure(panels, points, LINE_COLOURS)
    styled(figure, scheme, height=_height(info))
    place_legends(figure, range(1, len(panels) + 1))
    figure.update_layout(hovermode="x unified")
    return redraw.keyed(figure, key_of(info, number))


def key_of(info: FlightInfo, number: int) -> str:
    """The key of the lines of a log's picture."""
    return repr((number, info.path, [[line.column for line in lines] for _, lines in panels_of(info)]))


def change(opened: OpenCase, act: str, value: str, fields: dict[str, Any]) -> None:
    """Choose or make a vehicle, or change how logs are read. Raises RequestError and DataError."""
    case = opened.case
    if act == "vehicle":
        if not fields.get("bundled"):
            raise RequestError("no vehicle is selected in the list. Select one, or drop a file.")
        opened.choose_vehicle(lambda: case.set_vehicle(str(fields["bundled"])))
    elif act == "flown-vehicle":
        opened.choose_vehicle(lambda: use_flown_vehicle(opened, value))
    elif act == "make-vehicle":
        name = str(fields.get("made-name") or "vehicle").replace("/", "_")
        opened.make_vehicle(
            name,
            _making(case, fields, case.folder / f"{name}.toml"),
            frame=str(fields.get("made-frame") or ""),
            mass=_number(fields.get("made-mass")),
            arm=_number(fields.get("made-arm")),
            speed_max=_number(fields.get("made-speed")),
        )
        return
    else:
        keys = {"pose": "pose", "hold_out": "hold-out", "mapping": "mapping"}
        values = {name: str(fields.get(field) or "") for name, field in keys.items()}
        case.set_options(msgspec.convert(values, Options))
    if case.state.logs:
        opened.start("check")
        opened.start_if_open("compare")


def use_flown_vehicle(opened: OpenCase, log: str) -> None:
    """Choose the vehicle that a recording holds. log: path of the recording.

    Its list of Python files with effects is left out, since data never runs code: effects of one's own are those that
    the user has dropped. Raises RequestError where it needs others.
    """
    flights = opened.flights()
    flown = next((info.vehicle for info in flights[1] if info.path == log), "") if flights else ""
    if not flown:
        raise RequestError(f"{Path(log).name} holds no vehicle. Choose one in the list, or drop a file.")
    case = opened.case
    text, named = without_effect_files(flown)
    files = [file.path for file in case.effect_files()]
    source = case.folder / f"flown_{Path(log).name.partition('.')[0]}.toml"
    action = f"took the vehicle of {Path(log).name}"
    try:
        case.set_vehicle_text(with_effect_files(text, case.folder, files), source=str(source), action=action)
    except RequestError as error:
        if not named:
            raise
        raise RequestError(
            f"{error} The recording's vehicle names effects of its own in {', '.join(map(repr, named))}: a Python "
            "program, which a recording never runs. If you trust it, drop that file under 'Effects of your own' first."
        ) from error
    write_whole(source, lambda part: part.write_text(text, encoding="utf-8"), advice="Make room on the disk.")


def _making(case: Case, fields: dict[str, Any], path: Path) -> str:
    """The command line that makes the same vehicle."""
    options = {
        "--name": "made-name",
        "--mass": "made-mass",
        "--frame": "made-frame",
        "--arm": "made-arm",
        "--speed-max": "made-speed",
    }
    words = ["alula", "vehicle", "from-log", *map(str, case.log_paths)]
    words += [w for option, field in options.items() if fields.get(field) for w in (option, str(fields[field]))]
    words += ["--mapping", str(case.mapping_path)] if case.mapping_path else []
    return shlex.join([*words, "--out", str(path)])


def _number(value: Any) -> float | None:
    return None if value in (None, "") else float(value)
