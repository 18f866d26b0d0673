"""What the tissue's mechanics gives: mesh, displacement and strain at a few activations, pillar forces, solver facts.

One class for the 3-D tissue (d = 3, coordinates row, col, depth) and the 2-D membrane (d = 2). It is saved as one
.npz file without pickles.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..data import Floats, Ints
from ..errors import OutputError, ResultUnreadable
from .equilibrium import SolverLog
from .outline import Pillar
from .surface import SmoothSurface, SurfaceMotion, fit_surface

FORMAT = "microbundle tissue 1"


@dataclass(frozen=True)
class TissueSolution:
    """Equilibrium of a microbundle at K activations; n nodes, P pillars, d directions."""

    node_um: Floats
    """(n, d): P2 nodes at rest (row, col[, depth])."""
    cell: Ints
    """(m, 10) tetrahedra or (m, 6) triangles: corners, then the middles of their edges."""
    region: Ints
    """(m,): 0 tissue, k the k-th pillar."""
    top: Ints
    """(S, 6): P2 triangles of the upper surface: corners, then the middles of sides 01, 12, 20."""
    top_region: Ints
    """(S,)"""
    activation: Floats
    """(K,), increasing, with 0 in it."""
    displacement_um: Floats
    """(K, n, d) from the unloaded state."""
    strain_node: Ints
    """(t,): nodes of the tissue's upper surface."""
    strain: Floats
    """(K, t, d, d): Green-Lagrange strain there, mean of the cells that meet in the node."""
    pillars: tuple[Pillar, ...]
    head_um: Floats
    """(K, P, 2): displacement of the pillars' heads, mean over the upper face."""
    force_un: Floats
    """(K, P, 2): force of the tissue on each pillar, from the reaction at its base."""
    moment_un_um: Floats
    """(K, P, 2): moment of that force about the middle of the base, so that height x force = moment; NaN in 2-D."""
    log: SolverLog
    spacing_um: float
    """Size of the mesh's triangles."""
    facts: Mapping[str, Any] = field(default_factory=dict)
    """Everything else that was asked for: geometry, fibres, inclusion, materials, resolution."""

    @property
    def worst_J(self) -> float:
        """The J furthest from 1 at any quadrature point of the tissue, over all activations (NaN in 2-D)."""
        J = self.log.worst_J
        return float(J[np.abs(J - 1).argmax()])

    @property
    def mean_J_error(self) -> float:
        """Largest change of the tissue's volume over all activations, as a share (NaN in 2-D)."""
        return float(np.abs(self.log.mean_J - 1).max())

    @cached_property
    def surface(self) -> SmoothSurface:
        """The upper surface's motion as a smooth field, on a grid of half the mesh's spacing."""
        return fit_surface(self.node_um[:, :2], self.top, self.displacement_um, self.spacing_um / 2)

    def motion(self, activation: Floats, um_per_px: float,
               origin_px: tuple[float, float] = (0.0, 0.0)) -> SurfaceMotion:
        """Make the true motion of a movie with the activation (T,) in each frame.

        `origin_px` is the pixel (row, col) where the tissue's coordinates are 0; leave it for a tissue made from a
        mask of the same picture. Raises CannotMeasure where an activation lies outside the solved ones.
        """
        if um_per_px <= 0:
            raise ValueError(f"um_per_px: expected a positive number, found {um_per_px}")
        return SurfaceMotion(self.surface, self.activation, np.asarray(activation, float), um_per_px, origin_px)

    def save(self, path: Path | str) -> Path:
        """Write everything to one .npz file, whole or not at all; raises OutputError where that is not possible."""
        path = Path(path).with_suffix(".npz")
        plain = [f.name for f in fields(self) if f.name not in ("pillars", "log", "facts")]
        arrays: dict[str, Any] = {name: getattr(self, name) for name in plain}
        log = {f"log_{f.name}": getattr(self.log, f.name) for f in fields(self.log)}
        words = {"format": FORMAT, "pillars": json.dumps([asdict(p) for p in self.pillars]),
                 "facts": json.dumps(dict(self.facts))}
        part = path.with_suffix(".part")
        try:
            with part.open("wb") as file:
                np.savez_compressed(file, **{**arrays, **log, **words})
            os.replace(part, path)
        except OSError as error:
            part.unlink(missing_ok=True)
            raise OutputError(f"{path}: cannot be written ({error})") from error
        return path

    @classmethod
    def load(cls, path: Path | str) -> TissueSolution:
        """Read a file that `save` wrote; raises ResultUnreadable for anything else."""
        path = Path(path)
        try:
            with np.load(path, allow_pickle=False) as file:
                found = {name: file[name] for name in file.files}
            if str(found.get("format")) != FORMAT:
                raise ResultUnreadable(f"{path.name}: expected a file of format {FORMAT!r}, "
                                       f"found {found.get('format', 'none')!s}")
            log = SolverLog(**{f.name: found[f"log_{f.name}"] for f in fields(SolverLog) if f.name != "unknowns"},
                            unknowns=int(found["log_unknowns"]))
            pillars = tuple(
                Pillar(**{**p, "center_um": tuple(p["center_um"]), "size_um": tuple(p["size_um"])})
                for p in json.loads(str(found["pillars"])))
            plain = {f.name: found[f.name] for f in fields(cls) if f.name not in ("pillars", "log", "facts")}
            plain["spacing_um"] = float(found["spacing_um"])
            return cls(**plain, pillars=pillars, log=log, facts=json.loads(str(found["facts"])))
        except (OSError, ValueError, KeyError, TypeError, EOFError) as error:
            raise ResultUnreadable(f"{path.name}: not a tissue solution, or damaged ({error})") from error
