"""Time and memory of figures and movies on a real movie: the table "Pictures" of docs/gallery.md.

    MICROBUNDLE_DATA=FOLDER python benchmarks/pictures.py

Each row is a process of its own: CPU seconds are user + system time of all threads without importing microbundle, but
with what a first picture imports; memory is its peak resident size. Movies longer than the recording repeat its frames.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

COMMON = """
import json, resource, sys
from pathlib import Path
import microbundle as m
from microbundle.pipeline import analyze
from microbundle.config import Config

def cpu():
    u = resource.getrusage(resource.RUSAGE_SELF)
    return u.ru_utime + u.ru_stime

folder, out = Path(sys.argv[1]), Path(sys.argv[2])
"""
DONE = """
print(json.dumps({"cpu_s": cpu() - before, "mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}))
"""
ANALYZE = COMMON + """
analyze(m.read_movie(folder, fps=30, um_per_px=4))  # compiles
before = cpu()
m.save(analyze(m.read_movie(folder, fps=30, um_per_px=4)), out / "result")
""" + DONE
PREPARE = COMMON + """
config = Config.from_dict({"pillars": {"stiffness_un_per_um": 2.677}})
m.save(analyze(m.read_movie(folder, fps=30, um_per_px=4), config), out)
"""
FIGURES = COMMON + """
from microbundle.figures import save_all
analysis = m.load(out / "result")
before = cpu()
save_all(analysis, out / "figures", formats=sys.argv[3].split(","))
""" + DONE
MOVIES = COMMON + """
from microbundle.movies import write_movie
analysis, movie = m.load(out / "result"), m.read_movie(folder, fps=30, um_per_px=4)
before = cpu()
for show in sys.argv[3].split(","):
    write_movie(movie, analysis, out / f"{show}{sys.argv[4]}", show=show)
""" + DONE


def run(code: str, *arguments: object) -> dict[str, float]:
    """Run code in a process of its own; gives what it prints last."""
    done = subprocess.run([sys.executable, "-c", code, *map(str, arguments)], check=True, capture_output=True,
                          text=True)
    return json.loads(done.stdout or "{}")


def repeated(folder: Path, frames: int, home: Path) -> Path:
    """A movie that repeats the folder's frames."""
    files = sorted((folder / "movie").iterdir())
    made = home / f"frames_{frames}"
    (made / "movie").mkdir(parents=True)
    for i in range(frames):
        (made / "movie" / f"{i:05d}.tif").symlink_to(files[i % len(files)].resolve())
    (made / "masks").symlink_to((folder / "masks").resolve())
    return made


def main() -> None:
    folder = Path(os.environ["MICROBUNDLE_DATA"]) / "type1_bright"
    print("| what | frames | CPU s | peak memory, MB |\n|---|---|---|---|")

    def row(what: str, frames: int, used: dict[str, float]) -> None:
        print(f"| {what} | {frames} | {used['cpu_s']:.1f} | {used['mb']:.0f} |", flush=True)

    with tempfile.TemporaryDirectory() as made:
        home = Path(made)
        movies = {n: repeated(folder, n, home) for n in (100, 200, 400)}
        out = {n: home / f"out_{n}" for n in movies}
        row("analysis, with saving", 100, run(ANALYZE, movies[100], home / "analysis"))
        for n, movie in movies.items():
            run(PREPARE, movie, out[n] / "result")
        row("all figures, PNG", 100, run(FIGURES, movies[100], out[100], "png"))
        row("all figures, PNG and PDF", 100, run(FIGURES, movies[100], out[100], "png,pdf"))
        for n, movie in movies.items():
            row("both movies, MP4", n, run(MOVIES, movie, out[n], "displacement,strain", ".mp4"))
        row("both movies, GIF", 200, run(MOVIES, movies[200], out[200], "displacement,strain", ".gif"))


if __name__ == "__main__":
    main()
