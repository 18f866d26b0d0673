"""Displacement and strain of other programs and of this one on the same movies: the table "Other programs" of
docs/benchmarks.md.

    pip install muDIC pyidi openpiv mps-motion "opencv-python-headless<5"
    pip install --force-reinstall --no-deps "opencv-contrib-python-headless<5"
    python benchmarks/peers.py [--processes N] [--seeds N] [KIND ...]

(The second line because TV-L1 is among the contributed modules of OpenCV 4, which must be installed last.) An
environment of its own is advised. A program that is not installed is left out, with the reason. None of them is needed
by microbundle.

Every program gets the same movie and the same relaxed reference frame, and answers at the same material points. From
each answer the mean over the frames in which the tissue truly rests, around each beat, is taken off, and the same of
the truth. The errors are those of `microbundle.synth.scores`: root mean square length of the displacement's error over
points and frames of the beats, the error of the peak mean absolute displacement of a beat (the worst beat), and the
mean absolute error of E_cc over a beat as a share of the largest |E_cc| there (the worst beat and sub-domain of 2 x 2),
with E_cc from one least-squares F over a dense grid for all programs. CPU seconds are user + system time of all
threads, after a first run on a few frames. A cell is the mean over the seeds (lowest to highest).
"""

from __future__ import annotations

import argparse
import os
import resource
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from multiprocessing import get_context

import numpy as np
from peer_tools import TOOLS

from microbundle.data import Bools, Floats, Image
from microbundle.errors import MicrobundleError
from microbundle.strain import fit_gradient
from microbundle.synth.cases import CLEAN_LARGE, Case, camera, perlin
from microbundle.synth.noise import NoiseModel
from microbundle.synth.scenes import Analytic
from microbundle.synth.scores import true_displacement
from microbundle.synth.truth import TrueBeats, true_beats

SHAPE, FRAMES, SIDE_PX = (160, 256), 60, 48.0
FIRST_SEED = 301
LARGE_PX, SMALL_PX = 1.4, 0.4
"""Peak of the mean absolute displacement."""
FEW_FRAMES = 12
FORMS = (".4f", ".2f", ".2f", ".1f")


def clean(seed: int) -> NoiseModel:
    """16 bits, nothing else."""
    return NoiseModel(seed=seed)


def grains(seed: int) -> NoiseModel:
    """Perlin noise of 6 %, with as many pixels to a grain as in the larger movies of the validation."""
    return perlin(0.06, 28, 448, seed)


KINDS: dict[str, tuple[float, Callable[[int], NoiseModel]]] = {
    "clean-large": (LARGE_PX, clean), "clean-small": (SMALL_PX, clean),
    "camera-large": (LARGE_PX, camera), "camera-small": (SMALL_PX, camera),
    "perlin-large": (LARGE_PX, grains), "perlin-small": (SMALL_PX, grains),
}


@dataclass(frozen=True)
class Question:
    """A movie, and what is to be measured in it."""

    frames: Image
    """(T, R, C)"""
    tissue: Bools
    """(R, C)"""
    reference: int
    seen_px: Floats
    """(P, 2): where the reference frame shows the points; a quarter of them, in order, for each sub-domain."""
    true_px: Floats
    """(T, P, 2): true displacement of these points from the state without motion."""
    home_px: Floats
    """(P, 2): the points there."""
    beats: TrueBeats


def ask(kind: str, seed: int) -> Question:
    """Make a movie; the reference is the frame in which the tissue is most at rest."""
    amplitude, noise = KINDS[kind]
    case = Case(kind, CLEAN_LARGE, Analytic(amplitude, seed, shape=SHAPE, frames=FRAMES, side_px=SIDE_PX), noise(seed))
    synthetic = case.make().drawn()
    home = case.domain.points_px.reshape(-1, 2)
    true, beats = true_displacement(synthetic.truth, home), true_beats(synthetic.truth)
    resting = np.flatnonzero(beats.resting)
    reference = int(resting[np.argmin(beats.deformation_px[resting])])
    return Question(np.asarray(synthetic.movie.frames), synthetic.truth.mask, reference, home + true[reference], true,
                    home, beats)


