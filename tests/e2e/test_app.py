"""The app in a browser: from the example to a ZIP, opening, running, tables and plates, several windows, restarts."""

from __future__ import annotations

import re
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from .conftest import App

expect = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed").expect

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, Route

Visit = Callable[..., "Page"]


def fewer_wells(route: Route) -> None:
    route.continue_(post_data='{"wells": 6}')


def test_from_the_example_to_a_zip(browser: Browser, plate: Path, tmp_path: Path) -> None:
    app = App(plate, tmp_path / "workspace").start()
    try:
        page = browser.new_context(accept_downloads=True).new_page()
        page.goto(app.url)
        page.route("**/api/example", fewer_wells)
        page.get_by_role("button", name="Open the example plate").click()
        page.wait_for_url("**/run/*")
        expect(page.locator("#go")).to_have_text("Start measuring 6 movies", timeout=60_000)
        page.locator("#set-method").select_option("fast")
        expect(page.locator("#command")).to_contain_text("--config")
        page.locator("#go").click()
        expect(page.locator("#state")).to_have_text(re.compile("Waiting|Running"))
        expect(page.locator("#table .badge", has_text=re.compile("Pass|Review")).first).to_be_visible(timeout=120_000)
        page.get_by_role("button", name="Stop").click()
        expect(page.locator("#state")).to_have_text("Stopped", timeout=60_000)
        expect(page.locator("#go")).to_have_text("Go on")
        with page.expect_download() as started:
            page.get_by_role("link", name="Download everything (ZIP)").click()
        taken = zipfile.ZipFile(started.value.path())
        assert taken.testzip() is None
        kept = [name for name in taken.namelist() if name.endswith("report.html")]
        assert len(kept) == sum(name.endswith("result.nc") for name in taken.namelist()) >= 1
        assert b"microbundle report" in taken.read(kept[0])
        page.context.close()
    finally:
        app.stop()


def test_folders_are_browsed_and_names_run_nothing(visit: Visit) -> None:
    page = visit()
    expect(page.locator(".entry")).to_have_count(2)
    assert page.locator(".entry .name").all_inner_texts()[0] == "<img src=x onerror=document.title=1>"
    page.locator(".entry", has_text="plate1").click()
    expect(page.locator(".entry")).to_have_count(3)
    expect(page.locator(".entry").first).to_be_focused()
    assert page.get_by_text("All 3 movies in it").is_visible()
    page.get_by_role("navigation", name="Folder").get_by_role("button", name="movies").click()
    expect(page.locator(".entry")).to_have_count(2)
    assert page.title() == "Open a movie – microbundle"


def test_what_a_terminal_measured_opens(visit: Visit, app: App, run: str) -> None:
    written = app.folder / "from_a_terminal"
    shutil.copytree(app.workspace / "runs" / run, written)
    try:
        page = visit()
        page.locator(".entry", has_text="from_a_terminal").click()
        page.wait_for_url("**/run/*")
        here = page.url
        expect(page.locator("#state")).to_have_text("Done")
        expect(page.locator("#next-text")).to_contain_text("Measured")
        expect(page.locator("#go")).to_be_hidden()
        page.locator("#table tbody th a").first.click()
        expect(page.locator("#panel-movie .stage")).to_have_attribute("data-frame", "0")
        page.get_by_role("tab", name="Result").click()
        expect(page.frame_locator("iframe").locator("h1")).to_contain_text("P1_A1")
        page.goto(here)
        expect(page.locator("#files a", has_text="movies.csv")).to_be_visible()
        page.on("dialog", lambda dialog: dialog.accept())
        page.get_by_role("button", name="Take off the list").click()
        page.wait_for_url(lambda url: "/run/" not in url)
        assert (written / "movies.csv").is_file()
    finally:
        shutil.rmtree(written)


def test_dropped_files_are_copied_and_opened(visit: Visit, plate: Path) -> None:
    page = visit()
    page.locator("#files").set_input_files(plate / "plate1" / "P1_A1.tif")
    page.wait_for_url("**/run/*")
    expect(page.locator("#go")).to_have_text("Start measuring 1 movie")
    page.on("dialog", lambda dialog: dialog.accept())
    page.get_by_role("button", name="Take off the list").click()
    page.wait_for_url(lambda url: "/run/" not in url)


