"""Shared by all tests: a small beating tissue, and the folders with real movies and the published tool's numbers.

The tissue is drawn with numpy and scipy alone, in less than a second: a dark textured bundle on bright ground,
128 x 192 px, 16 bits, 75 frames at 30 frames/s and 4 um/px. It rests at frame 0 and beats every 24 frames (peaks near
frames 10, 34 and 58): it shortens towards its middle, by 2 px at the ends of the bundle.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from scipy import ndimage

from microbundle.analysis import Analysis
from microbundle.config import Config
from microbundle.data import Movie
from microbundle.pipeline import analyze

Image = NDArray[Any]

SHAPE = (128, 192)
FRAMES = 75
PERIOD_FRAMES = 24
PEAK_PX = 2.0
FPS = 30.0
UM_PER_PX = 4.0


def _folder_of(variable: str) -> Path:
    folder = os.environ.get(variable)
    if not folder:
        pytest.skip(f"{variable} does not name a folder")
    return Path(folder)


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Folder of real movies; the test is skipped where MICROBUNDLE_DATA is not set."""
    return _folder_of("MICROBUNDLE_DATA")


@pytest.fixture(scope="session")
def golden_folder() -> Path:
    """Folder of the published tool's arrays; the test is skipped where MICROBUNDLE_GOLDEN is not set."""
    return _folder_of("MICROBUNDLE_GOLDEN")


@pytest.fixture(scope="session")
def tissue_array() -> Image:
    """Frames (T, R, C) of the small beating tissue, uint16, read-only."""
    rng = np.random.default_rng(7)
    row, col = np.mgrid[:SHAPE[0], :SHAPE[1]].astype(float)
    middle, half = np.array(SHAPE) / 2 - 0.5, (28.0, 80.0)
    along, across = (col - middle[1]) / half[1], (row - middle[0]) / half[0]
    bundle = 1 / (1 + np.exp(10 * (np.maximum(np.abs(along), np.abs(across) - 0.2 * along**2) - 1)))
    grain = ndimage.gaussian_filter(rng.normal(size=SHAPE), 1.5)
    relaxed = ndimage.spline_filter(45000 - bundle * (25000 - 6000 * grain / grain.std()))
    frames = np.empty((FRAMES, *SHAPE), np.uint16)
    for t, strength in enumerate(contraction()):
        inward = -PEAK_PX * strength * np.clip(along, -1, 1)
        seen = ndimage.map_coordinates(relaxed, [row, col - inward], mode="nearest", prefilter=False)
        frames[t] = np.clip(seen + rng.normal(0, 250, SHAPE), 0, 65535)
    frames.setflags(write=False)
    return frames


def write_frames(frames: Image, folder: Path) -> Path:
    """Write a movie as a new folder of single frames, 0.tif, 1.tif, ..."""
    folder.mkdir()
    for t, frame in enumerate(frames):
        tifffile.imwrite(folder / f"{t}.tif", frame)
    return folder


@pytest.fixture(scope="session")
def small(tissue_array: Image) -> Image:
    """One beat and a half of the small tissue, of which a result takes little time."""
    return tissue_array[:40, 20:108]


def contraction() -> NDArray[np.float64]:
    """How far the small tissue is contracted in each frame (T,), 0 to 1."""
    since = (np.arange(FRAMES) - 4) % PERIOD_FRAMES
    beat = np.where(since < 12, np.sin(np.pi * since / 12) ** 2, 0.0)
    return np.where(np.arange(FRAMES) < 4, 0.0, beat)


@pytest.fixture
def tissue_movie(tissue_array: Image) -> Movie:
    """The small beating tissue as a Movie in memory, calibrated, without a supplied mask."""
    return Movie.from_array(tissue_array, fps=FPS, um_per_px=UM_PER_PX, name="tissue")


@pytest.fixture
def tissue_folder(tissue_array: Image, tmp_path: Path) -> Path:
    """The small beating tissue as a folder `tissue` of single-frame TIFFs, without any calibration."""
    return write_frames(tissue_array, tmp_path / "tissue")


@pytest.fixture(scope="session")
def tissue_analysis(tissue_array: Image) -> Analysis:
    """The small beating tissue analyzed once with default settings, but sub-domains of 20 px (there are several)."""
    movie = Movie.from_array(tissue_array, fps=FPS, um_per_px=UM_PER_PX, name="tissue")
    return analyze(movie, Config.from_dict({"strain": {"tile_px": 20}}))
