"""Write docs/app/*.png: every view of the app, on its example plate, in a browser without a window.

    python benchmarks/app_screenshots.py [NAME ...]

Needs Playwright and a Chromium. The example is rendered and measured in a temporary workspace, which takes some
minutes; MICROBUNDLE_APP names one to keep instead, so that a second call is quick. Names choose some of the pictures.
"""

from __future__ import annotations

import io
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import tifffile
from PIL import Image
from playwright.sync_api import Browser, Locator, Page, expect, sync_playwright

DOCS = Path(__file__).parent.parent / "docs" / "app"
FLAGS = ["--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"]
PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
WIDE, PHONE = {"width": 1180, "height": 820}, {"width": 390, "height": 780}
MINUTES = 60_000
COLOURS = 200
"""Of a picture's palette, so that the documentation stays small."""
SIZE = re.compile(r"(\d+) × (\d+) px")
SPOTS = ((47, 50), (78, 54), (50, 140), (80, 134))
"""Row and column of the points that are clicked at rest; later, where the tissue went, and a hand's miss aside."""
MISS_PX = (0.4, -0.3, -0.5, 0.3)
SHORT = """async () => {
  const { workspace } = await (await fetch("/api/app")).json();
  for (const id of ["what", "command"]) {
    const told = document.getElementById(id);
    if (told) told.textContent = told.textContent.replaceAll(workspace, "~/microbundle_app");
  }
}"""
"""Names the workspace as where people have it, not where this one is."""
FOUND = """async ([path, points]) => (await (await fetch(path, { method: "POST", body: JSON.stringify({ points }),
  headers: { "X-Microbundle": "1", "Content-Type": "application/json" } })).json()).points"""


