"""Reports in a browser: what a reader does with mouse and keyboard, with the network off, light, dark and on paper."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from microbundle.analysis import Analysis
from microbundle.data import Finding
from microbundle.metrics import tables
from microbundle.plates import WellMovie, plates_of
from microbundle.report import write_index, write_report
from microbundle.report.index import NoResult, summarize

from ..known_pillars import with_pillars

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, Page

CONTRAST_AA = 4.5


@pytest.fixture(scope="module")
def report(tissue_analysis: Analysis, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of the small tissue with two pillars."""
    return write_report(with_pillars(tissue_analysis, noise_px=0.01), tmp_path_factory.mktemp("report") / "report.html")


def open_page(browser: Browser, file: Path, **options: Any) -> Page:
    """Open a file with the network off; everything on the console is kept in `page.heard`."""
    context = browser.new_context(offline=True, viewport={"width": 1280, "height": 900}, **options)
    page = context.new_page()
    page.set_default_timeout(90_000)
    page.heard = []  # type: ignore[attr-defined]
    page.on("console", lambda message: page.heard.append(message.text))  # type: ignore[attr-defined]
    page.on("pageerror", lambda error: page.heard.append(str(error)))  # type: ignore[attr-defined]
    page.on("request", lambda request: None if request.url.startswith(("file:", "data:", "blob:"))
            else page.heard.append(request.url))  # type: ignore[attr-defined]
    page.goto(file.as_uri())
    return page


@pytest.fixture
def page(browser: Browser, report: Path) -> Iterator[Page]:
    opened = open_page(browser, report)
    yield opened
    assert opened.heard == []  # type: ignore[attr-defined]
    opened.context.close()


def pixels(canvas: Locator) -> str:
    return str(canvas.evaluate("canvas => canvas.toDataURL()"))


def test_it_opens_without_a_word_on_the_console(page: Page) -> None:
    assert page.title() == "tissue – microbundle report"
    assert page.locator(".chart").count() == 6
    assert page.locator(".scripted").first.is_visible()


def test_the_slider_moves_the_map_and_the_cursors(page: Page) -> None:
    before, cursor = pixels(page.locator("#map")), page.locator(".chart .cursor").first.get_attribute("x1")
    page.locator("#frame").fill("30")
    assert page.locator("#when").inner_text() == "frame 30, 1.000 s"
    assert pixels(page.locator("#map")) != before
    assert page.locator(".chart .cursor").first.get_attribute("x1") != cursor
    assert "frame 30" in page.locator(".chart .now").first.inner_text()


def test_the_map_shows_every_quantity(page: Page) -> None:
    seen = set()
    for quantity in ("size", "along", "across", "cc", "rr", "rc", "none"):
        page.locator("#quantity").select_option(quantity)
        seen.add(pixels(page.locator("#map")))
    assert len(seen) == 7
    page.locator("#quantity").select_option("size")
    assert re.fullmatch(r"[\d.]+ µm", page.locator("#bar .high").inner_text())
    page.get_by_label("Arrows").check()
    assert (page.locator("#stage .arrows").get_attribute("d") or "").startswith("M")
    assert "times too long" in page.locator("#map-note").inner_text()


def test_play_runs_and_stops(page: Page) -> None:
    page.locator("#play").click()
    page.wait_for_timeout(400)
    assert page.locator("#frame").input_value() != "10"
    page.get_by_role("button", name="Pause").click()
    at = page.locator("#frame").input_value()
    page.wait_for_timeout(150)
    assert page.locator("#frame").input_value() == at


def test_pointing_at_a_trace_tells_value_error_and_unit(page: Page) -> None:
    page.locator(".chart svg").first.hover(position={"x": 200, "y": 60})
    told = page.locator("#tip").inner_text()
    assert re.fullmatch(r"frame \d+, \d\.\d{3} s · −?[\d.]+ ± [\d.]+ µm", re.sub(r"\s+·\s+", " · ", told))
    page.locator("#loop svg").first.scroll_into_view_if_needed()
    box = page.locator("#loop .curve").first.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 1, box["y"] + box["height"] - 3)
    assert "µN" in page.locator("#tip").inner_text()


