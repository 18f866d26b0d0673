"""One movie in a browser: frames, beats, clicks beside the tracks, blind review, two movies side by side."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from .conftest import FRAMES, SHAPE, App

expect = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed").expect

if TYPE_CHECKING:
    from playwright.sync_api import Page

Visit = Callable[..., "Page"]
KEY = "P1_A1.tif"


def test_frames_by_slider_keys_and_play(visit: Visit, run: str) -> None:
    page = visit(f"/run/{run}/{KEY}")
    stage, told = page.locator("#panel-movie .stage"), page.locator("#panel-movie output").first
    expect(stage).to_have_attribute("data-frame", "0")
    page.get_by_label("Frame", exact=True).fill("20")
    expect(stage).to_have_attribute("data-frame", "20")
    assert told.inner_text() == "frame 20, 0.667 s"
    stage.focus()
    for key, frame in (("ArrowRight", 21), ("Shift+ArrowLeft", 11), ("End", FRAMES - 1), ("Home", 0)):
        page.keyboard.press(key)
        expect(stage).to_have_attribute("data-frame", str(frame))
    page.keyboard.press("Space")
    expect(stage).not_to_have_attribute("data-frame", "0")
    page.get_by_role("button", name="Pause").click()
    at = told.inner_text()
    page.wait_for_timeout(150)
    assert told.inner_text() == at
    page.get_by_role("button", name="Zoom in").click()
    assert page.evaluate("document.querySelector('.view').scrollWidth > document.querySelector('.view').clientWidth")


def test_contrast_changes_the_picture_alone(visit: Visit, run: str) -> None:
    page = visit(f"/run/{run}/{KEY}")
    canvas = page.locator("#panel-movie .stage canvas").first
    expect(page.locator("#panel-movie .stage")).to_have_attribute("data-frame", "0")
    before = canvas.evaluate("canvas => canvas.toDataURL()")
    page.locator("summary", has_text="Contrast").click()
    with page.expect_response(lambda response: "high=" in response.url):
        page.get_by_label("Brightest shown").fill("200")
    page.wait_for_timeout(100)
    assert canvas.evaluate("canvas => canvas.toDataURL()") != before
    page.get_by_role("button", name="By itself").click()


def test_a_beat_is_left_out_and_another_marked(visit: Visit, app: App, run: str) -> None:
    page = visit(f"/run/{run}/{KEY}#beats")
    rows = page.locator(".beats tbody tr")
    expect(rows).to_have_count(2)
    page.get_by_label("Beat 2 counts").uncheck()
    expect(page.locator("#stale")).to_be_visible()
    peak = int(rows.nth(1).locator("td").nth(1).inner_text())
    assert app.decisions(run, KEY)[0]["peak_frame"] == peak
    page.get_by_label("Beat 2 counts").check()
    expect(page.locator("#said")).to_have_text("The beat counts.")
    assert app.decisions(run, KEY) == []
    slider = page.locator("#panel-beats").get_by_label("Frame", exact=True)
    for frame, name in ((2, "Starts here"), (11, "Peak here"), (20, "Ends here")):
        slider.fill(str(frame))
        page.get_by_role("button", name=name).click()
    page.get_by_role("button", name="Add this beat").click()
    expect(page.locator(".beats tbody")).to_contain_text("by hand")
    kept = app.decisions(run, KEY)[0]
    assert (kept["start_frame"], kept["peak_frame"], kept["stop_frame"]) == (2, 11, 20)
    page.get_by_role("button", name="Take back").click()
    expect(page.locator(".beats tbody")).not_to_contain_text("by hand")


def test_the_report_lives_in_a_sandbox(visit: Visit, run: str) -> None:
    page = visit(f"/run/{run}/{KEY}#result")
    frame = page.frame_locator("iframe.report")
    expect(frame.locator("h1")).to_contain_text("P1_A1")
    expect(frame.locator("#traces .chart").first).to_be_visible()
    assert "allow-same-origin" not in (page.locator("iframe.report").get_attribute("sandbox") or "")


def test_clicks_by_hand_and_the_tracks_agree(visit: Visit, run: str) -> None:
    page = visit(f"/run/{run}/{KEY}#verify")
    stage = page.locator("#panel-verify .stage")
    expect(stage).to_have_attribute("data-frame", "0")
    box = stage.bounding_box()
    assert box is not None
    for n in range(3):
        expect(page.locator("#panel-verify h2")).to_have_text(f"Frame {n + 1} of 4")
        for row, col in ((38, 30), (50, 30), (38, 80), (50, 80)):
            page.mouse.click(box["x"] + (col + 0.5) / SHAPE[1] * box["width"],
                             box["y"] + (row + 0.5) / SHAPE[0] * box["height"])
    stage.focus()
    page.keyboard.press("Shift+ArrowLeft")
    for _ in range(4):
        page.keyboard.press("ArrowUp")
        page.keyboard.press("Space")
    page.reload()
    page.get_by_role("button", name="Compare with the tracks").click()
    expect(page.locator(".agreement")).to_contain_text("differ by")
    expect(page.locator(".agreement tbody tr")).to_have_count(4)
    page.get_by_role("button", name="Begin again").click()
    expect(page.get_by_role("button", name="Compare with the tracks")).to_be_disabled()


def test_a_blind_review_hides_names_and_keeps_decisions(visit: Visit, app: App, run: str) -> None:
    page = visit(f"/run/{run}/review")
    page.get_by_role("button", name="Begin").click()
    assert page.get_by_label("Your name").get_attribute("aria-invalid") == "true"
    page.get_by_label("Your name").fill("HV")
    page.keyboard.press("Enter")
    for number in (1, 2):
        expect(page.get_by_text(f"Movie {number} of 2")).to_be_visible()
        expect(page.locator(".chart").first).to_be_visible()
        assert "P1_" not in page.locator("main").inner_text()
        page.get_by_label("Why").fill("looks right")
        page.locator("#review .stage").focus()
        page.keyboard.press("a")
    expect(page.get_by_text("All 2 movies are reviewed")).to_be_visible()
    (kept,) = [one for one in app.decisions(run, KEY) if one.get("by") == "HV"]
    assert (kept["kind"], kept["accept"], kept["by"], kept["why"]) == ("verdict", True, "HV", "looks right")
    page.goto(app.at(f"/run/{run}/{KEY}#notes"))
    page.get_by_role("button", name="Take back").click()
    expect(page.locator(".decisions li")).to_have_count(0)


def test_two_movies_go_in_step(visit: Visit, run: str) -> None:
    page = visit(f"/run/{run}")
    for name in ("P1_A1.tif", "P1_A2.tif"):
        page.get_by_label(f"Compare {name}").check()
    page.get_by_role("button", name="Compare two side by side").click()
    stages = page.locator("#side .stage")
    expect(stages).to_have_count(2)
    page.get_by_label("Frame", exact=True).first.fill("15")
    expect(stages.nth(1)).to_have_attribute("data-frame", "15")
    stages.nth(1).focus()
    page.keyboard.press("ArrowRight")
    expect(stages.nth(0)).to_have_attribute("data-frame", "16")
    page.get_by_label("In step").select_option("time")
    assert page.locator("#side .chart").first.locator(".curve").count() == 2
    assert page.locator("#side table tbody tr").count() > 3