def main(wanted: list[str]) -> int:
    """Write the pictures that are wanted, or all."""
    unknown = set(wanted) - set(VIEWS)
    if unknown:
        raise SystemExit(f"{', '.join(sorted(unknown))}: expected names of {', '.join(VIEWS)}")
    DOCS.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch, sync_playwright() as playwright:
        workspace = Path(os.environ.get("MICROBUNDLE_APP") or Path(scratch) / "workspace")
        folder = some_movies(Path(scratch) / "movies")
        command = [sys.executable, "-m", "microbundle", "app", str(folder), "--workspace", str(workspace),
                   "--no-browser"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as app:
            assert app.stdout is not None
            address = app.stdout.readline().split()[-1]
            program = next(filter(None, map(shutil.which, PROGRAMS)), None)
            browser = playwright.chromium.launch(executable_path=program, args=FLAGS)
            try:
                run = measured(browser, address, wanted)
                for name, view in VIEWS.items():
                    if view is not None and (not wanted or name in wanted):
                        take(browser, address, run, name, view)
            finally:
                browser.close()
                app.terminate()
    return 0


def some_movies(folder: Path) -> Path:
    """Write some files to browse, whose names alone are seen."""
    for name in ("day 14/P1_A1.tif", "day 14/P1_A2.tif", "day 21/P1_A1.tif", "pacing 1 Hz.tif", "pacing 2 Hz.tif"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        tifffile.imwrite(folder / name, np.zeros((30, 512, 512), np.uint16), compression="zlib")
    return folder


def measured(browser: Browser, address: str, wanted: list[str]) -> str:
    """Open and measure the example, with pictures on the way; gives the address of its run."""
    page = browser.new_context(viewport=WIDE).new_page()
    page.goto(address)
    page.wait_for_timeout(700)
    known = page.locator("#runs a")
    if known.count():
        known.first.click()
    else:
        if not wanted or "home" in wanted:
            shoot(page, "home")
        page.get_by_role("button", name="Open the example plate").click()
    page.wait_for_url("**/run/*")
    go, state = page.locator("#go"), page.locator("#state")
    expect(state).not_to_have_text("")
    expect(state).not_to_have_text("Being made", timeout=10 * MINUTES)
    if state.inner_text() != "Done":
        expect(go).to_contain_text("Start", timeout=5 * MINUTES)
        go.click()
        expect(page.locator("#table .badge.pass, #table .badge.review").nth(2)).to_be_visible(timeout=10 * MINUTES)
        if not wanted or "running" in wanted:
            shoot(page, "running")
        expect(state).to_have_text("Done", timeout=30 * MINUTES)
    return page.url.partition("#")[0]


def take(browser: Browser, address: str, run: str, name: str, view: Callable[[Page, str], None]) -> None:
    """Take the picture of one view."""
    page = browser.new_context(viewport=PHONE if name == "phone" else WIDE,
                               color_scheme="dark" if name == "dark" else "light").new_page()
    page.set_default_timeout(MINUTES)
    page.goto(address)
    view(page, run)
    page.wait_for_timeout(400)
    shoot(page, name)
    page.context.close()


def shoot(page: Page, name: str) -> None:
    """Keep what the window shows, down to the end of what is on the page, at most two windows high."""
    size = page.viewport_size
    assert size is not None
    page.evaluate("scrollTo(0, 0)")
    page.evaluate(SHORT)
    height = min(int(page.evaluate("document.querySelector('footer').getBoundingClientRect().top")), 2 * size["height"])
    page.set_viewport_size({"width": size["width"], "height": max(height, 480)})
    page.wait_for_timeout(400)
    file = DOCS / f"{name}.png"
    with Image.open(io.BytesIO(page.screenshot())) as picture:
        picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(file, optimize=True)
    print(file, flush=True)


def first_movie(page: Page, run: str, tab: str) -> Locator:
    """Open a tab of the first movie that passed; gives its panel."""
    page.goto(run)
    passed = page.locator("#table tbody tr", has=page.locator(".badge.pass, .badge.review")).first.locator("th a")
    page.goto(f"{run.partition('/run/')[0]}{passed.get_attribute('href')}#{tab}")
    panel = page.locator(f"#panel-{tab}")
    panel.locator("h2, iframe, .stage").first.wait_for()
    return panel


def table(page: Page, run: str) -> None:
    page.goto(run)
    page.locator("#settings .field").first.wait_for()
    page.locator("#table tbody tr").first.wait_for()


def plate(page: Page, run: str) -> None:
    page.goto(f"{run}#plate")
    page.get_by_label("Colour by").wait_for()
    names = page.get_by_label("Colour by").locator("option").all_inner_texts()
    page.get_by_label("Colour by").select_option(index=next(i for i, one in enumerate(names) if "amplitude" in one))


def movie(page: Page, run: str) -> None:
    panel = first_movie(page, run, "movie")
    panel.get_by_label("Frame", exact=True).fill("10")
    panel.locator("summary").click()


def masks(page: Page, run: str) -> None:
    panel = first_movie(page, run, "masks")
    panel.locator(".masks .tissue").wait_for(state="attached")
    panel.get_by_role("button", name="Corners").click()
    panel.locator(".corners circle").nth(3).focus()


def tiles(page: Page, run: str) -> None:
    panel = first_movie(page, run, "masks")
    panel.locator(".masks .tissue").wait_for(state="attached")
    panel.get_by_label("Sub-domains across").fill("2")
    panel.get_by_label("Sub-domains along").fill("5")
    panel.get_by_label("Sub-domains along").press("Tab")
    panel.get_by_role("button", name="Sub-domains").click()
    panel.get_by_role("button", name="left side").focus()
    for _ in range(4):
        page.keyboard.press("ArrowLeft")
    page.wait_for_timeout(1000)


def result(page: Page, run: str) -> None:
    first_movie(page, run, "result")
    page.frame_locator("iframe.report").locator(".card").first.wait_for()


def beats(page: Page, run: str) -> None:
    panel = first_movie(page, run, "beats")
    panel.locator(".beats tbody tr").first.wait_for()
    panel.get_by_label("Frame", exact=True).fill("12")


def verify(page: Page, run: str) -> None:
    panel = first_movie(page, run, "verify")
    stage = panel.locator(".stage")
    frames = [int(one.split()[-1]) for one in panel.locator(".steps button").all_inner_texts()]
    rows, cols = (int(one) for one in SIZE.findall(page.locator("#what").inner_text())[0])
    still = [{"point": p, "frame": frame, "row": row, "col": col} for frame in frames
             for p, (row, col) in enumerate(SPOTS)]
    path = page.url.partition("#")[0].replace("/run/", "/api/runs/")
    api = f"{path.rpartition('/')[0]}/movies/{path.rpartition('/')[2]}/clicks"
    moved = [one["found_px"] for one in page.evaluate(FOUND, [api, still])]
    for n in range(4):
        expect(panel.locator("h2")).to_have_text(f"Frame {n + 1} of 4")
        box = stage.bounding_box()
        assert box is not None
        for p, (row, col) in enumerate(SPOTS):
            down, right = (moved[p][n - 1][0], moved[p][n - 1][1] + MISS_PX[(n + p) % 4]) if n else (0.0, 0.0)
            page.mouse.click(box["x"] + (col + right + 0.5) / cols * box["width"],
                             box["y"] + (row + down + 0.5) / rows * box["height"])
            page.wait_for_timeout(100)
    panel.get_by_role("button", name="Compare with the tracks").click()
    panel.locator(".agreement tbody tr").first.wait_for()
    panel.get_by_role("button", name="Frame").nth(1).click()


def notes(page: Page, run: str) -> None:
    panel = first_movie(page, run, "notes")
    panel.get_by_label("Your name").fill("H. V.")
    panel.get_by_label("Your name").press("Tab")
    if panel.locator(".decisions li").count() == 0:
        panel.get_by_label("Note", exact=True).fill("Edge of the well in the upper left corner; not tissue.")
        panel.get_by_role("button", name="Keep the note").click()
        expect(panel.locator(".decisions li")).to_have_count(1)
    panel.get_by_label("Why").fill("Beats are regular, the mask fits.")


def side(page: Page, run: str) -> None:
    page.goto(run)
    page.locator("#table tbody tr").first.wait_for()
    good = page.locator("#table tbody tr", has=page.locator(".badge.pass, .badge.review")).locator("th a")
    keys = [(link.get_attribute("href") or "").rpartition("/")[2] for link in good.all()]
    page.goto(f"{run}/side?a={keys[0]}&b={keys[-1]}")
    page.locator("#side .chart").first.wait_for()


def review(page: Page, run: str) -> None:
    page.goto(f"{run}/review")
    page.get_by_label("Your name").fill("H. V.")
    page.keyboard.press("Enter")
    page.locator("#review .chart").first.wait_for()


def dark(page: Page, run: str) -> None:
    beats(page, run)


def phone(page: Page, run: str) -> None:
    masks(page, run)


VIEWS: dict[str, Callable[[Page, str], None] | None] = {
    "home": None, "running": None, "table": table, "plate": plate, "movie": movie, "masks": masks, "tiles": tiles,
    "result": result, "beats": beats, "verify": verify, "notes": notes, "side": side, "review": review, "dark": dark,
    "phone": phone,
}

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