def test_choosing_a_tile_on_the_map_shows_its_strain_and_the_other_way_round(page: Page) -> None:
    tile = page.locator("#stage .tile", has_text="A2")
    tile.click()
    assert "chosen" in (tile.get_attribute("class") or "")
    assert tile.get_attribute("aria-pressed") == "true"
    assert page.locator("#stage .tile.chosen").count() == 1
    assert page.get_by_text("Strain E_cc of A2").count() == 1
    curve = page.locator(".chart:has-text('Strain E_cc of') .curve.c1").get_attribute("d")
    page.locator("#tile").select_option(label="A1")
    assert "chosen" in (page.locator("#stage .tile", has_text="A1").get_attribute("class") or "")
    assert page.locator(".chart:has-text('Strain E_cc of') .curve.c1").get_attribute("d") != curve


def test_dragging_zooms_all_traces_and_a_button_undoes_it(page: Page) -> None:
    page.locator(".chart svg").first.scroll_into_view_if_needed()
    box = page.locator(".chart svg").first.bounding_box()
    assert box is not None
    ticks = page.locator("#traces .chart").nth(1).locator("text")
    before = ticks.all_text_contents()
    page.mouse.move(box["x"] + 150, box["y"] + 50)
    page.mouse.down()
    page.mouse.move(box["x"] + 250, box["y"] + 50)
    page.mouse.up()
    assert ticks.all_text_contents() != before
    page.get_by_role("button", name="Whole movie").click()
    assert ticks.all_text_contents() == before


def test_a_click_on_a_trace_goes_to_that_frame(page: Page) -> None:
    page.locator(".chart svg").first.click(position={"x": 300, "y": 60})
    assert page.locator("#frame").input_value() != "10"


def test_everything_works_with_the_keyboard(page: Page) -> None:
    page.locator("#frame").focus()
    at = int(page.locator("#frame").input_value())
    page.keyboard.press("ArrowRight")
    assert page.locator("#frame").input_value() == str(at + 1)
    page.locator(".chart svg").first.focus()
    page.keyboard.press("ArrowRight")
    assert page.locator("#frame").input_value() == str(at + 2)
    ticks = page.locator("#traces .chart").first.locator("text").all_text_contents()
    page.keyboard.press("+")
    assert page.locator("#traces .chart").first.locator("text").all_text_contents() != ticks
    page.keyboard.press("0")
    assert page.locator("#traces .chart").first.locator("text").all_text_contents() == ticks
    page.locator("#stage .tile.chosen").focus()
    chosen = page.locator("#tile").input_value()
    page.keyboard.press("ArrowLeft" if chosen != "0" else "ArrowRight")
    assert page.locator("#tile").input_value() != chosen
    assert page.evaluate("document.activeElement.classList.contains('chosen')")
    page.get_by_role("tab", name="Movie").focus()
    page.keyboard.press("ArrowRight")
    assert page.locator("#panel-beats").is_visible()
    assert page.locator("#panel-summary").is_hidden()
    assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    page.locator(".term").first.focus()
    assert "Elsewhere" in page.locator("#tip").inner_text()


def test_the_overlay_follows_the_chosen_signal(page: Page) -> None:
    before = page.locator("#overlay .curve").first.get_attribute("d")
    page.locator("#signal").select_option("strain")
    assert page.locator("#overlay .curve").first.get_attribute("d") != before
    assert "Strain E_cc" in page.locator("#overlay strong").inner_text()


