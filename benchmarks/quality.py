"""How surely each fault of a movie is noticed, and how often a good movie is accused: the tables of docs/quality.md.

    python benchmarks/quality.py [MOVIES_PER_CELL [GOOD_MOVIES]]

Movies are small (128 x 224 px or, tilted, 160 x 224 px; 72 frames, three beats), each with a texture, light and tilt of
its own. The first table counts movies that have the finding after a fault was made on purpose, and `none` those that
have it before; a movie that is refused counts as noticed. The tissue's true mask is given, so that a share of the
tissue means the same in all of them. The error is the median over movies of the root mean square error of displacement
at the peaks, over the tissue, by the method named or `accurate`. The second table counts good movies, of any amplitude
from 0.1 px and with the mask that the program finds, with any finding that asks for review.
"""

from __future__ import annotations

import os
import sys
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing import get_context

import numpy as np

from microbundle import Config, analyze
from microbundle.analysis import Analysis
from microbundle.config import Method
from microbundle.data import Movie
from microbundle.errors import CannotMeasure
from microbundle.quality import check_movie
from microbundle.synth import faults
from microbundle.synth.cases import CLEAN_LARGE, Case, camera
from microbundle.synth.render import SyntheticMovie
from microbundle.synth.scenes import Analytic

METHODS: tuple[Method, ...] = ("accurate", "fast")
FRAMES, PERIOD = 72, 24
SHAPE, TILTED_SHAPE = (128, 224), (160, 224)
MID_BEAT = range(20, 60, 4)
Change = Callable[[Movie, SyntheticMovie], Movie]


@dataclass(frozen=True)
class Fault:
    """How a good movie is made faulty, and where the fault is looked for."""

    change: Change = lambda movie, _: movie
    method: Method | None = None
    """None for faults of the frames, which `check_movie` finds."""
    scene: tuple[tuple[str, object], ...] = (("mad_px", 1.2),)
    """What is drawn differently from a good movie."""


def below(made: SyntheticMovie, share: float) -> float:
    """Grey value below which this share of the tissue lies."""
    return float(np.quantile(made.movie.frames[0][made.truth.mask], share))


def contrast(made: SyntheticMovie) -> float:
    return float(made.movie.frames[0][made.truth.mask].std())


def faded(times_noise: float) -> Change:
    return lambda movie, made: faults.faded(movie, 8.0 * times_noise / contrast(made), 8.0)


def in_step(sigma_px: float) -> Change:
    """Blur that follows the contraction."""
    def change(movie: Movie, made: SyntheticMovie) -> Movie:
        size = made.truth.mad_px(made.truth.points_px(8.0))
        return faults.blurred_in_step(movie, sigma_px * size / size.max())
    return change


def keep(first: int, stop: int, step: int = 1) -> Change:
    return lambda movie, _: faults.without_frames(movie, np.setdiff1d(np.arange(movie.count), range(first, stop, step)))


def from_beat(share: float) -> Change:
    """Begin where the tissue is contracted to a share of the first beat's peak."""
    def change(movie: Movie, made: SyntheticMovie) -> Movie:
        size = made.truth.mad_px(made.truth.points_px(8.0))
        peak = int(np.argmax(size[:PERIOD]))
        return keep(int(np.flatnonzero(size[:peak + 1] >= share * size[peak])[0]), movie.count)(movie, made)
    return change


def moving(**scene: object) -> tuple[tuple[str, object], ...]:
    return tuple({"mad_px": 1.2, **scene}.items())