def errors(question: Question, found: Floats) -> tuple[float, float, float]:
    """RMSE (px), error of the peak (%), worst E_cc error (%) of displacements (T, P, 2) from the reference frame."""
    q, wrong, peak, strain = question, [], [], []
    for b in np.flatnonzero(q.beats.complete):
        window, rest = np.arange(q.beats.start[b], q.beats.stop[b]), q.beats.rest_frames(int(b))
        true, measured = (u[window] - u[rest].mean(axis=0) for u in (q.true_px, found))
        wrong.append(((measured - true) ** 2).sum(axis=-1).ravel())
        mad = [np.hypot(u[..., 0], u[..., 1]).mean(axis=1).max() for u in (true, measured)]
        peak.append(100 * abs(mad[1] / mad[0] - 1))
        at_rest = q.home_px + q.true_px[rest].mean(axis=0)
        for tile in np.split(np.arange(len(at_rest)), 4):
            exact, fitted = (ecc(at_rest[tile], u[:, tile]) for u in (true, measured))
            strain.append(100 * np.abs(fitted - exact).mean() / np.abs(exact).max())
    return float(np.sqrt(np.concatenate(wrong).mean())), float(max(peak)), float(max(strain))


def ecc(rest: Floats, moved: Floats) -> Floats:
    """E_cc (t,) from F fitted to points (n, 2) at rest and their displacements (t, n, 2)."""
    column = fit_gradient(rest, rest + moved)[0][:, :, 1]
    return np.asarray(0.5 * ((column**2).sum(axis=1) - 1))


@cache
def warmed_up(name: str) -> None:
    """Let a program import and compile what it needs."""
    q = warm_up_question()
    TOOLS[name](q.frames[:FEW_FRAMES], 0, q.seen_px, q.tissue)


@cache
def warm_up_question() -> Question:
    """A movie to warm up with."""
    return ask("clean-small", FIRST_SEED - 1)


def measure_all(job: tuple[str, int]) -> list[tuple[float, float, float, float] | str]:
    """What each program gives on a movie."""
    import cv2

    cv2.setNumThreads(1)
    question = ask(*job)
    return [measure(name, question) for name in TOOLS]


def measure(name: str, question: Question) -> tuple[float, float, float, float] | str:
    """Errors and CPU seconds of a program on a movie, or why there are none."""
    try:
        warmed_up(name)
        before = resource.getrusage(resource.RUSAGE_SELF)
        found = TOOLS[name](question.frames, question.reference, question.seen_px, question.tissue)
        after = resource.getrusage(resource.RUSAGE_SELF)
    except ImportError as error:
        return f"not installed ({error})"
    except (MicrobundleError, AttributeError) as error:  # an OpenCV without the contributed modules lacks attributes
        return f"failed ({error})"
    return *errors(question, found), after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def cell(values: Sequence[float], form: str) -> str:
    """Mean and range."""
    return f"{np.mean(values):{form}} ({min(values):{form}} to {max(values):{form}})"


def main() -> None:
    """Print one table for each kind of movie."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"of {', '.join(KINDS)}; all by default")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"))
    seeds = range(FIRST_SEED, FIRST_SEED + options.seeds)
    kinds = options.kinds or list(KINDS)
    with get_context("spawn").Pool(options.processes) as pool:
        answers = pool.imap(measure_all, [(kind, seed) for kind in kinds for seed in seeds])
        for kind in kinds:
            print(f"\n### {kind}: peak {KINDS[kind][0]:g} px, {len(seeds)} seeds\n")
            print(f"| program | RMSE px | peak MAD error % | worst E_cc error % | CPU s |\n{'|---' * 5}|")
            movies = [next(answers) for _ in seeds]
            for name, rows in zip(TOOLS, zip(*movies, strict=True), strict=True):
                print(f"| {name} | {line(rows)} |", flush=True)


def line(rows: Sequence[tuple[float, float, float, float] | str]) -> str:
    """The cells of one program."""
    numbers = [row for row in rows if not isinstance(row, str)]
    if len(numbers) < len(rows):
        return next(row for row in rows if isinstance(row, str)) + " | | | "
    return " | ".join(cell(column, form) for column, form in zip(zip(*numbers, strict=True), FORMS, strict=True))


if __name__ == "__main__":
    main()