def test_what_is_wrong_is_said_beside_the_field(visit: Visit, run: str) -> None:
    page = visit(f"/run/{run}")
    page.locator("summary", has_text="All other settings").click()
    page.locator("summary", has_text="Strain").click()
    page.locator("#set-strain-tile_px").fill("1")
    expect(page.locator(".field", has=page.locator("#set-strain-tile_px")).locator(".wrong")).to_contain_text("tile_px")
    assert page.locator("#set-strain-tile_px").get_attribute("aria-invalid") == "true"
    page.locator("#set-strain-tile_px").fill("")
    expect(page.locator("#set-strain-tile_px")).not_to_have_attribute("aria-invalid", "true")
    heard = page.heard  # type: ignore[attr-defined]
    assert all("422" in text for text in heard)
    heard.clear()


def test_the_table_sorts_and_finds(visit: Visit, run: str) -> None:
    page = visit(f"/run/{run}")
    names = page.locator("#table tbody th a")
    expect(names).to_have_count(3)
    assert names.all_inner_texts() == ["P1_A1.tif", "P1_A2.tif", "P1_B1.tif"]
    page.get_by_role("button", name="State").click()
    assert page.locator("#table tbody tr").first.inner_text().startswith("P1_B1")
    assert page.locator("#table th[aria-sort=ascending]").inner_text().startswith("State")
    page.locator("#find").fill("a2")
    expect(names).to_have_count(1)


def test_the_plate_is_a_map_that_keys_walk(visit: Visit, run: str) -> None:
    page = visit(f"/run/{run}")
    page.locator("#as-plate").click()
    wells = page.locator("#plate a")
    expect(wells).to_have_count(3)
    assert (wells.first.get_attribute("aria-label") or "").startswith("A1")
    assert (wells.first.locator("circle").get_attribute("fill") or "").startswith("rgb(")
    page.get_by_label("Colour by").select_option(index=1)
    wells.first.focus()
    page.keyboard.press("ArrowRight")
    assert (page.evaluate("document.activeElement.getAttribute('aria-label')") or "").startswith("A2")
    page.keyboard.press("Enter")
    page.wait_for_url("**/P1_A2*")


def test_the_command_is_one_to_paste(visit: Visit, app: App, run: str) -> None:
    page = visit(f"/run/{run}")
    expect(page.locator("#command")).to_contain_text("microbundle batch ")
    told = page.locator("#command").inner_text()
    assert str(app.workspace / "runs" / run) in told
    page.locator("#copy").click()
    expect(page.locator("#said")).to_have_text(re.compile("Copied|Selected"))


def test_two_windows_that_change_the_same_lose_nothing(visit: Visit, run: str) -> None:
    one, other = visit(f"/run/{run}/P1_A1.tif#notes"), visit(f"/run/{run}/P1_A1.tif#notes")
    for page, text in ((one, "from the first"), (other, "from the second")):
        page.get_by_label("Note", exact=True).fill(text)

    def be_late(route: Route) -> None:
        if one.locator(".decisions li").count() == 0:
            one.get_by_role("button", name="Keep the note").click()
            expect(one.locator(".decisions li")).to_have_count(1)
        route.continue_()

    other.route("**/decisions", be_late)
    other.get_by_role("button", name="Keep the note").click()
    expect(other.locator(".decisions li")).to_have_count(2)
    assert "another window" in other.locator("#trouble").inner_text()
    assert "from the first" in other.locator(".decisions").inner_text()
    heard = other.heard  # type: ignore[attr-defined]
    assert all("409" in text for text in heard)
    heard.clear()
    for left in (1, 0):
        other.get_by_role("button", name="Take back").first.click()
        expect(other.locator(".decisions li")).to_have_count(left)


def test_a_restart_of_the_server_loses_nothing(visit: Visit, app: App, run: str) -> None:
    page = visit(f"/run/{run}/P1_A1.tif#notes")
    page.get_by_label("Note", exact=True).fill("half a thought")
    app.stop()
    expect(page.locator("#trouble")).to_contain_text("does not answer", timeout=20_000)
    before = app.url
    app.start()
    assert app.url == before
    expect(page.locator("#trouble")).to_be_hidden(timeout=20_000)
    page.reload()
    assert page.get_by_label("Note", exact=True).input_value() == "half a thought"
    page.get_by_label("Note", exact=True).fill("")
    heard = page.heard  # type: ignore[attr-defined]
    assert all("ERR_CONNECTION_REFUSED" in text or "ERR_INCOMPLETE" in text for text in heard)
    heard.clear()
