"""The pages of compare, diagnose and demo: whole, small, the same numbers as the JSON, drawn without a network."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from diagnosis.comparison import ComparisonDetails
from diagnosis.data.dataset import Dataset
from diagnosis.diagnose import DiagnosisDetails
from dynamics.errors import RequestError
from dynamics.vehicle import Vehicle
from studio.pages.colours import (
    AFTER,
    BEFORE,
    BLACK,
    DARK,
    FLOOR,
    GREEN,
    MEASURED,
    ORANGE,
    PAPER,
    PURPLE,
    SKY,
    TEXT,
)
from studio.pages.evidence import likeness, overlay
from studio.pages.flown import FlownComparison, FlownTrack, best_view, sides_of
from studio.pages.numbers import quantity_shown, shown
from studio.pages.page import Origin, write_page
from studio.pages.provenance import dataset_origin
from studio.pages.report import add_command, comparison_page, demo_page, diagnosis_page
from tests.support.browser import browser, drawn_page, needs_browser

MAX_SIZE = 5_000_000  # bytes
ORIGIN = Origin("alula diagnose <a> & b.csv", "2026-01-01T00:00:00+00:00", {"b.csv": "0" * 64}, "alula add rotor_drag")
SECTIONS = ("errors", "lines", "regions", "ranking", "spectrum", "agreement", "likeness", "history")


def flown() -> FlownComparison:
    time = np.linspace(0, 10, 500)
    reference = np.column_stack([np.sin(time), np.cos(time), np.ones_like(time)])
    return FlownComparison(
        "circle",
        FlownTrack(time, reference + 0.1, reference, 0.173, 0.174, 1.0),
        FlownTrack(time, reference + 0.01, reference, 0.0173, 0.0174, 1.0),
    )


def numbers(page: str) -> set[float]:
    """What the page's tables show, at full precision."""
    return {float(value) for value in re.findall(r'data-value="([^"]+)"', page)}


@pytest.fixture(scope="module")
def pages(
    findings: DiagnosisDetails, compared: ComparisonDetails, dataset: Dataset, vehicle: Vehicle
) -> dict[str, str]:
    return {
        "diagnose": diagnosis_page(findings, dataset, vehicle, origin=ORIGIN),
        "compare": comparison_page(compared, dataset, vehicle, origin=ORIGIN),
        "demo": demo_page([flown()], findings, dataset, origin=ORIGIN, hidden=("rotor_drag",)),
    }


@pytest.mark.parametrize("name", ["diagnose", "compare", "demo"])
def test_a_page_is_one_small_file_that_needs_nothing_else(pages: dict[str, str], name: str) -> None:
    page = pages[name]
    assert len(page.encode()) < MAX_SIZE
    assert not re.search(r"<(script|link|img|iframe)[^>]+(src|href)\s*=", page)
    assert "alula diagnose &lt;a&gt; &amp; b.csv" in page


def test_the_diagnosis_shows_its_sections_in_the_order_of_questions(pages: dict[str, str]) -> None:
    places = [pages["diagnose"].index(f'id="{section}"') for section in SECTIONS]
    assert places == sorted(places)
    assert pages["diagnose"].index("The model misses rotor_drag") < places[0]


def test_the_pages_numbers_are_those_of_the_json(
    pages: dict[str, str], findings: DiagnosisDetails, compared: ComparisonDetails
) -> None:
    diagnosis = findings.diagnosis
    expected = {value for e in diagnosis.channels.values() for value in (e.before, e.after, e.floor)}
    expected |= {p.value for e in diagnosis.effects for p in e.parameters.values()}
    assert expected <= numbers(pages["diagnose"])
    assert expected <= numbers(pages["demo"])
    axes = {value for a in compared.comparison.axes for value in (a.rms, a.floor)}
    assert axes <= numbers(pages["compare"])


