"""A small plate of good movies and of one of each fault."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from ..conftest import write_frames

Image = NDArray[Any]


@pytest.fixture(scope="module")
def plate(small: Image, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two good movies of two kinds, and one of each fault."""
    folder = tmp_path_factory.mktemp("batch") / "plate1"
    folder.mkdir()
    tifffile.imwrite(folder / "A1.tif", small)
    write_frames(small, folder / "A2")
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