FAULTS: dict[str, dict[str, Fault]] = {
    "blurred": {f"{s:g} px": Fault(lambda m, _, s=s: faults.blurred(m, s)) for s in (1.0, 1.5, 2.0, 3.0)},
    "focus_drift": {f"to {s:g} px": Fault(lambda m, _, s=s: faults.losing_focus(m, s)) for s in (0.4, 0.5, 0.7, 1.0)},
    "focus_with_beat": {f"{s:g} px at the peaks": Fault(in_step(s), "accurate") for s in (0.4, 0.5, 0.7, 1.0)},
    "low_contrast": {f"{s:g} times the noise": Fault(faded(s)) for s in (8.0, 4.0, 2.0, 1.0)},
    "few_grey_levels": {f"{n} in 4 SD": Fault(lambda m, made, n=n: faults.posterised(m, 4 * contrast(made) / n))
                        for n in (24, 12, 6, 3)},
    "saturated": {f"{s:.1%}": Fault(lambda m, made, s=s: faults.clipped(m, 0, below(made, 1 - s)))
                  for s in (0.002, 0.01, 0.05, 0.2)},
    "saturated (dark)": {f"{s:.1%}": Fault(lambda m, made, s=s: faults.clipped(m, below(made, s), 65535))
                         for s in (0.002, 0.01, 0.05, 0.2)},
    "flicker": {f"{s:.1%}": Fault(lambda m, _, s=s: faults.flickering(m, s, 1)) for s in (0.005, 0.01, 0.02, 0.05)},
    "flash": {f"one frame {s:+.0%}": Fault(lambda m, _, s=s: faults.flashing(m, [31], s))
              for s in (0.03, 0.08, -0.08, 0.3)},
    "brightness_drift": {f"{s:.0%}": Fault(lambda m, _, s=s: faults.dimming(m, s)) for s in (0.05, 0.1, 0.15, 0.3)},
    "repeated_frames": {name: Fault(lambda m, _, frames=frames: faults.repeating(m, frames)) for name, frames in (
        ("one", [31]), ("ten", MID_BEAT), ("every third", range(1, FRAMES, 3)), ("every second", range(1, FRAMES, 2)))},
    "dropped_frames": {name: Fault(lambda m, _, frames=frames: faults.without_frames(m, frames))
                       for name, frames in (("one", [31]), ("ten", MID_BEAT))},
    "calibration_unknown": {"no times": Fault(lambda m, _: replace(m, time_s=None))},
    "contracted_start": {f"{m}, at {s:.0%}": Fault(from_beat(s), m)
                         for m in ("accurate", "paper") for s in (0.5, 0.9)},  # type: ignore[arg-type]
    "sub_pixel_motion": {f"{m}, {s:g} px": Fault(method=m, scene=moving(mad_px=s))  # type: ignore[arg-type]
                         for m in ("accurate", "fast") for s in (0.1, 0.3)},
    "drift": {f"{s:g} px a frame": Fault(method="accurate", scene=moving(drift_px=(s, 0.0))) for s in (0.01, 0.04)},
    "forward_backward": {f"contrast {s:g} times the noise": Fault(faded(s), "fast") for s in (4.0, 2.0, 1.0)},
    "large_residual": {f"{s:g} px in the middle": Fault(method="accurate", scene=moving(mad_px=s)) for s in (2.0, 3.0)},
    "peaks_lost": {f"{s:g} px in the middle": Fault(method="accurate", scene=moving(mad_px=s)) for s in (2.0, 3.0)},
    "markers_lost": {f"fast, {s:g} px in the middle": Fault(method="fast", scene=moving(mad_px=s)) for s in (2.0, 3.0)},
    "few_beats": {f"{n} frames": Fault(keep(0, n), "accurate") for n in (60, 45, 30)},
    "slow_frames": {f"{PERIOD / n:g} frames a beat": Fault(keep(0, FRAMES, n), "accurate") for n in (2, 3, 4)},
    "irregular_beats": {f"periods vary by {s:.0%}": Fault(method="accurate", scene=moving(variation=2 * s, frames=120))
                        for s in (0.05, 0.2)},
}