CONTRAST = """() => {
  const parts = (text) => text.match(/[\\d.]+/g).map(Number);
  const light = ([r, g, b]) => [r, g, b].map((c) => c / 255)
    .map((c) => c <= .04045 ? c / 12.92 : ((c + .055) / 1.055) ** 2.4)
    .reduce((sum, c, i) => sum + c * [.2126, .7152, .0722][i], 0);
  const ground = (element) => {
    for (let e = element; e; e = e.parentElement) {
      const c = parts(getComputedStyle(e).backgroundColor);
      if (c.length === 3 || c[3] === 1) return c;
    }
    return [255, 255, 255];
  };
  const all = "p, span, strong, code, th, td, dt, dd, a, button, caption, li, h2, output, label";
  return [...document.querySelectorAll(all)]
    .filter((e) => e.textContent.trim() && e.getClientRects().length && !e.closest(".stage"))
    .map((e) => {
      const [a, b] = [light(parts(getComputedStyle(e).color)), light(ground(e))].sort((x, y) => y - x);
      return [(a + .05) / (b + .05), e.tagName + " " + e.className + ": " + e.textContent.slice(0, 40)];
    });
}"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_stands_out_of_its_ground(browser: Browser, report: Path, scheme: str) -> None:
    page = open_page(browser, report, color_scheme=scheme)
    weak = [(round(ratio, 2), what) for ratio, what in page.evaluate(CONTRAST) if ratio < CONTRAST_AA]
    assert weak == []
    ground = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (ground == "rgb(255, 255, 255)") == (scheme == "light")
    assert page.heard == []  # type: ignore[attr-defined]
    page.context.close()


def test_on_paper_there_are_maps_of_the_peak_and_no_widgets(page: Page) -> None:
    page.emulate_media(media="print")
    assert page.locator("#peak-maps figure").count() == 2
    assert page.locator("#peak-maps canvas").first.is_visible()
    assert page.locator("input:visible, select:visible, button:visible").count() == 0
    assert page.locator(".panel:visible").count() == 5
    assert len(set(map(pixels, page.locator("#peak-maps canvas").all()))) == 2


def test_a_narrow_window_needs_no_sideways_scrolling(page: Page) -> None:
    page.set_viewport_size({"width": 390, "height": 800})
    page.wait_for_timeout(100)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


def test_without_scripts_numbers_text_and_picture_are_there(browser: Browser, report: Path) -> None:
    page = open_page(browser, report, java_script_enabled=False)
    assert page.get_by_text("Maps and traces need scripts").is_visible()
    assert page.locator(".card").first.is_visible()
    assert page.locator("#stage .mask").is_visible()
    assert page.locator(".panel table:visible").count() >= 5
    assert page.locator("#play").is_hidden()
    page.context.close()


def test_what_is_missing_costs_no_widget(browser: Browser, tissue_analysis: Analysis, tmp_path: Path) -> None:
    beats = tissue_analysis.beats
    none = replace(beats, start=beats.start[:0], peak=beats.peak[:0], stop=beats.stop[:0], complete=beats.complete[:0],
                   left_out=beats.left_out[:0],
                   beat_relaxed_px=beats.beat_relaxed_px[:0], findings=(Finding("x", "fail", "Nothing moves."),))
    bare = replace(tissue_analysis, beats=none, strain=None, um_per_px=None, time_s=None)
    page = open_page(browser, write_report(bare, tmp_path / "bare.html"))
    page.locator("#frame").fill("7")
    assert page.locator("#when").inner_text() == "frame 7"
    assert page.locator("#overlay").inner_text() == "Nothing moves."
    assert page.heard == []  # type: ignore[attr-defined]
    page.context.close()


def test_a_hostile_name_runs_nothing(browser: Browser, tissue_analysis: Analysis, tmp_path: Path) -> None:
    name = '</script><script>document.title="owned"</script><img src=x onerror="document.title=1">'
    page = open_page(browser, write_report(replace(tissue_analysis, name=name), tmp_path / "hostile.html"))
    assert page.locator("h1").inner_text() == name
    assert page.title() == f"{name} – microbundle report"
    assert page.heard == []  # type: ignore[attr-defined]
    page.evaluate("() => { const s = document.createElement('script'); s.textContent = 'window.ran = 1'; "
                  "document.body.append(s); }")
    assert page.evaluate("window.ran") is None
    page.context.close()


def test_the_index_sorts_and_leads_to_reports(browser: Browser, tissue_analysis: Analysis, tmp_path: Path) -> None:
    summary = tables(tissue_analysis)["summary"]
    reports = []
    for name, factor in (("well 10", 3.0), ("well 2", 1.0), ("well 1", 2.0)):
        analysis = replace(tissue_analysis, name=name)
        file = write_report(analysis, tmp_path / name / "report.html")
        changed = summary.assign(mean=summary["mean"] * factor)
        reports.append(summarize(analysis, changed, file))
    page = open_page(browser, write_index(reports, tmp_path / "index.html"))
    names = page.locator("tbody a")
    page.get_by_role("button", name="Movie").click()
    assert names.all_inner_texts() == ["well 1", "well 2", "well 10"]
    page.get_by_role("button", name="Contraction amplitude").click()
    assert names.all_inner_texts() == ["well 2", "well 1", "well 10"]
    page.get_by_role("button", name="Contraction amplitude").click()
    assert names.all_inner_texts() == ["well 10", "well 1", "well 2"]
    names.first.click()
    assert page.locator("h1").inner_text() == "well 10"
    assert page.heard == []  # type: ignore[attr-defined]
    page.context.close()


@pytest.fixture(scope="module")
def plate_index(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An index over a plate of six wells, one of each kind."""
    folder = tmp_path_factory.mktemp("plate")
    movies = []
    for name, state, mean in (("A1", "pass", 2.0), ("A2", "review", 3.5), ("A3", "fail", 9.0), ("B1", "failed", 0.0)):
        means = {} if state == "failed" else {"amplitude_um": (mean, 0.12), "beat_rate_bpm": (10 * mean, 1.0)}
        failed = {"kind": "NoTissue", "message": "nothing there"} if state == "failed" else {}
        columns = {"plate": "P1", "well": name, "group": "drug" if name == "A2" else "vehicle"}
        movies.append(WellMovie(name, columns, state, means, report="" if failed else f"{name}.html", **failed))
    (folder / "A2.html").write_text("<h1>report of A2</h1>")
    plates, _ = plates_of(movies)
    rows = [NoResult(one.movie, "NoTissue", "nothing there", one.columns) for one in movies]
    return write_index(rows, folder / "index.html", plates=plates, metrics=["amplitude_um", "beat_rate_bpm"])


