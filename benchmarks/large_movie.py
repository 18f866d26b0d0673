"""Time, memory and error of the registration on a large movie: 1080 x 1920 px, of which 1.6 Mpx count, 8 px of motion.

    python benchmarks/large_movie.py [frames ...]

A random, band-limited texture is moved by an analytic motion; six frames are drawn once, kept on disk and shown again
and again, so that each length costs one process of its own. Time is user + system time of all threads; memory is the
peak resident size: of the whole process, and beyond what it held before the registration, with and without the pooling
of frames that ends it. Linear algebra uses one thread, for its idle threads count as work.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

SHAPE = (1080, 1920)
MASK = (slice(90, 990), slice(70, 1850))
DRAWN = 6
PEAK_PX = 8.0


def motion():
    """Beat of the tissue, the same in every round of the frames drawn."""
    from microbundle.synth.motion import Rhythm, TissueMotion

    rhythm = Rhythm(DRAWN, DRAWN, shape="cosine", first_beat=0.2, active=0.7)
    return TissueMotion(rhythm, (SHAPE[0] / 2, SHAPE[1] / 2), 890.0, 450.0, PEAK_PX, delay_frames=0.3)


def draw(folder: Path) -> float:
    """Draw the frames, and give the CPU seconds of each."""
    from scipy import ndimage

    from microbundle.synth.render import Rendered
    from microbundle.synth.texture import band_limited

    rng = np.random.default_rng(0)
    grain = sum(a * ndimage.gaussian_filter(rng.standard_normal(SHAPE), s) * s for s, a in ((1.2, 1.0), (4.0, 1.5)))
    frames = Rendered(band_limited(0.5 + 0.12 * grain / grain.std()), motion(), SHAPE)
    started = time.process_time()
    for t in range(DRAWN):
        frames[t].tofile(folder / f"{t}.raw")
    return (time.process_time() - started) / DRAWN


@dataclass(frozen=True)
class Repeated:
    """A movie of any length from a few frames on disk; one is in memory at a time."""

    folder: Path
    count: int

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> np.ndarray:
        return np.fromfile(self.folder / f"{index % DRAWN}.raw", np.uint16).reshape(SHAPE)


def measure(folder: Path, frames: int) -> dict[str, float]:
    """Register a movie of so many frames, in this process."""
    import resource

    from microbundle import Config
    from microbundle.axis import measure_axis
    from microbundle.data import Markers, Masks, Movie
    from microbundle.register import register

    def peak_mb() -> float:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024

    tissue = np.zeros(SHAPE, bool)
    tissue[MASK] = True
    points = np.stack(np.meshgrid(np.arange(110.0, 970, 24), np.arange(90.0, 1830, 24), indexing="ij"), -1)
    points = points.reshape(-1, 2)
    masks = Masks(tissue, measure_axis(tissue), "supplied")
    markers = Markers(points, 0, 0.01, 24.0, 576.0)
    config = Config.from_dict({"registration": {"threads": 1}})
    warm_up(config)
    movie = Movie("large", Repeated(folder, frames), SHAPE)
    before, cpu = peak_mb(), time.process_time()
    passes = 0.0

    def tell(_: float) -> None:
        nonlocal passes
        passes = peak_mb() - before

    tracks = register(movie, masks, markers, config, tell)
    cpu = time.process_time() - cpu
    peak = peak_mb()
    exact = np.stack([motion().displacement_px(points, t % DRAWN) for t in range(frames)])
    found = tracks.position_px - tracks.position_px[0]
    rmse = float(np.sqrt(((found - (exact - exact[0])) ** 2).mean()))
    return {"frames": frames, "ms_per_frame": 1000 * cpu / frames, "peak_mb": peak, "passes_mb": passes,
            "kernel_mb": peak - before, "rmse_px": rmse, "peak_px": float(np.abs(exact).max())}


def warm_up(config) -> None:
    """Register a small movie, so that the kernels are compiled."""
    from microbundle import analyze
    from microbundle.synth.render import beating_tissue

    analyze(beating_tissue((160, 240), 4, peak_px=1.0).movie, config)


def child(call: str) -> object:
    """Result of a function of this file in a process of its own; the parent stays small, for a child's peak counts
    from its parent's."""
    code = (f"import json, sys; from pathlib import Path; sys.path.insert(0, {str(Path(__file__).parent)!r}); "
            f"import large_movie as m; print(json.dumps(m.{call}))")
    done = subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.PIPE, text=True,
                          env={**os.environ, "OPENBLAS_NUM_THREADS": "1"})
    return json.loads(done.stdout)


def main() -> None:
    lengths = [int(a) for a in sys.argv[1:]] or [12, 24]
    with tempfile.TemporaryDirectory() as made:
        print(f"drawing: {child(f'draw(Path({made!r}))'):.1f} s a frame; {tissue_px():.2f} Mpx of tissue\n", flush=True)
        print("| frames | CPU ms a frame | each further frame | peak memory, MB | of the passes | and pooling | "
              "error, px (RMS) |\n|---|---|---|---|---|---|---|")
        last = None
        for frames in lengths:
            r = child(f"measure(Path({made!r}), {frames})")
            spent = frames * r["ms_per_frame"]
            more = "" if last is None else f"{(spent - last[1]) / (frames - last[0]):.0f}"
            print(f"| {frames} | {r['ms_per_frame']:.0f} | {more} | {r['peak_mb']:.0f} | {r['passes_mb']:.0f} | "
                  f"{r['kernel_mb']:.0f} | {r['rmse_px']:.4f} of {r['peak_px']:.1f} |", flush=True)
            last = frames, spent


def tissue_px() -> float:
    """Size of the mask in millions of pixels."""
    return (MASK[0].stop - MASK[0].start) * (MASK[1].stop - MASK[1].start) / 1e6


if __name__ == "__main__":
    main()
