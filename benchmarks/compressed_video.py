"""What lossy video costs: the error of the displacement on a movie with known motion, by codec and quality.

    python benchmarks/compressed_video.py [--seeds 3]

A rendered tissue (256 x 256 px, 75 frames, noise of a good camera) is written as a video by PyAV, read back by
`read_movie`, and analyzed with default settings. Error: root mean square over tissue points and frames, in px.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

import microbundle
from microbundle.data import Image
from microbundle.demo import compare
from microbundle.errors import MicrobundleError
from microbundle.synth.render import beating_tissue

KINDS: tuple[tuple[str, str, str, dict[str, str]], ...] = (
    ("8 bits, no compression", "rawvideo", "avi", {}),
    ("H.264, crf 18", "libx264", "mp4", {"crf": "18"}),
    ("H.264, crf 23 (default)", "libx264", "mp4", {"crf": "23"}),
    ("H.264, crf 28", "libx264", "mp4", {"crf": "28"}),
    ("H.264, crf 35", "libx264", "mp4", {"crf": "35"}),
    ("MPEG-4, 1 Mbit/s", "mpeg4", "mp4", {"b": "1000000"}),
    ("MJPEG, q 5", "mjpeg", "avi", {"qmin": "5", "qmax": "5"}),
)


def write_video(file: Path, frames: Image, codec: str, options: dict[str, str], fps: int = 30) -> None:
    """Write grey frames (T, R, C) of 8 bits as a video."""
    with av.open(str(file), "w") as out:
        stream = out.add_stream(codec, rate=fps)
        stream.height, stream.width = frames.shape[1:]
        stream.pix_fmt = {"rawvideo": "gray", "mjpeg": "yuvj420p"}.get(codec, "yuv420p")
        stream.time_base = Fraction(1, fps)
        if "b" in options:
            stream.bit_rate = int(options["b"])
        stream.options = {k: v for k, v in options.items() if k != "b"}
        for t, frame in enumerate(frames):
            picture = av.VideoFrame.from_ndarray(frame, format="gray").reformat(
                format=stream.pix_fmt, src_color_range="JPEG", dst_color_range="JPEG")
            picture.pts, picture.time_base = t, Fraction(1, fps)
            out.mux(stream.encode(picture))
        out.mux(stream.encode())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    seeds = parser.parse_args().seeds
    print("| video | " + " | ".join(f"{px} px: RMS error, peak" for px in (2.0, 0.4)) + " |\n|---|---|---|")
    rows: dict[str, list[str]] = {name: [] for name in ("16 bits, as rendered", *(kind[0] for kind in KINDS))}
    with tempfile.TemporaryDirectory() as folder:
        for peak_px in (2.0, 0.4):
            found: dict[str, list[tuple[float, float]]] = {name: [] for name in rows}
            for seed in range(seeds):
                synthetic = beating_tissue(frames=75, peak_px=peak_px, seed=seed)
                frames = synthetic.array()
                mask = synthetic.truth.mask
                eight = np.rint(frames / frames.max() * 255).astype(np.uint8)
                movies = {"16 bits, as rendered": replace(synthetic.movie, frames=frames)}
                for name, codec, ending, options in KINDS:
                    file = Path(folder) / f"{codec}{peak_px}{seed}{'-'.join(options.values())}.{ending}"
                    write_video(file, eight, codec, options)
                    movies[name] = microbundle.read_movie(file, um_per_px=4)
                for name, movie in movies.items():
                    movie = replace(movie, supplied_masks={"tissue": mask})
                    try:
                        shown = compare(synthetic, microbundle.analyze(movie))
                        found[name].append((shown.rmse_px, shown.compared[0].error))
                    except (MicrobundleError, ValueError, IndexError) as error:
                        print(f"{name}, {peak_px} px, seed {seed}: {error}")
            for name, values in found.items():
                rms, peak = np.array(values).T if values else np.full((2, 1), np.nan)
                rows[name].append(f"{rms.mean():.4f}, {100 * peak.mean():+.1f} %")
    for name, cells in rows.items():
        print(f"| {name} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
