"""The index page of many movies: its size, and the time to write it.

    python benchmarks/index_page.py [--open]

The movies are made up: amplitudes and rates at random, one in eleven failed. With --open a browser (Chromium, by
Playwright) opens each page with the network off, and the seconds until its maps are drawn are printed too.
"""

from __future__ import annotations

import argparse
import random
import shutil
import tempfile
import time
from pathlib import Path

from microbundle.plates import State, WellMovie, plates_of
from microbundle.report import write_index
from microbundle.report.index import NoResult, Summary
from microbundle.report.terms import term_of
from microbundle.wells import PLATES, well_name

SHOWN = ("amplitude_um", "beat_rate_bpm")
PAGES = ((384, 384), (1536, 1536), (10_000, 96))


def page_of(movies: int, wells: int, file: Path) -> None:
    """Write the page of so many made-up movies, on plates of so many wells."""
    draw = random.Random(0)
    columns = PLATES[wells][1]
    listed: list[Summary | NoResult] = []
    on_plates = []
    for k in range(movies):
        plate, well = divmod(k, wells)
        known = {"plate": f"P{plate + 1}", "well": well_name(divmod(well, columns)), "group": f"dose {well % columns}"}
        state: State = draw.choice(("pass",) * 8 + ("review", "fail", "failed"))
        means = {} if state == "failed" else {name: (draw.uniform(5, 8), 0.1) for name in SHOWN}
        name = f"movie_{k}.tif"
        if state == "failed":
            listed.append(NoResult(name, "MovieUnreadable", f"{name}: expected a whole TIFF; it is cut off", known))
        else:
            numbers = {metric: mean for metric, (mean, _) in means.items()}
            listed.append(Summary(name, state, (), 3, numbers, {metric: term_of(metric) for metric in SHOWN}, "",
                                  file.parent / f"results/{name}/report.html", known))
        failure = {"kind": "MovieUnreadable", "message": "cut off"} if state == "failed" else {}
        report = "" if state == "failed" else f"results/{name}/report.html"
        on_plates.append(WellMovie(name, known, state, means, report=report, **failure))
    write_index(listed, file, plates=plates_of(on_plates)[0], metrics=SHOWN)


def opened_s(file: Path) -> float:
    """Seconds until a browser that is running has opened a page and drawn its maps."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        flags = ["--no-sandbox", "--disable-gpu"]
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=flags)
        page = browser.new_context(offline=True).new_page()
        start = time.perf_counter()
        page.goto(file.as_uri())
        page.locator("#maps .well").last.wait_for(state="attached")
        spent = time.perf_counter() - start
        browser.close()
    return spent


def main() -> None:
    """Print the table."""
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--open", action="store_true")
    wanted = arguments.parse_args()
    print("| movies | size, MB | written in, CPU s |" + (" opened in, s |" if wanted.open else ""))
    print("|---|---|---|" + ("---|" if wanted.open else ""))
    with tempfile.TemporaryDirectory() as folder:
        for movies, wells in PAGES:
            file = Path(folder) / f"{movies}.html"
            start = time.process_time()
            page_of(movies, wells, file)
            spent = time.process_time() - start
            shown = f" {opened_s(file):.1f} |" if wanted.open else ""
            print(f"| {movies:,} on plates of {wells} | {file.stat().st_size / 1e6:.1f} | {spent:.1f} |{shown}",
                  flush=True)


if __name__ == "__main__":
    main()
