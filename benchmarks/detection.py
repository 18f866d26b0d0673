"""False alarms in motionless movies, and how small a beat is found, against the stated detection limit.

    python benchmarks/detection.py [MOVIES_PER_KIND]

Every movie is small (96 x 160 px, 60 frames), has a texture of its own, and goes through the whole pipeline. The first
table counts motionless movies in which a beat was found, whole or cut off. The second counts movies in which a beat was
found when the tissue beats with an amplitude (mean over the tissue of the absolute displacement at the peak) of some
multiple of the limit that the same movie states when nothing moves.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import replace
from multiprocessing import get_context

import numpy as np

from microbundle import Config, analyze
from microbundle.config import Method
from microbundle.data import Beats
from microbundle.synth.cases import STILL, Case, camera, perlin
from microbundle.synth.noise import NoiseModel
from microbundle.synth.scenes import Analytic

SHAPE, FRAMES = (96, 160), 60
METHODS: tuple[Method, ...] = ("accurate", "fast")
MULTIPLES = (0.5, 1.0, 2.0, 4.0)


def weak_light(seed: int) -> NoiseModel:
    """2,000 electrons at full scale and much read noise."""
    return camera(seed, electrons=2_000, read=0.01)


def grains(ratio: float, octaves: int) -> Callable[[int], NoiseModel]:
    """Perlin noise with as many pixels to a grain as in the large movies of the validation."""
    return lambda seed: perlin(ratio, octaves, 448, seed)


DRIFT_PX = (0.02, -0.01)
KINDS: dict[str, tuple[Callable[[int], NoiseModel], tuple[float, float]]] = {
    "camera": (camera, (0.0, 0.0)),
    "camera, 8 bits, hot pixels": (lambda seed: replace(camera(seed), bits=8, hot_pixels=0.001), (0.0, 0.0)),
    "weak light": (weak_light, (0.0, 0.0)),
    "flicker and lamp": (lambda seed: replace(camera(seed), flicker_gain=0.01, lamp_drift=0.03), (0.0, 0.0)),
    "shading drifts": (lambda seed: replace(camera(seed), shading_drift=0.05), (0.0, 0.0)),
    "Perlin 2 %, 40": (grains(0.02, 40), (0.0, 0.0)),
    "Perlin 4 %, 24": (grains(0.04, 24), (0.0, 0.0)),
    "Perlin 6 %, 28": (grains(0.06, 28), (0.0, 0.0)),
    "Perlin 12 %, 18": (grains(0.12, 18), (0.0, 0.0)),
    "focus breathes": (lambda seed: replace(camera(seed), defocus_swing_px=0.4, defocus_period_frames=24.0),
                       (0.0, 0.0)),
    "stage drifts": (camera, DRIFT_PX),
    "stage drifts, weak light": (weak_light, DRIFT_PX),
}


def beats_of(kind: str, seed: int, method: Method, amplitude_px: float = 0.0) -> Beats:
    """Analyze one movie whose tissue beats with the given amplitude."""
    noise, drift = KINDS[kind]
    scene = Analytic(0.0, seed, shape=SHAPE, frames=FRAMES, side_px=30.0, drift_px=drift)
    if amplitude_px > 0:
        scene = replace(scene, mad_px=amplitude_px / tissue_share(scene))
    movie = Case("detection", STILL, scene, noise(seed)).make().drawn().movie
    return analyze(movie, Config.from_dict({"method": method, "registration": {"threads": 1}})).beats


def tissue_share(scene: Analytic) -> float:
    """Amplitude over the whole tissue of a scene that moves by 1 px in the middle."""
    truth = Case("unit", STILL, replace(scene, mad_px=1.0, drift_px=(0.0, 0.0))).make().truth
    points = np.argwhere(truth.mask)[::11].astype(float)
    lengths = [np.hypot(*truth.displacement_px(points, t).T).mean() for t in range(truth.motion.count)]
    return float(max(lengths) - min(lengths))


def false_alarm(job: tuple[str, int, Method]) -> tuple[bool, float]:
    """Whether a motionless movie has a beat, and its detection limit."""
    beats = beats_of(*job)
    return len(beats) > 0, beats.detection_limit_px


def found(job: tuple[str, int, Method, float]) -> bool:
    """Whether a beat of so many times the limit is found."""
    kind, seed, method, multiple = job
    limit = beats_of(kind, seed, method).detection_limit_px
    return len(beats_of(kind, seed, method, multiple * limit)) > 0


def main(count: int) -> None:
    """Print both tables."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    seeds = range(1000, 1000 + count)
    with get_context("spawn").Pool() as pool:
        print("| motionless movies | " + " | ".join(f"{m}: alarms | limit (px)" for m in METHODS) + " |")
        print("|---" * (1 + 2 * len(METHODS)) + "|")
        total = dict.fromkeys(METHODS, 0)
        for kind in KINDS:
            cells = []
            for method in METHODS:
                results = pool.map(false_alarm, [(kind, seed, method) for seed in seeds])
                alarms = sum(alarm for alarm, _ in results)
                total[method] += alarms
                cells += [f"{alarms} of {count}", f"{np.median([limit for _, limit in results]):.4f}"]
            print(f"| {kind} | " + " | ".join(cells) + " |", flush=True)
        print("all: " + ", ".join(f"{m} {n} of {count * len(KINDS)}" for m, n in total.items()) + "\n")

        print("| found at a multiple of the limit | " + " | ".join(f"{m} {x:g}" for m in METHODS for x in MULTIPLES)
              + " |")
        print("|---" * (1 + len(METHODS) * len(MULTIPLES)) + "|")
        for kind in ("camera", "weak light", "flicker and lamp", "Perlin 2 %, 40", "Perlin 6 %, 28"):
            cells = []
            for method in METHODS:
                for multiple in MULTIPLES:
                    share = np.mean(pool.map(found, [(kind, seed, method, multiple) for seed in seeds]))
                    cells.append(f"{100 * share:.0f} %")
            print(f"| {kind} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
