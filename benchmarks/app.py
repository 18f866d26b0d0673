"""The app: how long a person waits for a long movie, its frames, a mask that is edited, and the page of a large plate.

    python benchmarks/app.py [--frames 10000] [--wells 384]

A real server in a process of its own, asked as a browser does, over files that were not read before by it (the system
may hold them in memory). The movies are a rendered tissue of 128 x 192 px that beats on and on: one TIFF file, a folder
of single TIFFs, an MP4. `open` is from the click on the movie to its first frame on the screen; `jump` is a frame
anywhere in the movie, `next` the following frame, both at 640 px. `edited` is a mask drawn by hand, on frames of
1024 x 1536 px. The plate's results are copies of one; with Playwright and a Chromium its page is timed in the browser
too, from the call to the last row, or well, that is there. Times are wall-clock, in ms: median and 95th percentile.
"""

from __future__ import annotations

import argparse
import base64
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from http.cookiejar import CookieJar
from pathlib import Path

import numpy as np

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
WIDE = 640
JUMPS = 60


class Page:
    """What a browser's page asks of a server."""

    def __init__(self, home: Path, folder: Path) -> None:
        self.process = subprocess.Popen([sys.executable, "-m", "microbundle", "app", str(folder), "--workspace",
                                         str(home / "workspace"), "--no-browser", "--port", "0"],
                                        stdout=subprocess.PIPE, text=True)
        address = self.process.stdout.readline().split(": ", 1)[1].strip()
        self.address, self.base = address, address.partition("/?")[0]
        self.opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor(CookieJar()))
        for _ in range(100):
            try:
                self.opener.open(address).read()
                return
            except OSError:
                time.sleep(0.1)

    def ask(self, path: str, body: dict | None = None) -> bytes:
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self.base + path, data, {"X-Microbundle": "1"})
        return self.opener.open(request).read()

    def timed(self, path: str, body: dict | None = None) -> float:
        start = time.perf_counter()
        self.ask(path, body)
        return 1000 * (time.perf_counter() - start)

    def memory_mb(self) -> float:
        """Resident memory now, and at its highest."""
        status = Path(f"/proc/{self.process.pid}/status")
        lines = dict(line.split(":", 1) for line in status.read_text().splitlines()) if status.exists() else {}
        return int(lines.get("VmHWM", "0 kB").split()[0]) / 1024

    def stop(self) -> None:
        self.process.send_signal(signal.SIGINT)
        self.process.wait()


