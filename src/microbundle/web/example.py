"""The example plate, rendered once into the workspace."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path


def render(folder: Path, wells: int, tell: Callable[[float], None]) -> None:
    """Render a plate of small movies with a manifest `plate.csv`, unless it is there already. Raises OutputError."""
    import tifffile

    from ..folder import write_whole
    from ..synth.render import beating_tissue

    if (folder / "plate.csv").is_file():
        return

    def write(into: Path) -> None:
        rows = ["movie,fps,um_per_px,plate,well,group"]
        for i in range(wells):
            well = f"{chr(65 + i // 6)}{1 + i % 6}"
            synthetic = beating_tissue((128, 192), 60, seed=i)
            tifffile.imwrite(into / f"{well}.tif", synthetic.array())
            rows.append(f"{well}.tif,30,4,example,{well},{'drug' if i % 2 else 'control'}")
            tell((i + 1) / wells)
        (into / "plate.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")

    write_whole(folder, "plate", write, overwrite=True)
