"""Time and memory of the pipeline on a real movie: the tables "Speed" and "Memory" of docs/benchmarks.md.

    MICROBUNDLE_DATA=FOLDER python benchmarks/speed.py

CPU seconds are user + system time of all threads, without importing. The published tool's figures are those measured
on 200 frames of the same movie, halved for 100. Memory is the peak resident size of a process of its own. Linear
algebra uses one thread, for its idle threads count as work.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
LK_POINTS = 1400

PUBLISHED_CPU_S = {"mask": 1.4 / 2, "tracking": 8.5 / 2, "interpolation": 16 / 2, "strain": 2.5 / 2}
"""The published tool, 200 frames of 512 x 512 px, halved."""


def cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def stages(folder: Path, method: str) -> dict[str, float]:
    """CPU seconds of each stage, the best of three runs after one that warms up."""
    from dataclasses import replace

    from microbundle import Config, read_movie
    from microbundle.beats import find_beats
    from microbundle.grid import interpolate_grid
    from microbundle.markers import place_markers
    from microbundle.mask import find_masks
    from microbundle.reference import find_relaxed_frame
    from microbundle.register import register
    from microbundle.strain import measure_strain
    from microbundle.track import track_markers

    follow = register if method == "accurate" else track_markers
    best: dict[str, float] = {}
    for _ in range(4):
        spent: dict[str, float] = {}

        def timed(name, work):
            before = cpu_s()
            result = work()
            spent[name] = spent.get(name, 0.0) + cpu_s() - before  # noqa: B023
            return result

        config = Config(method=method)
        movie = timed("mask", lambda: replace(read_movie(folder, fps=30, um_per_px=4), supplied_masks={}))
        masks = timed("mask", lambda: find_masks(movie, config.mask))  # noqa: B023
        frame = timed("tracking", lambda: find_relaxed_frame(movie, masks, config))  # noqa: B023
        markers = timed("tracking", lambda: place_markers(movie, masks, frame, config))  # noqa: B023
        tracks = timed("tracking", lambda: follow(movie, masks, markers, config, lambda _: None))  # noqa: B023
        beats = timed("tracking", lambda: find_beats(tracks, masks, movie, config))  # noqa: B023
        timed("interpolation", lambda: interpolate_grid(tracks, beats, masks, config))  # noqa: B023
        timed("strain", lambda: measure_strain(tracks, beats, masks, config))  # noqa: B023
        best = {name: min(value, best.get(name, value)) for name, value in spent.items()}
    return best


def beside_lucas_kanade(folder: Path) -> dict[str, float]:
    """CPU ms a frame of the registration, template included, and of OpenCV's pyramidal Lucas-Kanade for LK_POINTS
    points on the same frames; each with reading, the best of five runs in turn."""
    import cv2
    import numpy as np

    from microbundle import Config, read_movie
    from microbundle.markers import place_markers
    from microbundle.mask import find_masks
    from microbundle.register import register

    config = Config()
    movie = read_movie(folder, fps=30, um_per_px=4)
    masks = find_masks(movie, config.mask)
    markers = place_markers(movie, masks, 0, config)
    step = 255 / float(movie.frames[0].max())

    def gray8(frame):
        return np.clip(frame * step, 0, 255).astype(np.uint8)

    first = gray8(movie.frames[0])
    points = cv2.goodFeaturesToTrack(first, LK_POINTS, 1e-4, 3, mask=masks.tissue.astype(np.uint8))

    def lucas_kanade(movie) -> None:
        for t in range(movie.count):
            cv2.calcOpticalFlowPyrLK(first, gray8(movie.frames[t]), points, None, winSize=(17, 17), maxLevel=3)

    work = {"registration": lambda movie: register(movie, masks, markers, config, lambda _: None),
            f"OpenCV Lucas-Kanade, {len(points)} points": lucas_kanade,
            "of both: reading": lambda movie: [movie.frames[t] for t in range(movie.count)]}
    best: dict[str, float] = {}
    for _ in range(5):
        for name, run in work.items():
            fresh = read_movie(folder, fps=30, um_per_px=4)
            before = cpu_s()
            run(fresh)
            best[name] = min((cpu_s() - before) / movie.count * 1000, best.get(name, float("inf")))
    return best


def start_up() -> dict[str, float]:
    """CPU seconds of `import microbundle` and `microbundle --help`, the best of five, with compiled bytecode."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    commands = {"import microbundle": ["-c", "import microbundle"],
                "microbundle --help": ["-m", "microbundle", "--help"],
                "microbundle analyze --help": ["-m", "microbundle", "analyze", "--help"]}
    out = {}
    for name, command in commands.items():
        spent = []
        for _ in range(5):
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run([sys.executable, *command], env=environment, check=True, capture_output=True)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            spent.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
        out[name] = min(spent)
    return out


def memory(folder: Path, frames: int) -> dict[str, float]:
    """Peak resident MB and CPU seconds of analyzing a movie that repeats the folder's frames."""
    files = sorted((folder / "movie").iterdir())
    with tempfile.TemporaryDirectory() as made:
        home = Path(made) / "movie"
        home.mkdir()
        for i in range(frames):
            (home / f"{i:05d}.tif").symlink_to(files[i % len(files)].resolve())
        masks = Path(made) / "masks"
        masks.symlink_to((folder / "masks").resolve())
        code = ("import sys, json, resource, microbundle as m\n"
                "movie = m.read_movie(sys.argv[1], fps=30, um_per_px=4)\n"
                "m.save(m.analyze(movie), sys.argv[1] + '/out')\n"
                "u = resource.getrusage(resource.RUSAGE_SELF)\n"
                "print(json.dumps({'mb': u.ru_maxrss / 1024, 'cpu_s': u.ru_utime + u.ru_stime}))")
        done = subprocess.run([sys.executable, "-c", code, made], check=True, capture_output=True, text=True)
    return json.loads(done.stdout)


def main() -> None:
    folder = Path(os.environ["MICROBUNDLE_DATA"]) / "type1_bright"
    # Memory first: a child's peak counts from its parent's.
    print("| frames | peak memory, MB | CPU s, with saving |\n|---|---|---|")
    for frames in (100, 300, 1000):
        used = memory(folder, frames)
        print(f"| {frames} | {used['mb']:.0f} | {used['cpu_s']:.1f} |")

    print()
    print("| stage, 100 frames | published tool, CPU s | accurate | fast |\n|---|---|---|---|")
    accurate, fast = stages(folder, "accurate"), stages(folder, "fast")
    for name, published in PUBLISHED_CPU_S.items():
        print(f"| {name} | {published:.2f} | {accurate[name]:.2f} | {fast[name]:.2f} |")
    total = sum(PUBLISHED_CPU_S.values())
    shares = [f"{sum(s.values()):.2f} (1/{total / sum(s.values()):.1f})" for s in (accurate, fast)]
    print(f"| all | {total:.2f} | {shares[0]} | {shares[1]} |\n")
    print("| following, each frame | CPU ms |\n|---|---|")
    for name, value in beside_lucas_kanade(folder).items():
        print(f"| {name} | {value:.1f} |")
    print("\n| start | CPU s |\n|---|---|")
    for name, value in start_up().items():
        print(f"| `{name}` | {value:.2f} |")


if __name__ == "__main__":
    started = time.time()
    main()
    print(f"\n{time.time() - started:.0f} s", file=sys.stderr)