def test_the_overlay_is_measured_modelled_and_the_worst_two_seconds(
    findings: DiagnosisDetails, dataset: Dataset
) -> None:
    noise = findings.noise
    view = overlay(dataset.held_out, findings.before, findings.after, noise)
    flown_rows = np.isfinite(view.measured).all(axis=1)
    residual = np.vstack(findings.before)
    np.testing.assert_allclose((view.measured - view.current)[flown_rows], residual, atol=1e-12)
    assert view.left_out == 0
    inside = (view.time >= view.worst[0]) & (view.time < view.worst[1]) & flown_rows
    active = noise.floor > 0
    squares = np.mean(((view.measured - view.current)[:, active] / noise.floor[active]) ** 2, axis=1)
    assert np.mean(squares[inside]) > np.mean(squares[flown_rows])


def test_effects_share_all_with_themselves_and_thrust_with_mass(findings: DiagnosisDetails) -> None:
    pair = tuple(one for one in findings.tried if one.candidate.key in ("mass", "thrust_constant"))
    assert likeness(dataclasses.replace(findings, tried=pair)).shared[0, 1] > 0.9
    likenesses = likeness(findings)
    assert np.diag(likenesses.shared) == pytest.approx(1.0)
    np.testing.assert_allclose(likenesses.shared, likenesses.shared.T)
    assert ((likenesses.shared >= 0) & (likenesses.shared <= 1)).all()


def test_the_command_that_adds_is_the_one_to_type(findings: DiagnosisDetails) -> None:
    options = {
        "--hold-out": "hold*",
        "--effects": [Path("own.py"), Path("other.py")],
        "--mapping": None,
        "--pose": None,
    }
    command = add_command(findings.diagnosis, [Path("a b.csv")], "v.toml", options)
    assert command == ("alula add 'a b.csv' --vehicle v.toml --hold-out 'hold*' --effects own.py --effects other.py")


def test_a_page_that_cannot_be_written_is_a_wrong_request(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="cannot write"):
        write_page("", tmp_path / "no_folder" / "page.html")


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.012345, "0.0123"), (12.3, "12.3"), (2.2e-5, "2.20 × 10⁻⁵"), (0.0, "0"), (float("nan"), "–"), (1234.0, "1,234")],
)
def test_numbers_are_written_for_people(value: float, text: str) -> None:
    assert shown(value) == text


def test_units_stand_behind_a_comma() -> None:
    assert quantity_shown("speed m/s") == "speed, m/s"
    assert quantity_shown("thrust over weight") == "thrust over weight"


CUT = """() => {
  const width = document.documentElement.clientWidth;
  const cut = [...document.querySelectorAll("table")].filter((table) => {
    const place = table.parentElement, right = table.getBoundingClientRect().right;
    return place.clientWidth && (place.scrollWidth > place.clientWidth + 1 || right > width + 1);
  });
  return [document.documentElement.scrollWidth > width, cut.map((table) => table.textContent.trim().slice(0, 40))];
}"""


