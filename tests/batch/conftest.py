"""A small plate of good movies and of one of each fault."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

Image = NDArray[Any]


@pytest.fixture(scope="module")
def small(tissue_array: Image) -> Image:
    """One beat and a half of the small tissue, of which a result takes little time."""
    return tissue_array[:40, 20:108]


@pytest.fixture(scope="module")
def plate(small: Image, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two good movies of two kinds, and one of each fault."""
    folder = tmp_path_factory.mktemp("batch") / "plate1"
    folder.mkdir()
    tifffile.imwrite(folder / "A1.tif", small)
    frames = folder / "A2"
    frames.mkdir()
    for t, frame in enumerate(small):
        tifffile.imwrite(frames / f"{t}.tif", frame)
    (folder / "B1.tif").touch()
    masked = folder / "B2"
    (masked / "movie").mkdir(parents=True)
    (masked / "masks").mkdir()
    tifffile.imwrite(masked / "movie" / "all.tif", small)
    np.savetxt(masked / "masks" / "tissue_mask.txt", np.ones((10, 10)), fmt="%d")
    rng = np.random.default_rng(1)
    tifffile.imwrite(folder / "C1.tif", np.clip(small[:1] + rng.normal(0, 250, small.shape), 0, 65535).astype("u2"))
    (folder / "C2.tif").write_bytes((folder / "A1.tif").read_bytes()[:50_000])
    return folder