def test_a_plate_is_read_with_mouse_and_keyboard(browser: Browser, plate_index: Path) -> None:
    page = open_page(browser, plate_index)
    wells = page.locator("#maps .well")
    assert wells.locator("text").all_text_contents() == ["2.00", "3.50"]
    assert not page.locator("#plate-tables").is_visible()
    wells.nth(1).hover()
    tip = page.locator("#tip")
    assert tip.inner_text().splitlines() == ["A2, drug", "Contraction amplitude: 3.50 ± 0.12 µm", "to be reviewed"]
    wells.nth(3).hover()
    assert "no result: NoTissue: nothing there" in tip.inner_text()
    page.get_by_label("Show").select_option(label="Beat rate (beats/min)")
    assert wells.locator("text").all_text_contents() == ["20.0", "35.0"]
    page.get_by_label("Show").select_option(label="Groups")
    assert page.locator("#scale").inner_text().split() == ["vehicle", "drug"]
    page.get_by_label("Show").focus()
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.getAttribute('aria-label')").startswith("A1, vehicle")
    page.keyboard.press("ArrowDown")
    assert page.evaluate("document.activeElement.getAttribute('aria-label')").startswith("B1, vehicle, no result")
    page.keyboard.press("ArrowUp")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")
    assert page.locator("h1").inner_text() == "report of A2"
    assert page.heard == []  # type: ignore[attr-defined]
    page.context.close()


def test_a_plate_is_a_table_without_scripts_and_its_map_is_accessible(browser: Browser, plate_index: Path) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed")
    page = open_page(browser, plate_index, java_script_enabled=False)
    assert page.locator("#plate-tables td").all_inner_texts() == ["2.00", "3.50", "fail", "no result", "", ""]
    assert not page.locator("#metric").is_visible()
    page.context.close()
    for scheme in ("light", "dark"):
        page = open_page(browser, plate_index, color_scheme=scheme, bypass_csp=True)
        found = axe.Axe().run(page).response["violations"]
        assert [(one["id"], [node["html"] for node in one["nodes"]][:2]) for one in found] == []
        page.context.close()