def good(seed: int, **changes: object) -> SyntheticMovie:
    """Make a good movie: texture, amplitude, light, depth of the counts and tilt are drawn from the seed."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, 51]))
    angle = float(rng.choice([0.0, 0.0, rng.uniform(-25, 25)]))
    scene = {"mad_px": float(np.exp(rng.uniform(np.log(0.1), np.log(1.5)))), "angle_deg": angle, "frames": FRAMES,
             "shape": TILTED_SHAPE if angle else SHAPE, "side_px": 40.0, "delay_frames": rng.uniform(0, 4)}
    noise = replace(camera(seed, electrons=float(np.exp(rng.uniform(np.log(4e3), np.log(4e4)))),
                           read=rng.uniform(0.001, 0.004)), bits=int(rng.choice([8, 12, 16])))
    scene |= changes
    mad = scene.pop("mad_px")
    return Case(f"good-{seed}", CLEAN_LARGE, Analytic(mad, seed, **scene), noise).make().drawn()  # type: ignore[arg-type]


def noticed(seed: int) -> list[tuple[str, str, bool, float]]:
    """Which faults are found in one movie, and how wrong displacement becomes; `none` is the good movie."""
    drawn: dict[object, SyntheticMovie] = {}
    out = []
    for key, strengths in FAULTS.items():
        kind = key.split()[0]
        none = {} if next(iter(strengths.values())).method else {"none": Fault()}
        for label, fault in (none | strengths).items():
            if fault.scene not in drawn:
                drawn[fault.scene] = good(seed, **dict(fault.scene))
            made = drawn[fault.scene]
            spoilt = fault.change(made.movie, made)
            spoilt = replace(spoilt, frames=np.stack([spoilt.frames[t] for t in range(spoilt.count)]),
                             supplied_masks={"tissue": made.truth.mask})
            found, error = judge(spoilt, fault.method, made)
            error = np.nan if key == "drift" else error  # drift is motion, but not from rest
            out.append((key, label, found is None or kind in found, error))
    return out


def judge(movie: Movie, method: Method | None, made: SyntheticMovie) -> tuple[set[str] | None, float]:
    """Keys that a movie has, None where it cannot be measured at all, and the error of displacement in px."""
    try:
        analysis = analyze(movie, settings(method or "accurate"))
        found = analysis.findings if method else check_movie(movie, analysis.masks)
        return {f.key for f in found}, error_px(analysis, made)
    except CannotMeasure:
        return None, np.nan


def error_px(analysis: Analysis, made: SyntheticMovie) -> float:
    """Root mean square error of displacement at the peaks, NaN for other frames than the good movie has."""
    peaks = analysis.beats.peak[analysis.beats.complete]
    if len(peaks) == 0 or analysis.frame_count != made.movie.count:
        return float("nan")
    points = made.truth.points_px(8.0)
    points = points[analysis.inside(points)]
    away = analysis.displacement_at(points)[peaks] - np.stack([made.truth.displacement_px(points, t) for t in peaks])
    return float(np.sqrt(np.nanmean((away**2).sum(axis=-1))))


def accusations(seed: int) -> dict[Method, list[str]]:
    """Findings that ask for review in a good movie. Single markers are not asked for motion of less than a pixel."""
    movie = good(seed).movie
    found = {method: analyze(movie, settings(method)).findings for method in METHODS}
    small = any(f.key == "sub_pixel_motion" for f in found["fast"])
    return {method: [f.key for f in found[method] if f.level != "info"]
            for method in METHODS if method == "accurate" or not small}


def cell(label: str, found: list[tuple[bool, float]]) -> str:
    error = np.array([error for _, error in found])
    known = f" ({np.nanmedian(error):.3f})" if np.isfinite(error).any() else ""
    return f"{label}: {sum(seen for seen, _ in found)}{known}"


def settings(method: Method) -> Config:
    return Config.from_dict({"method": method, "registration": {"threads": 1}})


def main(each: int, many: int) -> None:
    """Print both tables."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    with get_context("spawn").Pool() as pool:
        caught: dict[tuple[str, str], list[tuple[bool, float]]] = defaultdict(list)
        for one in pool.imap_unordered(noticed, range(2000, 2000 + each)):
            for key, label, seen, error in one:
                caught[key, label].append((seen, error))
        print(f"| finding | fault and its strength: noticed in so many of {each} movies (error of displacement, px) |")
        print("|---|---|")
        for key, strengths in FAULTS.items():
            labels = (["none"] if (key, "none") in caught else []) + list(strengths)
            print(f"| `{key}` | " + "; ".join(cell(label, caught[key, label]) for label in labels) + " |", flush=True)
        print("\n| good movies | accused | by |\n|---|---|---|")
        found = list(pool.imap_unordered(accusations, range(3000, 3000 + many)))
        for method in METHODS:
            mine = [one[method] for one in found if method in one]
            by = Counter(key for keys in mine for key in keys)
            accused = sum(bool(keys) for keys in mine)
            print(f"| {len(mine)}, `{method}` | {accused} ({accused / max(len(mine), 1):.1%}) | "
                  + (", ".join(f"`{key}` {n}" for key, n in by.most_common()) or "-") + " |", flush=True)


if __name__ == "__main__":
    main(*(int(a) for a in sys.argv[1:3]), *(8, 120)[len(sys.argv) - 1:])
