"""The app for everyone: light and dark, on a phone, by keyboard alone, and without what axe finds wrong."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from .conftest import App

expect = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed").expect

if TYPE_CHECKING:
    from playwright.sync_api import Page

Visit = Callable[..., "Page"]
VIEWS = {
    "home": ("/", "#browse .entry"), "help": ("/help", "#list details"), "run": ("/run/{run}", "#settings .field"),
    "plate": ("/run/{run}#plate", "#plate a"), "movie": ("/run/{run}/P1_A1.tif", "#panel-movie [data-frame]"),
    "masks": ("/run/{run}/P1_A1.tif#masks", "#panel-masks .masks .tissue"),
    "result": ("/run/{run}/P1_A1.tif#result", "iframe"), "beats": ("/run/{run}/P1_A1.tif#beats", "#panel-beats .chart"),
    "verify": ("/run/{run}/P1_A1.tif#verify", "#panel-verify [data-frame]"),
    "notes": ("/run/{run}/P1_A1.tif#notes", "#panel-notes textarea"),
    "side": ("/run/{run}/side?a=P1_A1.tif&b=P1_A2.tif", "#side .chart"), "review": ("/run/{run}/review", "#reviewer"),
}
DARK = ("run", "masks", "notes")
"""Views in which every colour occurs."""
FOCUSED = """() => { const { tagName, textContent, ariaLabel } = document.activeElement;
  return ["A", "BUTTON", "INPUT"].includes(tagName) ? textContent + (ariaLabel ?? "") : ""; }"""
RULES = {"runOnly": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]}


def test_axe_finds_nothing_light_or_dark(visit: Visit, app: App, run: str) -> None:
    axe_of = pytest.importorskip("axe_playwright_python.sync_playwright").Axe
    page, found = visit(), []
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        for name, (path, ready) in VIEWS.items():
            if scheme == "dark" and name not in DARK:
                continue
            page.goto("about:blank")
            page.goto(app.at(path.format(run=run)))
            page.locator(ready).first.wait_for(state="attached")
            rules = RULES if scheme == "light" else {"runOnly": {"type": "rule", "values": ["color-contrast"]}}
            told = axe_of().run(page, options=rules, context={"exclude": [["iframe"]]}).response["violations"]
            found += [(scheme, name, one["id"], [node["html"][:120] for node in one["nodes"]]) for one in told]
        ground = page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert (ground == "rgb(255, 255, 255)") == (scheme == "light")
    assert found == []


def test_a_phone_needs_no_sideways_scrolling(visit: Visit, app: App, run: str) -> None:
    page = visit(viewport={"width": 390, "height": 800})
    for path, ready in VIEWS.values():
        page.goto("about:blank")
        page.goto(app.at(path.format(run=run)))
        page.locator(ready).first.wait_for(state="attached")
        assert page.evaluate("document.documentElement.scrollWidth") <= 390, path


@pytest.mark.usefixtures("run")
def test_from_folder_to_beats_by_keyboard_alone(visit: Visit) -> None:
    page = visit()
    expect(page.locator(".entry")).to_have_count(2)

    def tab_to(name: str) -> None:
        for _ in range(60):
            page.keyboard.press("Tab")
            if name in page.evaluate(FOCUSED):
                assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") != "none"
                return
        raise AssertionError(name)

    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent") == "Skip to the content"
    page.keyboard.press("Enter")
    tab_to("plate1")
    page.keyboard.press("Enter")
    expect(page.locator(".entry")).to_have_count(3)
    tab_to("Open this folder")
    page.keyboard.press("Enter")
    page.wait_for_url("**/run/*")
    expect(page.locator("#table a").first).to_be_visible()
    tab_to("P1_A1.tif")
    page.keyboard.press("Enter")
    page.wait_for_url("**/P1_A1.tif*")
    tab_to("Movie")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    expect(page.get_by_role("tab", name="Beats")).to_be_focused()
    expect(page.locator("#panel-beats .chart")).to_be_visible()
    tab_to("Beat 2 counts")
    page.keyboard.press("Space")
    expect(page.locator("#stale")).to_be_visible()
    page.keyboard.press("Space")
    expect(page.locator("#said")).to_have_text("The beat counts.")
