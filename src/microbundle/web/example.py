"""The example plate, rendered once into the workspace."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path


def render(folder: Path, wells: int, tell: Callable[[float], None]) -> None:
    """Render a plate with a manifest `plate.csv`, unless it is there already. Raises OutputError."""
    from ..synth.plate import MANIFEST, render_plate

    if not (folder / MANIFEST).is_file():
        render_plate(folder, wells, tell=lambda progress: tell(progress.share))
