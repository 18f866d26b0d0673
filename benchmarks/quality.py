"""How surely each fault of a movie is noticed, and how often a good movie is accused: the tables of docs/quality.md.

    python benchmarks/quality.py [MOVIES_PER_CELL [GOOD_MOVIES]]

Movies are small (128 x 224 px or, tilted, 160 x 224 px; 72 frames, three beats), each with a texture, amplitude, light
and tilt of its own. The first table counts movies that have the finding after a fault was made on purpose; a movie that
is refused counts as noticed. Faults of the frames are looked for by `check_movie` under the mask that is found on the
faulty movie, the others by the whole pipeline. The second table counts good movies with any finding that asks for
review.
"""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing import get_context

import numpy as np

from microbundle import Config, analyze
from microbundle.config import MaskParams, Method
from microbundle.data import Bools, Movie
from microbundle.errors import CannotMeasure
from microbundle.mask import find_masks
from microbundle.quality import check_movie
from microbundle.synth import faults
from microbundle.synth.cases import CLEAN_LARGE, Case, camera
from microbundle.synth.render import SyntheticMovie
from microbundle.synth.scenes import Analytic
from microbundle.synth.validate import draw

FRAMES, PERIOD = 72, 24
MID_BEAT = range(20, 60, 4)
Change = Callable[[Movie, Bools], Movie]


def of_tissue(share: float) -> Callable[[Movie, Bools], float]:
    """Grey value below which this share of the tissue lies."""
    return lambda movie, tissue: float(np.quantile(movie.frames[0][tissue], share))


def contrast(movie: Movie, tissue: Bools) -> float:
    return float(movie.frames[0][tissue].std())


FRAME_FAULTS: dict[str, dict[str, Change]] = {
    "blurred": {f"{s:g} px": lambda m, _, s=s: faults.blurred(m, s) for s in (1.0, 1.5, 2.0, 3.0)},
    "focus_drift": {f"to {s:g} px": lambda m, _, s=s: faults.losing_focus(m, s) for s in (0.3, 0.5, 0.7, 1.0)},
    "low_contrast": {f"{s:g} of the noise": lambda m, k, s=s: faults.faded(m, 8.0 * s / contrast(m, k), 8.0)
                     for s in (8.0, 4.0, 2.0, 1.0)},
    "few_grey_levels": {f"{n} in 4 SD": lambda m, k, n=n: faults.posterised(m, 4 * contrast(m, k) / n)
                        for n in (24, 12, 6, 3)},
    "saturated": {f"{s:.1%}": lambda m, k, s=s: faults.clipped(m, 0, of_tissue(1 - s)(m, k))
                  for s in (0.002, 0.006, 0.01, 0.05)},
    "saturated (dark)": {f"{s:.1%}": lambda m, k, s=s: faults.clipped(m, of_tissue(s)(m, k), 65535)
                         for s in (0.002, 0.006, 0.01, 0.05)},
    "flicker": {f"{s:.1%}": lambda m, _, s=s: faults.flickering(m, s, 1) for s in (0.005, 0.01, 0.02, 0.05)},
    "flash": {f"one frame {s:+.0%}": lambda m, _, s=s: faults.flashing(m, [31], s) for s in (0.04, -0.08, 0.08, 0.3)},
    "brightness_drift": {f"{s:.0%}": lambda m, _, s=s: faults.dimming(m, s) for s in (0.05, 0.1, 0.15, 0.3)},
    "repeated_frames": {
        "one": lambda m, _: faults.repeating(m, [31]), "ten": lambda m, _: faults.repeating(m, MID_BEAT),
        "every third": lambda m, _: faults.repeating(m, range(1, m.count, 3)),
        "every second": lambda m, _: faults.repeating(m, range(1, m.count, 2))},
    "dropped_frames": {"one": lambda m, _: faults.without_frames(m, [31]),
                       "ten": lambda m, _: faults.without_frames(m, MID_BEAT)},
    "calibration_unknown": {"no times": lambda m, _: replace(m, time_s=None)},
}


@dataclass(frozen=True)
class Faulty:
    """A movie with a fault that shows in its result."""

    scene: dict[str, object]
    change: Callable[[Movie, SyntheticMovie], Movie] = lambda movie, _: movie
    method: Method = "accurate"


def in_step(sigma_px: float) -> Callable[[Movie, SyntheticMovie], Movie]:
    """Blur that follows the contraction."""
    def change(movie: Movie, made: SyntheticMovie) -> Movie:
        size = made.truth.mad_px(made.truth.points_px(8.0))
        return faults.blurred_in_step(movie, sigma_px * size / size.max())
    return change


def keep(frames: range) -> Callable[[Movie, SyntheticMovie], Movie]:
    return lambda movie, _: faults.without_frames(movie, np.setdiff1d(np.arange(movie.count), frames))


