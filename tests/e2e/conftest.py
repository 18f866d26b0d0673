"""A browser, and the app in a process of its own with a small plate that was measured once.

A Chromium is looked for on the PATH, then where Playwright keeps its own; without one the tests are skipped.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

FLAGS = ["--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"]
PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
SHAPE = (88, 112)
FRAMES = 50


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    sync_api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    sync_api.expect.set_options(timeout=60_000)  # machines that test may be slow
    found = next(filter(None, map(shutil.which, PROGRAMS)), None)
    with sync_api.sync_playwright() as playwright:
        try:
            opened = playwright.chromium.launch(executable_path=found, args=FLAGS)
        except sync_api.Error as error:
            pytest.skip(f"no Chromium on the PATH and none of Playwright's: {str(error).splitlines()[0]}")
        yield opened
        opened.close()


@dataclass
class App:
    """The app, as a person starts it."""

    folder: Path
    workspace: Path
    process: subprocess.Popen[str] | None = None
    url: str = ""

    def start(self) -> App:
        command = [sys.executable, "-m", "microbundle", "app", str(self.folder), "--workspace", str(self.workspace),
                   "--no-browser"]
        started = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ | {"NO_COLOR": "1"})
        assert started.stdout is not None
        self.process, self.url = started, started.stdout.readline().split()[-1]
        return self

    def stop(self) -> None:
        if self.process is not None:
            self.process.send_signal(signal.SIGINT)
            self.process.wait(20)
            assert self.process.stdout is not None
            self.process.stdout.close()
            self.process = None

    def at(self, path: str) -> str:
        return self.url.partition("/?")[0] + path

    def decisions(self, run: str, key: str) -> list[dict[str, Any]]:
        """What is written beside the result of a movie."""
        file = self.workspace / "runs" / run / "results" / f"{key}.decisions.json"
        if not file.exists():
            return []
        listed: list[dict[str, Any]] = json.loads(file.read_text(encoding="utf-8"))["microbundle_decisions"]
        return listed


@pytest.fixture(scope="session")
def plate(tissue_array: NDArray[Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder `movies` with a plate of three small movies, one of which shows no tissue, and a hostile name."""
    folder = tmp_path_factory.mktemp("app") / "movies"
    (folder / "plate1").mkdir(parents=True)
    small = tissue_array[:FRAMES, 20:20 + SHAPE[0], 40:40 + SHAPE[1]]
    noise = np.random.default_rng(1).normal(30000, 250, (10, *SHAPE))
    for name, frames in (("P1_A1", small), ("P1_A2", small[:, ::-1]), ("P1_B1", np.clip(noise, 0, 65535).astype("u2"))):
        tifffile.imwrite(folder / "plate1" / f"{name}.tif", frames)
    (folder / "<img src=x onerror=document.title=1>").mkdir()
    return folder


@pytest.fixture(scope="session")
def app(plate: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[App]:
    running = App(plate, tmp_path_factory.mktemp("workspace")).start()
    yield running
    running.stop()


@pytest.fixture
def visit(browser: Browser, app: App) -> Iterator[Callable[..., Page]]:
    """Open pages of the app; whatever stands on a console at the end of a test fails it."""
    opened: list[Page] = []

    def open_page(path: str = "/", **options: Any) -> Page:
        context = browser.new_context(**({"viewport": {"width": 1280, "height": 900}} | options))
        page = context.new_page()
        page.set_default_timeout(90_000)
        page.heard = []  # type: ignore[attr-defined]
        page.on("console", lambda message: page.heard.append(message.text))  # type: ignore[attr-defined]
        page.on("pageerror", lambda error: page.heard.append(str(error)))  # type: ignore[attr-defined]
        page.goto(app.url)
        if path != "/":
            page.goto(app.at(path))
        opened.append(page)
        return page

    yield open_page
    for page in opened:
        heard = page.heard  # type: ignore[attr-defined]
        page.context.close()
        assert heard == []


@pytest.fixture(scope="session")
def run(browser: Browser, app: App) -> str:
    """The run of the small plate, opened and measured as a person does it, with the quick method."""
    from playwright.sync_api import expect

    context = browser.new_context()
    page = context.new_page()
    page.goto(app.url)
    page.locator(".entry", has_text="plate1").click()
    page.get_by_role("button", name="Open this folder").click()
    page.wait_for_url("**/run/*")
    page.locator("#ask").get_by_label("Frames per second").fill("30")
    page.locator("#ask").get_by_label("Pixel size").fill("4")
    page.locator("#set-method").select_option("fast")
    page.locator("summary", has_text="Names").click()
    page.locator("#set-pattern").fill("{plate}_{well}")
    expect(page.locator("#command")).to_contain_text("pattern")
    page.get_by_role("button", name="Start measuring 3 movies").click()
    expect(page.locator("#state")).to_have_text("Done", timeout=120_000)
    found = page.url.rpartition("/")[2].partition("#")[0]
    context.close()
    return found
