"""Masks in a browser: drawn, dragged, painted and erased with a real mouse, and by keys alone; saved and used."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from .conftest import SHAPE, App

expect = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed").expect

if TYPE_CHECKING:
    from playwright.sync_api import Page

KEY = "P1_A2.tif"


@pytest.fixture
def page(visit: Callable[..., Page], run: str) -> Page:
    """The masks of a movie, as the program finds them."""
    opened = visit(f"/run/{run}/{KEY}#masks")
    expect(opened.locator(".masks .tissue")).to_be_attached()
    return opened


def tool(page: Page, name: str) -> None:
    page.get_by_role("group", name="Tool").get_by_role("button", name=name).click()


def on_screen(page: Page, row: float, col: float) -> tuple[float, float]:
    box = page.locator("#panel-masks .stage").bounding_box()
    assert box is not None
    return box["x"] + (col + 0.5) / SHAPE[1] * box["width"], box["y"] + (row + 0.5) / SHAPE[0] * box["height"]


def fact(page: Page, name: str) -> str:
    return page.locator(f"#panel-masks [data-fact={name}]").inner_text()


def draw_box(page: Page, top: int, bottom: int, left: int, right: int) -> None:
    tool(page, "Draw")
    for row, col in ((top, left), (top, right), (bottom, right), (bottom, left)):
        page.mouse.click(*on_screen(page, row, col))
    page.mouse.click(*on_screen(page, top, left))


def forget(page: Page) -> None:
    """Go back to what is saved."""
    page.get_by_role("button", name="Back to what is saved").click()
    expect(page.get_by_role("button", name="Use these masks")).to_be_disabled()


def test_a_drawn_outline_is_measured_at_once(page: Page) -> None:
    draw_box(page, 24, 64, 20, 90)
    expect(page.locator("#panel-masks [data-fact='made by']")).to_have_text("you")
    expect(page.locator("#panel-masks [data-fact=length]")).to_have_text("71 px")
    expect(page.locator("#panel-masks [data-fact=width]")).to_have_text("41 px")
    page.get_by_role("button", name="Undo").click()
    expect(page.locator("#panel-masks [data-fact=length]")).not_to_have_text("71 px")
    page.keyboard.press("Control+Shift+Z")
    expect(page.locator("#panel-masks [data-fact=length]")).to_have_text("71 px")
    page.reload()
    expect(page.locator("#panel-masks [data-fact=length]")).to_have_text("71 px")
    forget(page)


def test_a_corner_is_dragged_and_one_is_added(page: Page) -> None:
    draw_box(page, 24, 64, 20, 90)
    expect(page.locator("#panel-masks [data-fact=length]")).to_have_text("71 px")
    tool(page, "Corners")
    corners = page.locator(".corners circle")
    expect(corners).to_have_count(4)
    page.mouse.move(*on_screen(page, 44, 90))
    page.mouse.down()
    page.mouse.move(*on_screen(page, 44, 98), steps=3)
    page.mouse.up()
    expect(corners).to_have_count(5)
    expect(page.locator("#panel-masks [data-fact=length]")).to_have_text(re.compile("7[89] px"))
    corners.first.focus()
    for _ in range(8):
        if "column 98" in (page.evaluate("document.activeElement.getAttribute('aria-label')") or ""):
            break
        page.keyboard.press("n")
    page.keyboard.press("Shift+ArrowLeft")
    expect(page.locator("#panel-masks [data-fact=length]")).not_to_have_text(re.compile("7[89] px"))
    page.keyboard.press("Delete")
    expect(corners).to_have_count(4)
    forget(page)


def test_paint_adds_and_erase_takes_away(page: Page) -> None:
    draw_box(page, 24, 64, 20, 90)
    expect(page.locator("#panel-masks [data-fact=length]")).to_have_text("71 px")
    tool(page, "Paint")
    page.locator("#panel-masks input[type=range]").first.fill("6")
    page.mouse.move(*on_screen(page, 44, 88))
    page.mouse.down()
    page.mouse.move(*on_screen(page, 44, 100), steps=5)
    page.mouse.up()
    expect(page.locator("#panel-masks [data-fact=length]")).to_have_text(re.compile("8[67] px"))
    tool(page, "Erase")
    page.locator("#panel-masks .stage").focus()
    at = [44, 56]
    for key, count in (("Shift+ArrowRight", 4), ("ArrowRight", 4)):
        for _ in range(count):
            page.keyboard.press(key)
            at[1] += 10 if "Shift" in key else 1
    expect(page.locator("#said")).to_have_text(f"row {at[0]}, column {at[1]}")
    page.keyboard.press("Space")
    expect(page.locator("#panel-masks [data-fact=length]")).not_to_have_text(re.compile("8[67] px"))
    forget(page)


def test_the_axis_turns_and_the_tiles_move(page: Page) -> None:
    draw_box(page, 24, 64, 20, 90)
    expect(page.locator("#panel-masks [data-fact=angle]")).to_have_text("0.0°")
    tool(page, "Axis")
    page.get_by_role("slider", name="Right end of the axis").focus()
    page.keyboard.press("Shift+ArrowDown")
    expect(page.locator("#panel-masks [data-fact=angle]")).to_have_text("5.0° (yours)")
    box = page.get_by_role("slider", name="Right end of the axis").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    page.mouse.move(*on_screen(page, 44, 95), steps=4)
    page.mouse.up()
    expect(page.locator("#panel-masks [data-fact=angle]")).to_have_text(re.compile(r"0\.[01]° \(yours\)"))
    tool(page, "Sub-domains")
    page.get_by_label("Sub-domains across").fill("2")
    page.get_by_label("Sub-domains along").fill("3")
    page.get_by_label("Sub-domains along").press("Tab")
    expect(page.locator("#panel-masks [data-fact=sub-domains]")).to_have_text("6")
    before = page.locator(".masks .tile").first.get_attribute("d")
    page.get_by_role("button", name="left side").focus()
    page.keyboard.press("Shift+ArrowLeft")
    expect(page.locator(".masks .tile").first).not_to_have_attribute("d", before or "")
    forget(page)


def test_masks_are_kept_and_measured_again(page: Page, app: App, run: str) -> None:
    draw_box(page, 20, 68, 14, 98)
    expect(page.locator("#panel-masks [data-fact=length]")).to_have_text("85 px")
    page.get_by_role("button", name="Use these masks").click()
    expect(page.get_by_role("button", name="Use these masks")).to_be_disabled()
    (kept,) = [one for one in app.decisions(run, KEY) if one["kind"] == "use_mask"]
    assert kept["name"] == "tissue"
    mask = cv2.imread(str(app.workspace / "runs" / run / "results" / kept["file"]), cv2.IMREAD_UNCHANGED)
    assert mask.shape == SHAPE
    row, col = np.nonzero(mask)
    assert (row.min(), row.max(), col.min(), col.max()) == (20, 68, 14, 98)
    again = page.get_by_role("button", name="Measure again")
    again.click()
    expect(page.locator("#stale")).to_be_hidden(timeout=60_000)
    page.get_by_role("tab", name="Notes and decisions").click()
    page.get_by_role("button", name="Take back: Mask of the tissue by hand").click()
    expect(page.get_by_role("button", name="Take back: Mask of the tissue by hand")).to_have_count(0)
    assert not any(one["kind"] == "use_mask" for one in app.decisions(run, KEY))


def test_a_pillar_is_drawn_by_keys_alone(page: Page) -> None:
    page.get_by_label("Change").select_option("new")
    page.locator("#panel-masks .stage").focus()
    for keys in (("Shift+ArrowLeft",) * 3, ("Shift+ArrowDown",), ("Shift+ArrowRight",)):
        for key in keys:
            page.keyboard.press(key)
        page.keyboard.press("Space")
    page.keyboard.press("Enter")
    expect(page.locator(".masks .pillar")).to_have_count(1)
    assert "Pillar 1: supplied" in fact(page, "pillars")
    page.get_by_role("button", name="Take this pillar away").click()
    expect(page.locator(".masks .pillar")).to_have_count(0)
    forget(page)