@needs_browser
@pytest.mark.parametrize(
    "looks",
    [
        pytest.param(((390, True), (1280, False)), id="each width and scheme"),
        pytest.param(((390, False), (1280, True)), id="crossed", marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("name", ["diagnose", "compare", "demo"])
def test_a_page_draws_all_pictures_and_cuts_no_table(
    pages: dict[str, str], name: str, looks: tuple[tuple[int, bool], ...], tmp_path: Path
) -> None:
    path = tmp_path / "page.html"
    write_page(pages[name], path)
    with browser() as started:
        for width, dark in looks:
            with drawn_page(started, path, width=width, dark=dark) as page:
                assert page.locator(".plot .main-svg").count() >= page.locator(".plot").count() > 5
                assert page.evaluate(CUT) == [False, []]


@needs_browser
def test_a_dark_page_has_dark_pictures_and_light_lines_and_turns_back(pages: dict[str, str], tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    write_page(pages["diagnose"], path)
    look = """() => {
      const measured = (plot) => plot.data.find((line) => line.name === "measured");
      const plot = [...document.querySelectorAll(".plot")].find(measured);
      const line = measured(plot).line.color;
      return [getComputedStyle(document.body).backgroundColor, plot.layout.paper_bgcolor, line];
    }"""
    light, night = ["rgb(255, 255, 255)", PAPER, BLACK], ["rgb(18, 23, 30)", DARK[PAPER], DARK[BLACK]]
    with browser() as started, drawn_page(started, path, dark=True) as page:
        assert page.evaluate(look) == night
        page.get_by_role("button", name="Light").click()
        assert page.evaluate(look) == light
        page.get_by_role("button", name="Dark").click()
        page.wait_for_function(f"({look})()[2] === '{DARK[BLACK]}'")
        page.emulate_media(color_scheme="light")  # the reader's choice stays
        assert page.evaluate(look) == night


@needs_browser
def test_a_picture_is_saved_as_png_and_as_svg_on_white(pages: dict[str, str], tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    write_page(pages["diagnose"], path)
    with browser() as started, drawn_page(started, path, dark=True) as page:
        for ending, magic in (("png", b"\x89PNG"), ("svg", b"<svg")):
            page.locator(".plot").first.hover()
            with page.expect_download() as saved:
                page.locator(".plot").first.locator(f'[data-title="Save as {ending.upper()}"]').click()
            file = tmp_path / saved.value.suggested_filename
            saved.value.save_as(file)
            assert file.name == f"what_the_model_of_arpl_250g_misses_errors_1.{ending}"
            assert file.read_bytes().startswith(magic)
        assert b"rgb(255, 255, 255)" in file.read_bytes()


def test_colours_of_pictures_have_one_dark_counterpart_each_that_stands_out() -> None:
    assert len(set(DARK.values())) == len(DARK)
    assert not set(DARK) & set(DARK.values())
    for colour in (MEASURED, BEFORE, AFTER, FLOOR, ORANGE, GREEN, SKY, PURPLE):
        assert contrast(DARK.get(colour, colour), DARK[PAPER]) > 3
    assert contrast(TEXT, PAPER) > 7
    assert contrast(DARK[TEXT], DARK[PAPER]) > 7


def contrast(first: str, second: str) -> float:
    """Of two colours, from 1 to 21 (WCAG 2.2)."""

    def luminance(colour: str) -> float:
        shares = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        linear = [share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4 for share in shares]
        return float(np.dot(linear, [0.2126, 0.7152, 0.0722]))

    darker, lighter = sorted([luminance(first), luminance(second)])
    return (lighter + 0.05) / (darker + 0.05)


@pytest.mark.parametrize("normal", [(0, 0, 1), (0, 1, 0), (1, -1, 0.2), (-0.3, 0.5, -1)])
def test_a_path_in_space_is_seen_where_it_is_widest(normal: tuple[float, float, float]) -> None:
    """From the side to which its plane faces, within 30 degrees, never from below, and never along the vertical."""
    across = np.array(normal) / np.linalg.norm(normal)
    along = np.linalg.svd(across[None])[2][1:]
    turn = np.linspace(0, 2 * np.pi, 200)[:, None]
    view = best_view(2.0 * np.cos(turn) * along[0] + np.sin(turn) * along[1] + [3.0, 1.0, 2.0])
    view = view / np.linalg.norm(view)
    assert abs(view @ across) > np.cos(np.radians(30))
    assert 0 < view[2] < np.cos(np.radians(5))


def test_a_flat_path_fills_its_box_to_scale() -> None:
    turn = np.linspace(0, 2 * np.pi, 200)
    path = np.column_stack([1.8 * np.cos(turn), np.zeros(200), 1.2 + 0.18 * np.sin(turn)])
    assert sides_of(path) == pytest.approx([1.0, 0.05, 0.1], abs=0.002)


def test_files_that_nothing_was_fitted_to_are_marked(
    findings: DiagnosisDetails, dataset: Dataset, vehicle: Vehicle
) -> None:
    marked = dataclasses.replace(dataset, hashes={"a.csv": "1" * 64}, held_hashes={"b.csv": "2" * 64})
    page = diagnosis_page(findings, dataset, vehicle, origin=dataset_origin(marked))
    assert '<td class="name">a.csv</td>' in page
    assert '<td class="name">b.csv (held out)</td>' in page
