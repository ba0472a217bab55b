"""From dropping a log to the fallen error, by clicks, in a browser, on short flights and three formats of PX4 logs."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect

from tests.studio.app.drawn import WIDTHS, require_drawn
from tests.support.results_on_disk import evaluation_file, fleet_folder, sweep_folder
from training.progress_file import append, begin
from training.reports import Report

RECORDING = Path(__file__).parents[2] / "data" / "recorded_flight" / "flight.mcap"
SCREEN = {1280: 900}  # px
PATIENCE = 120_000  # ms on a busy machine; alone the longest step takes some seconds
expect.set_options(timeout=PATIENCE)


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    opened = browser.new_page(viewport={"width": 1280, "height": 900})
    opened.set_default_timeout(PATIENCE)
    errors: list[str] = []
    opened.on("pageerror", lambda error: errors.append(f"{error}\n{error.stack}"))
    opened.on("requestfailed", lambda request: errors.append(f"{request.url}: {request.failure}"))
    opened.on("request", lambda request: _require_local(request.url, errors))
    yield opened
    opened.close()
    faults = [e for e in errors if "net::ERR_ABORTED" not in e]
    assert not faults, "\n".join(faults)


def _require_local(url: str, errors: list[str]) -> None:
    if not url.startswith(("http://127.0.0.1:", "data:", "blob:")):
        errors.append(f"the page asked for {url}")


def _drop(page: Page, zone: str, files: list[Path]) -> None:
    """Choose files, which is what dropping them does."""
    with page.expect_file_chooser() as chosen:
        page.locator(f"#{zone} .choose").click()
    chosen.value.set_files([str(path) for path in files])


def _go(page: Page, step: str) -> None:
    page.locator(f"#step-{step}").click()
    expect(page.locator(f"#step-{step}")).to_have_attribute("aria-current", "step")


def _wait(page: Page, step: str, status: str) -> None:
    expect(page.locator(f"#step-{step}")).to_have_attribute("data-status", status)


def _require_accessible(page: Page) -> None:
    """No finding of axe-core that is serious or critical."""
    page.wait_for_timeout(1000)
    findings = [v for v in Axe().run(page).response["violations"] if v["impact"] in ("serious", "critical")]
    assert not findings, [(v["id"], v["nodes"][0]["html"]) for v in findings]


def _use_vehicle(page: Page, name: str = "px4_sih") -> None:
    """Choose a bundled vehicle; nothing moves under a click on its way when the logs are checked."""
    use = page.get_by_role("button", name="Use it")
    before = use.bounding_box()
    _wait(page, "check", "done")
    expect(page.locator("#work [role=progressbar]")).to_have_count(0)
    assert use.bounding_box() == before
    page.get_by_role("textbox", name="A bundled vehicle").click()
    page.get_by_role("option", name=name).click()
    use.click()


def _numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"(\d+(?:\.\d+)?) cm", text)]


@pytest.mark.long("from logs to a version that has flown, by clicks")
@pytest.mark.parametrize(
    ("logs", "vehicle"),
    [
        ("short_logs", "arpl_250g"),
        *(pytest.param(kind, "px4_sih", marks=pytest.mark.slow) for kind in ("ulogs", "csvs", "recordings")),
    ],
    ids=("short flights", "ulogs", "csvs", "recordings"),
)
@pytest.mark.timeout(600)
def test_a_log_becomes_a_better_model_by_clicks(
    page: Page, address: str, logs: str, vehicle: str, request: pytest.FixtureRequest
) -> None:
    files: list[Path] = request.getfixturevalue(logs)
    widths = SCREEN if logs in ("csvs", "recordings") else WIDTHS  # the pictures of all are the same
    page.goto(address)
    if logs == "csvs":  # one of them in the dark scheme, for its contrasts
        page.get_by_label("dark").check(force=True)
        expect(page.locator("html")).to_have_attribute("data-mantine-color-scheme", "dark")
    page.get_by_label("Name").fill(f"journey {logs}")
    page.get_by_role("button", name="New case").click()
    _drop(page, "drop-logs", files)
    expect(page.locator("#log-lines .scatterlayer .trace").first).to_be_visible(timeout=PATIENCE)
    _use_vehicle(page, vehicle)
    _wait(page, "compare", "done")
    assert require_drawn(page, widths) == ["log-lines"]

    _go(page, "check")
    expect(page.get_by_text(files[0].name).first).to_be_visible()
    assert len(require_drawn(page, widths)) >= 2 * len(files)
    _require_accessible(page)

    _go(page, "compare")
    expect(page.locator("#compare-lines .scatterlayer .trace").first).to_be_visible()
    assert len(require_drawn(page, widths)) >= 7
    cells = page.locator("#compare-map .heatmaplayer")
    expect(cells).to_be_visible()
    cells.scroll_into_view_if_needed()
    box = cells.bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + 0.9 * box["width"], box["y"] + 0.03 * box["height"])  # the fastest flight
    expect(page.locator("#cell-seconds")).to_contain_text("shaded above")
    _require_accessible(page)

    _go(page, "diagnose")
    page.get_by_role("button", name="Diagnose", exact=True).click()
    expect(page.locator("#verdict-sentence")).to_contain_text("linear_drag")
    expect(page.locator("#evidence-lines .scatterlayer .trace").first).to_be_visible()
    readout = page.locator("#evidence-readout")
    best = readout.inner_text()
    page.locator(".mantine-Slider-thumb").first.focus()
    page.keyboard.press("ArrowRight")
    expect(readout).not_to_have_text(best)
    assert len(require_drawn(page, widths)) >= 8
    _require_accessible(page)

    _go(page, "add")
    page.get_by_role("button", name=re.compile("^Add .*linear_drag")).click()
    expect(page.locator("#falls .scatterlayer .trace").first).to_be_visible()
    expect(page.locator("#history")).to_contain_text("linear_drag")
    assert require_drawn(page, widths) == ["falls", "last-addition"]
    page.get_by_role("button", name="Undo").click()
    _wait(page, "add", "open")
    page.get_by_role("button", name="Redo").click()
    _wait(page, "add", "done")
    _wait(page, "compare", "done")

    _go(page, "prove")
    page.get_by_role("button", name="Compare both versions").click()
    expect(page.locator("#open-loop .scatterlayer .trace").first).to_be_visible()
    expect(page.locator("#proved")).to_contain_text(re.compile(r"-[4-9]\d"))  # per cent of a channel's error
    page.get_by_role("button", name="Fly it on the mock").click()
    _require_accessible(page)
    before, after = _numbers(page.locator(".flown").inner_text())
    assert len(require_drawn(page, widths)) == 2
    assert after < 0.5 * before


def test_the_browser_has_the_token_nowhere_and_runs_no_text(page: Page, browser: Browser, address: str) -> None:
    place, _, token = address.partition("?token=")
    page.goto(address)
    page.get_by_role("button", name="New case").click()
    expect(page.get_by_text("No log yet.")).to_be_visible()
    assert token not in page.url
    assert token not in page.content()
    assert page.evaluate("document.cookie") == ""  # HttpOnly
    (cookie,) = page.context.cookies()
    assert token not in cookie["value"]
    assert (cookie["httpOnly"], cookie["sameSite"]) == (True, "Strict")
    add = "code => { const s = document.createElement('script'); s.text = code; document.head.append(s); }"
    page.evaluate(add, "window.ran = true")
    assert page.evaluate("window.ran") is None
    stranger = browser.new_context()
    answer = stranger.request.get(place)
    assert (answer.status, answer.body()) == (401, b"")
    stranger.close()


def test_a_file_that_is_no_log_is_refused_on_the_page_and_the_page_lives_on(
    page: Page, address: str, tmp_path: Path, short_logs: list[Path]
) -> None:
    bad = tmp_path / "no_log.csv"
    bad.write_text("a,b\n1,2\n")
    page.goto(address)
    page.get_by_role("button", name="New case").click()
    _drop(page, "drop-logs", [bad])
    expect(page.get_by_text("no_log.csv").first).to_be_visible()
    expect(page.locator("#main")).to_contain_text("is a text table, but its columns")
    _drop(page, "drop-logs", short_logs[:1])
    expect(page.locator("#log-lines .scatterlayer .trace").first).to_be_visible(timeout=PATIENCE)


def test_a_case_that_is_opened_again_stands_where_it_stood(
    page: Page, browser: Browser, address: str, short_logs: list[Path]
) -> None:
    page.goto(address)
    page.get_by_label("Name").fill("again")
    page.get_by_role("button", name="New case").click()
    _drop(page, "drop-logs", short_logs[:1])
    _wait(page, "check", "done")
    place = page.url
    other = browser.new_page()
    other.goto(address)
    other.goto(place)
    other.set_default_timeout(PATIENCE)
    expect(other.locator("#step-check")).to_have_attribute("data-status", "done")
    other.goto(address)
    other.get_by_role("button", name="New case").click()
    expect(other.get_by_text("No log yet.")).to_be_visible(timeout=PATIENCE)
    expect(page.get_by_text(short_logs[0].name).first).to_be_visible()  # two windows on two cases do not mix
    other.close()


@pytest.mark.long("a diagnosis of a log of PX4")
def test_a_browser_that_is_closed_in_the_middle_of_a_fit_finds_the_result_later(
    page: Page, browser: Browser, address: str, ulogs: list[Path]
) -> None:
    page.goto(address)
    page.get_by_role("button", name="New case").click()
    _drop(page, "drop-logs", ulogs[:1])
    page.get_by_role("button", name="Made from the autopilot's parameters").click()
    page.get_by_label("Name").fill("half typed")
    expect(page.locator("#log-lines .scatterlayer .trace").first).to_be_visible()
    expect(page.get_by_label("Name")).to_have_value("half typed")  # what was read meanwhile leaves it
    _use_vehicle(page)
    _wait(page, "compare", "done")
    _go(page, "diagnose")
    page.get_by_role("button", name="Diagnose", exact=True).click()
    _wait(page, "diagnose", "running")
    endless = "document.getAnimations().filter(a => a.effect.getTiming().iterations === Infinity).length"
    assert page.evaluate(endless) == 0  # without a GPU each takes half a processor from the work
    place = page.url
    page.close()
    later = browser.new_page()
    later.goto(address)
    later.goto(place)
    _wait(later, "diagnose", "done")
    expect(later.locator("#verdict-sentence")).to_contain_text("linear_drag")
    later.close()


def test_points_of_lines_that_are_gone_are_dropped(page: Page, address: str, short_logs: list[Path]) -> None:
    page.goto(address)
    page.get_by_role("button", name="New case").click()
    _drop(page, "drop-logs", short_logs[:1])
    expect(page.locator("#log-lines .scatterlayer .trace").first).to_be_visible(timeout=PATIENCE)
    plot = page.locator("#log-lines .js-plotly-plot")
    count = plot.evaluate("e => e.data.length")
    points = "{graph: 'log-lines', key: KEY, places: [PLACE], x: [X], y: [X], layout: {}}".replace(
        "X", "{dtype: 'f8', bdata: btoa('\\0'.repeat(16))}"
    )
    redraw = f"e => window.dash_clientside.studio.redraw({points})"
    plot.evaluate(redraw.replace("KEY", "'of other lines'").replace("PLACE", str(count + 3)))
    assert plot.evaluate("e => e.data.length") == count
    assert plot.evaluate("e => e.data[0].x.length") != 2
    plot.evaluate(redraw.replace("KEY", "e.layout.meta.lines").replace("PLACE", "0"))
    assert plot.evaluate("e => e.data[0].x.length") == 2


def test_a_picture_is_saved_as_it_is_seen(page: Page, address: str, short_logs: list[Path], tmp_path: Path) -> None:
    page.goto(address)
    page.get_by_label("Name").fill("papers")
    page.get_by_role("button", name="New case").click()
    _drop(page, "drop-logs", short_logs[:1])
    lines = page.locator("#log-lines .js-plotly-plot")
    expect(page.locator("#log-lines .scatterlayer .trace").first).to_be_visible()
    _wait(page, "check", "done")
    began = lines.evaluate("e => e.calcdata[0][0].x")
    lines.evaluate("e => window.Plotly.relayout(e, {'xaxis.range': [3, 5]})")
    page.wait_for_function(f"() => document.querySelector('#log-lines .js-plotly-plot').calcdata[0][0].x !== {began}")
    picture = page.locator(".picture", has=page.locator("#log-lines"))
    for kind, magic in {"png": b"\x89PNG", "svg": b"<svg", "pdf": b"%PDF"}.items():
        with page.expect_download() as saved:
            picture.get_by_role("button", name=kind.upper(), exact=True).click()
        assert saved.value.suggested_filename == f"papers_log_lines.{kind}"
        file = tmp_path / saved.value.suggested_filename
        saved.value.save_as(file)
        assert file.read_bytes().startswith(magic)
    drawn = (tmp_path / "papers_log_lines.svg").read_text()
    assert ">3.5<" in drawn  # a tick of the zoom
    assert "<image" not in drawn  # vectors


def test_a_result_is_shown_from_its_path_and_followed(page: Page, address: str, tmp_path: Path) -> None:
    course = tmp_path / "m.progress.jsonl"
    begin(course, 1, "alula train", resume=False)
    append(course, Report(0, 100, 400, 0.5, None, 0.4, 0.4, 1e-3))
    page.goto(address)
    path = page.get_by_label("Path")
    path.fill(str(tmp_path / "none"))
    page.get_by_role("button", name="Open", exact=True).click()
    expect(page.get_by_text("is not there")).to_be_visible()
    path.fill(str(tmp_path / "m.pt"))
    page.get_by_role("button", name="Open", exact=True).click()
    expect(page.locator("h1")).to_have_text("Training of m.pt")
    expect(page.locator("#result-share")).to_contain_text("25 %")
    append(course, Report(0, 200, 400, 0.5, None, 0.3, 0.3, 1e-3))
    expect(page.locator("#result-share")).to_contain_text("50 %")
    expect(page.locator("#result-0 .scatterlayer .trace").first).to_be_visible()
    _require_accessible(page)


def test_a_fleet_a_sweep_and_an_evaluation_are_shown_by_their_paths(page: Page, address: str, tmp_path: Path) -> None:
    paths = {
        "fleet": fleet_folder(tmp_path / "fleet"),
        "sweep": sweep_folder(tmp_path / "sweep"),
        "held-out flights": evaluation_file(tmp_path),
    }
    for title, path in paths.items():
        page.goto(address)
        page.get_by_label("Path").fill(str(path))
        page.get_by_role("button", name="Open", exact=True).click()
        expect(page.locator("h1")).to_contain_text(title, ignore_case=True)
        expect(page.locator("#result-table-0 .ag-row").first).to_be_visible()
        _require_accessible(page)
    page.get_by_role("link", name=re.compile("^fleet ")).click()
    page.get_by_role("button", name="Open it as a case").click()
    expect(page.locator("#step-log")).to_have_attribute("aria-current", "step")
    expect(page.locator("#main")).to_contain_text("a.csv")


def test_a_recording_is_flown_again_and_opens_as_a_case(page: Page, address: str, tmp_path: Path) -> None:
    recording = shutil.copy(RECORDING, tmp_path)
    page.goto(address)
    page.get_by_label("Path").fill(str(recording))
    page.get_by_role("button", name="Open", exact=True).click()
    expect(page.locator("h1")).to_contain_text("flight.mcap")
    page.get_by_role("button", name="Fly it again").click()
    expect(page.locator("#replayed")).to_contain_text("setpoints compared")
    page.get_by_role("button", name="Open it as a case").click()
    expect(page.locator("#step-log")).to_have_attribute("aria-current", "step")
    expect(page.get_by_text("flight.mcap").first).to_be_visible()