def beating(rows: int, cols: int) -> np.ndarray:
    """One second of a rendered tissue, 8 bits."""
    from microbundle.synth.render import beating_tissue

    frames = beating_tissue((rows, cols), 24, seed=1).array()
    return (frames // 257).astype(np.uint8)


def write_movies(folder: Path, count: int) -> None:
    """The same long movie in three formats."""
    import av
    import tifffile

    frames = beating(128, 192)
    folder.mkdir()
    with tifffile.TiffWriter(folder / "file.tif", bigtiff=True) as out:
        for t in range(count):
            out.write(frames[t % len(frames)], contiguous=False, metadata=None)
    (folder / "folder").mkdir()
    for t in range(count):
        tifffile.imwrite(folder / "folder" / f"{t:05}.tif", frames[t % len(frames)])
    with av.open(str(folder / "video.mp4"), "w") as out:
        stream = out.add_stream("libx264", rate=30, options={"crf": "18"})
        stream.width, stream.height, stream.pix_fmt = 192, 128, "yuv420p"
        for t in range(count):
            frame = av.VideoFrame.from_ndarray(frames[t % len(frames)], format="gray")
            out.mux(stream.encode(frame))
        out.mux(stream.encode())


def told(name: str, times: list[float]) -> None:
    print(f"| {name} | {np.median(times):.0f} | {np.percentile(times, 95):.0f} |", flush=True)


def long_movies(home: Path, count: int) -> None:
    """Opening and scrubbing movies of so many frames."""
    write_movies(home / "long", count)
    rng = np.random.default_rng(0)
    page = Page(home, home / "long")
    run = json.loads(page.ask("/api/open", {"at": "long"}))["run"]
    for key in [one["key"] for one in json.loads(page.ask(f"/api/runs/{run}"))["movies"]]:
        room = f"/api/runs/{run}/movies/{key}"
        told(f"{key}, {count} frames: open", [page.timed(room) + page.timed(f"{room}/grey")
                                               + page.timed(f"{room}/frame?t=0&width={WIDE}")])
        jumps = rng.integers(0, count, JUMPS)
        told(f"{key}: jump", [page.timed(f"{room}/frame?t={t}&width={WIDE}") for t in jumps])
        following = range(count // 2, count // 2 + 100)
        told(f"{key}: next", [page.timed(f"{room}/frame?t={t}&width={WIDE}") for t in following])
        for t in range(0, count, max(1, count // 2000)):
            page.ask(f"{room}/frame?t={t}&width={WIDE}")
    print(f"| peak memory of the server, MB | {page.memory_mb():.0f} | |")
    page.stop()


def large_masks(home: Path) -> None:
    """A mask found, and one edited by hand."""
    import cv2
    import tifffile

    (home / "large").mkdir()
    tifffile.imwrite(home / "large" / "large.tif", beating(1024, 1536))
    page = Page(home, home / "large")
    run = json.loads(page.ask("/api/open", {"at": "large"}))["run"]
    room = f"/api/runs/{run}/movies/large.tif/masks"
    start = time.perf_counter()
    found = json.loads(page.ask(room, {}))
    told("mask of 1024 x 1536 px: found", [1000 * (time.perf_counter() - start)])
    mask = cv2.imdecode(np.frombuffer(base64.b64decode(found["tissue_png"].split(",")[1]), np.uint8), 0)
    pillars = {one["name"]: one["png"] for one in found["pillars"]}
    times = []
    for n in range(12):
        mask = np.roll(mask, 1, axis=n % 2)
        png = "data:image/png;base64," + base64.b64encode(cv2.imencode(".png", mask)[1].tobytes()).decode()
        times.append(page.timed(room, {"tissue_png": png, "pillar_pngs": pillars}))
    told("mask of 1024 x 1536 px: edited", times)
    page.stop()


def large_plate(home: Path, wells: int) -> None:
    """The run of a plate with all of its results."""
    from dataclasses import replace

    import tifffile

    from microbundle import cli
    from microbundle.batch.plan import make_plan
    from microbundle.batch.state import RESULTS, read_status, write_status

    folder = home / "plate"
    folder.mkdir()
    tifffile.imwrite(folder / "A1.tif", beating(128, 192).repeat(2, axis=0))
    rows = ["movie,well,group,fps"]
    for w in range(wells):
        well = f"{chr(65 + w // 24)}{w % 24 + 1}"
        if w:
            os.link(folder / "A1.tif", folder / f"{well}.tif")
        rows.append(f"{well}.tif,{well},{'drug' if w % 2 else 'control'},30")
    (folder / "plate.csv").write_text("\n".join(rows) + "\n")
    page = Page(home, folder)
    run = json.loads(page.ask("/api/open", {"at": "plate/plate.csv"}))["run"]
    out = home / "workspace" / "runs" / run
    first = home / "first.csv"
    first.write_text("\n".join([rows[0], f"{folder / 'A1.tif'},A1,control,30"]) + "\n")
    assert cli.run(["batch", str(first), "--out", str(home / "one"), "--method", "fast", "--quiet"]) in (0, 3)
    done, = make_plan(first).tasks
    status = read_status(home / "one", done)
    (out / "status").mkdir(parents=True)
    for task in make_plan(folder / "plate.csv").tasks:
        shutil.copytree(home / "one" / RESULTS / done.key, out / RESULTS / task.key)
        write_status(out, task.key, replace(status, movie=task.movie, settings=task.settings))
    told(f"page of {wells} wells: first time", [page.timed(f"/run/{run}") + page.timed(f"/api/runs/{run}")
                                                + page.timed(f"/api/runs/{run}/plate")])
    told(f"page of {wells} wells: again", [page.timed(f"/api/runs/{run}") for _ in range(10)])
    in_browser(page, run, wells)
    page.stop()


def in_browser(page: Page, run: str, wells: int) -> None:
    """From the click on the run to the plate with all its wells on the screen, and from table to plate."""
    try:
        from playwright.sync_api import Error, sync_playwright
    except ImportError:
        print("| in the browser: Playwright is not installed | | |")
        return
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    with sync_playwright() as playwright:
        try:
            browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox", "--disable-gpu"])
        except Error:
            print("| in the browser: no Chromium is there | | |")
            return
        tab = browser.new_page()
        tab.goto(page.address)
        times: dict[str, list[float]] = {"table": [], "plate": []}
        for _ in range(8):
            for name, path, each in (("table", "", "#table tbody tr"), ("plate", "#plate", "#plate a")):
                tab.goto("about:blank")
                start = time.perf_counter()
                tab.goto(f"{page.base}/run/{run}{path}", wait_until="commit")
                tab.locator(each).nth(wells - 1).wait_for()
                times[name].append(1000 * (time.perf_counter() - start))
        for name, found in times.items():
            told(f"page of {wells} wells in the browser: {name}", found)
        browser.close()


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--frames", type=int, default=10_000)
    options.add_argument("--wells", type=int, default=384)
    given = options.parse_args()
    print("| what | median, ms | 95 %, ms |\n|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        long_movies(Path(folder), given.frames)
    with tempfile.TemporaryDirectory() as folder:
        large_masks(Path(folder))
    with tempfile.TemporaryDirectory() as folder:
        large_plate(Path(folder), given.wells)


if __name__ == "__main__":
    main()