RESULT_FAULTS: dict[str, dict[str, Faulty]] = {
    "contracted_start": {f"{m}, {name}": Faulty({"mad_px": 1.2, "first_beat": at}, method=m)
                         for m in ("accurate", "paper") for name, at in (("half way up", -0.1), ("at the peak", -0.2))},
    "sub_pixel_motion": {f"{m}, {s:g} px": Faulty({"mad_px": s}, method=m)
                         for m in ("accurate", "fast") for s in (0.1, 0.3)},
    "drift": {f"{s:g} px a frame": Faulty({"mad_px": 1.2, "drift_px": (s, 0.0)}) for s in (0.005, 0.02, 0.05)},
    "forward_backward": {f"contrast {s:g} of the noise": Faulty(
        {"mad_px": 1.2}, lambda m, made, s=s: faults.faded(m, 8.0 * s / contrast(m, made.truth.mask), 8.0), "fast")
        for s in (4.0, 2.0, 1.0)},
    "focus_with_beat": {f"{s:g} px at the peaks": Faulty({"mad_px": 0.8}, in_step(s)) for s in (0.4, 0.5, 0.7, 1.0)},
    "large_residual": {f"moves by {s:g} px in the middle": Faulty({"mad_px": s}) for s in (2.0, 3.0, 4.0)},
    "markers_lost": {f"fast, {s:g} px": Faulty({"mad_px": s}, method="fast") for s in (2.0, 3.0)},
    "few_beats": {f"{n} frames": Faulty({"mad_px": 1.2}, keep(range(n))) for n in (60, 54, 30)},
    "slow_frames": {f"{PERIOD / n:g} frames a beat":
                    Faulty({"mad_px": 1.2, "frames": 72 * n}, keep(range(0, 72 * n, n))) for n in (2, 3, 4)},
    "irregular_beats": {f"SD {s:.0%}": Faulty({"mad_px": 1.2, "variation": 2 * s, "frames": 144})
                        for s in (0.05, 0.1, 0.2)},
    "sign_change": {"inclusion": Faulty({"mad_px": 1.2, "inclusion": True, "side_px": 80.0})},
}


def good(seed: int, **changes: object) -> SyntheticMovie:
    """Make a good movie: texture, amplitude, light, depth of the counts and tilt are drawn from the seed."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, 51]))
    angle = float(rng.choice([0.0, 0.0, rng.uniform(-25, 25)]))
    scene = {"mad_px": float(np.exp(rng.uniform(np.log(0.1), np.log(1.5)))), "angle_deg": angle, "frames": FRAMES,
             "shape": (160 if angle else 128, 224), "side_px": 40.0, "delay_frames": rng.uniform(0, 4)}
    noise = replace(camera(seed, electrons=float(np.exp(rng.uniform(np.log(4e3), np.log(4e4)))),
                           read=rng.uniform(0.001, 0.004)), bits=int(rng.choice([8, 12, 16])))
    scene |= changes
    mad = scene.pop("mad_px")
    return draw(Case(f"good-{seed}", CLEAN_LARGE, Analytic(mad, seed, **scene), noise).make())


def noticed_in_frames(seed: int) -> list[tuple[str, str, bool]]:
    """Which frame faults are found in one movie, each at all strengths, and on the good movie itself."""
    made = good(seed)
    movie, tissue, out = made.movie, made.truth.mask, []
    for key, strengths in FRAME_FAULTS.items():
        for label, change in {"none": lambda m, _: m, **strengths}.items():
            spoilt = change(movie, tissue)
            try:
                masks = find_masks(spoilt, MaskParams())
                found = {f.key for f in check_movie(spoilt, masks)}
            except CannotMeasure:
                found = {key.split()[0]}
            out.append((key, label, key.split()[0] in found))
    return out


def noticed_in_result(job: tuple[str, str, int]) -> tuple[str, str, bool]:
    """Whether the fault of a result is found."""
    key, label, seed = job
    fault = RESULT_FAULTS[key][label]
    made = good(seed, **fault.scene)
    try:
        found = {f.key for f in analyze(fault.change(made.movie, made), settings(fault.method)).findings}
    except CannotMeasure:
        found = {key}
    return key, label, key in found


def accusations(job: tuple[Method, int]) -> list[str]:
    """Findings that ask for review in a good movie."""
    method, seed = job
    movie = good(seed).movie if method == "accurate" else good(seed, mad_px=1.2).movie
    return [f.key for f in analyze(movie, settings(method)).findings if f.level != "info"]


def settings(method: Method) -> Config:
    return Config.from_dict({"method": method, "registration": {"threads": 1}})


def main(each: int, many: int) -> None:
    """Print both tables."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    seeds = range(2000, 2000 + each)
    with get_context("spawn").Pool() as pool:
        caught: Counter[tuple[str, str]] = Counter()
        for one in pool.imap_unordered(noticed_in_frames, seeds):
            caught.update({(key, label): int(found) for key, label, found in one})
        jobs = [(key, label, seed) for key, strengths in RESULT_FAULTS.items() for label in strengths for seed in seeds]
        for key, label, seen in pool.imap_unordered(noticed_in_result, jobs):
            caught[key, label] += int(seen)
        print(f"| finding | fault and its strength: noticed in so many of {each} movies |\n|---|---|")
        for key, strengths in (FRAME_FAULTS | RESULT_FAULTS).items():
            labels = (["none"] if key in FRAME_FAULTS else []) + list(strengths)
            print(f"| `{key}` | " + "; ".join(f"{label}: {caught[key, label]}" for label in labels) + " |", flush=True)
        print("\n| good movies | accused | by |\n|---|---|---|")
        kinds: tuple[tuple[Method, int], ...] = (("accurate", many), ("fast", many // 3))
        for method, count in kinds:
            found = list(pool.imap_unordered(accusations, [(method, s) for s in range(3000, 3000 + count)]))
            by = Counter(key for keys in found for key in keys)
            accused = sum(bool(keys) for keys in found)
            print(f"| {count}, `{method}` | {accused} ({accused / count:.1%}) | "
                  + (", ".join(f"`{key}` {n}" for key, n in by.most_common()) or "-") + " |", flush=True)


if __name__ == "__main__":
    main(*(int(a) for a in sys.argv[1:3]), *(8, 120)[len(sys.argv) - 1:])
