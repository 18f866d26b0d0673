"""Automatic pillar masks beside drawn ones: overlap, and what the difference does to a pillar's twitch.

    MICROBUNDLE_DATA=FOLDER python benchmarks/pillar_masks.py

Movies with drawn masks are real ones from the folder, and painted ones whose caps are known. The twitch is the range
(5th to 95th percentile over frames) of the mean movement along the tissue of the corner points in a mask, followed by
Lucas-Kanade from one relaxed frame; its ratio to that of the drawn mask is the ratio of the forces. The time is the CPU
time of `find_pillars` alone, the best of three runs; single frames of the folder have no drawn masks and no twitch.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import cv2
import numpy as np
import tifffile

from microbundle import Movie, read_movie
from microbundle.config import MaskParams, PillarParams
from microbundle.data import Bools, Masks
from microbundle.errors import CannotMeasure
from microbundle.mask import find_masks, overlap
from microbundle.pillar_masks import find_pillars
from microbundle.synth.render import beating_tissue

PAINTED = ((0, 0.0), (1, 30.0), (2, 90.0), (3, 150.0))
"""Seed and angle of the painted movies."""
MOST_FRAMES = 60


def movies() -> Iterator[Movie]:
    """Each movie with its drawn pillar masks, where there are some, among its supplied ones."""
    folder = os.environ.get("MICROBUNDLE_DATA")
    if folder:
        for name in ("type1_bright", "type1_dark"):
            yield replace(read_movie(Path(folder) / name), name=name)
        for file in sorted((Path(folder) / "single_frames").glob("*.tif")):
            yield Movie.from_array(tifffile.imread(file)[None], name=file.stem)
    for seed, angle in PAINTED:
        made = beating_tissue((320, 320), 30, seed=seed, angle_deg=angle)
        drawn = {f"pillar_{i + 1}": mask for i, mask in enumerate(made.pillars)}
        yield replace(made.movie, frames=made.array(), supplied_masks=drawn, name=f"painted {seed}, {angle:.0f} deg")


def twitch_px(movie: Movie, masks: Masks, pillars: tuple[Bools, ...]) -> list[float]:
    """Range of each pillar's mean movement along the tissue, in px."""
    index = np.linspace(0, movie.count - 1, min(movie.count, MOST_FRAMES)).round().astype(int)
    raw = [np.asarray(movie.frames[int(i)], np.float32) for i in index]
    low, high = np.percentile(raw[0], [0.1, 99.9])
    frames = [np.clip((frame - low) / (high - low) * 255, 0, 255).astype(np.uint8) for frame in raw]
    out = []
    for pillar in pillars:
        start = cv2.goodFeaturesToTrack(frames[0], 200, 1e-3, 4, mask=pillar.astype(np.uint8))
        moved = []
        for frame in frames:
            there, ok, _ = cv2.calcOpticalFlowPyrLK(frames[0], frame, start, None, winSize=(21, 21), maxLevel=3)
            step = (there - start)[ok.ravel() == 1, 0, ::-1] @ masks.axis.direction
            moved.append(float(np.mean(step)))
        out.append(float(np.ptp(np.percentile(moved, [5, 95]))))
    return out


def main() -> None:
    print("| movie | pillar | overlap (IoU) | twitch, automatic / drawn | source | plausibility | CPU ms |")
    print("|---|---|---|---|---|---|---|")
    for movie in movies():
        bare = replace(movie, supplied_masks={k: v for k, v in movie.supplied_masks.items() if k == "tissue"})
        try:
            masks = find_masks(bare, MaskParams())
            spent = []
            for _ in range(3):
                before = time.process_time()
                found = find_pillars(bare, masks, PillarParams())
                spent.append(1e3 * (time.process_time() - before))
        except CannotMeasure as error:
            print(f"| {movie.name} | | | | {type(error).__name__} | | |")
            continue
        drawn = None
        if "pillar_1" in movie.supplied_masks:
            drawn = find_pillars(movie, masks, PillarParams(masks="supplied")).masks
        ratio = ["" for _ in found.masks]
        shared = list(ratio)
        if drawn is not None:
            twitches = zip(twitch_px(movie, masks, found.masks), twitch_px(movie, masks, drawn), strict=True)
            ratio = [f"{one / other:.3f}" for one, other in twitches]
            shared = [f"{overlap(one, other):.2f}" for one, other in zip(found.masks, drawn, strict=True)]
        for i, name in enumerate(found.names):
            score = "" if found.score[i] is None else f"{found.score[i]:.2f}"
            print(f"| {movie.name} | {name} | {shared[i]} | {ratio[i]} | {found.source[i]} | {score} "
                  f"| {min(spent):.0f} |")


if __name__ == "__main__":
    main()
