"""Damaged files of every format that can be written here: a movie or one of our errors, nothing else, and soon.

Small valid files are changed at random, as bad disks, broken transfers and ill-willed people do. The time is shared out
over the formats: 30 s in all and at most 300 files each, or as long as MICROBUNDLE_FUZZ_S says.
"""

from __future__ import annotations

import os
import resource
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile

from microbundle.errors import MicrobundleError
from microbundle.read import read_movie

from .instrument_files import write_czi, write_lif, write_micromanager, write_nd2, write_video
from .test_formats import TIMES, grey, needs_czi, smooth

BUDGET_S = float(os.environ.get("MICROBUNDLE_FUZZ_S", "30"))
MOST_FILES = 300 if "MICROBUNDLE_FUZZ_S" not in os.environ else sys.maxsize
"""The same files in every run, unless more time was asked for."""
MOST_S = 20.0
"""No single file may take longer."""
MOST_KB = 1_500_000
"""Nor may memory grow by more than this."""
EXTREMES = (b"\0\0\0\0", b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\0\x80", b"\1\0\0\0", b"\0\0\1\0", b"\0\0\0\1")


def _tiff(file: Path, **options: object) -> Path:
    tifffile.imwrite(file, grey(), **options)  # type: ignore[arg-type]
    return file


def _pages(file: Path) -> Path:
    with tifffile.TiffWriter(file, bigtiff=True) as out:
        for frame in grey():
            out.write(frame, contiguous=False, metadata=None, compression="zlib")
    return file


SEEDS: dict[str, Callable[[Path], Path]] = {
    "plain TIFF": lambda d: _tiff(d / "m.tif", metadata=None),
    "paged BigTIFF, deflate": lambda d: _pages(d / "m.tif"),
    "OME-TIFF": lambda d: _tiff(d / "m.ome.tif", ome=True, metadata={"axes": "TYX", "PhysicalSizeX": 1.0}),
    "ImageJ TIFF": lambda d: _tiff(d / "m.tif", imagej=True, metadata={"axes": "TYX", "finterval": 0.1}),
    "Micro-Manager list": lambda d: write_micromanager(d / "Pos0", grey()[:, None], times_s=TIMES) / "metadata.txt",
    "ND2": lambda d: write_nd2(d / "m.nd2", grey()),
    "CZI": lambda d: write_czi(d / "m.czi", grey()),
    "LIF": lambda d: write_lif(d / "m.lif", {"a": grey()}, times_s=TIMES),
    "AVI, raw": lambda d: write_video(d / "m.avi", grey("uint8"), "rawvideo"),
    "AVI, MJPEG": lambda d: write_video(d / "m.avi", smooth(8), "mjpeg", "yuvj420p"),
    "MP4, H.264": lambda d: write_video(d / "m.mp4", smooth(12), "libx264", "yuv420p", g="4"),
    "MOV, PNG": lambda d: write_video(d / "m.mov", grey("uint8"), "png"),
    "MKV, FFV1": lambda d: write_video(d / "m.mkv", grey("uint8"), "ffv1"),
}


def damaged(whole: bytes, rng: np.random.Generator) -> bytes:
    """Change a file in one to four places, more often near its start and end, where headers are."""
    raw = bytearray(whole)
    for _ in range(int(rng.integers(1, 5))):
        size = max(8, len(raw))
        near = int(rng.integers(0, min(size, 600)))
        place = int(rng.choice([near, max(0, size - 1 - near), int(rng.integers(0, size))]))
        match int(rng.integers(0, 7)):
            case 0:
                del raw[place:]
            case 1:
                del raw[place:place + int(rng.integers(1, 64))]
            case 2:
                raw[place:place] = rng.bytes(int(rng.integers(1, 64)))
            case 3:
                raw[place:place + 4] = EXTREMES[int(rng.integers(0, len(EXTREMES)))]
            case 4:
                raw[place:place + 64] = bytes(64)
            case 5:
                other = int(rng.integers(0, size))
                raw[place:place + 32] = raw[other:other + 32]
            case _:
                for _ in range(int(rng.integers(1, 9))):
                    if raw:
                        raw[int(rng.integers(0, len(raw)))] = int(rng.integers(0, 256))
    return bytes(raw)


@pytest.mark.parametrize("kind", SEEDS)
def test_damaged_files_give_a_movie_or_one_of_our_errors(tmp_path: Path, kind: str,
                                                         capsys: pytest.CaptureFixture[str]) -> None:
    if kind in ("ND2", "LIF"):
        pytest.importorskip({"ND2": "nd2", "LIF": "liffile"}[kind])
    if kind == "CZI":
        needs_czi()
    file = SEEDS[kind](tmp_path)
    whole, movie = file.read_bytes(), file.parent if file.suffix == ".txt" else file
    rng = np.random.default_rng(int(os.environ.get("MICROBUNDLE_FUZZ_SEED", "0")))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    tried = refused = longest = 0
    slowest = 0.0
    start = time.monotonic()
    while (now := time.monotonic()) - start < BUDGET_S / len(SEEDS) and tried < MOST_FILES:
        raw = damaged(whole, rng)
        file.write_bytes(raw)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found = read_movie(movie)
                for t in {0, found.count // 2, found.count - 1}:
                    found.frames[t]
        except MicrobundleError as error:
            refused += 1
            longest = max(longest, len(str(error)))
        except BaseException:
            (kept := Path(tmp_path / "offender")).write_bytes(raw)
            with capsys.disabled():
                print(f"\n{kind}: {kept} makes something else than a MicrobundleError")
            raise
        tried += 1
        slowest = max(slowest, time.monotonic() - now)
        assert slowest < MOST_S
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    with capsys.disabled():
        print(f"\n{kind}: {tried} damaged files, {refused} refused, slowest {slowest:.2f} s", end="")
    assert tried > 5
    assert longest < 3000
    assert sys.platform == "darwin" or grown < MOST_KB
