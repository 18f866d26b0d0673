"""True motion of a three-dimensional microbundle: an active, nearly incompressible body bonded to elastic pillars.

After S1 Appendix of the paper: quadratic displacement and linear pressure (Taylor-Hood) on tetrahedra, active strain
along fibres whose angle varies along the tissue or through its depth, an optional passive inclusion, compressible
pillars clamped at their bases. Our own: the extruded mesh (mesh.py), the symmetric form (material.py), few solves
and splines between them (equilibrium.py, surface.py).

    bundle = Bundle.from_mask(mask, um_per_px=4.0)
    solution = solve_tissue(bundle, resolution="coarse")
    motion = solution.motion(clipped_cosine(200, seed=1), um_per_px=4.0)
    motion.displacement_px(points_px, frame=12)
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Literal

import numpy as np

from ..data import Bools, Floats, Ints
from ..errors import ConfigError
from .activation import Fibres, PassiveCore
from .elements import Quadratic, nodal_strain, quadratic
from .equilibrium import Block, Body, Levels, solve_levels
from .material import Law, PillarLaw, TissueLaw, active_tensor
from .mesh import TISSUE, SolidMesh, extrude, triangulate
from .outline import Bundle
from .solution import TissueSolution
from .surface import with_middles

Resolution = Literal["coarse", "medium", "fine"]

Structure = Callable[[Floats], Callable[[float], Floats]]
"""From quadrature points (m, q, d) to the active tensor (m, q, ...) as a function of the activation."""

LEVELS = (-0.01, 0.0, 0.02, 0.04, 0.06, 0.08, 0.1)
"""Activations that are solved: they hold the published series, its noise included."""

RESOLUTIONS: dict[str, tuple[float, int]] = {"coarse": (150.0, 2), "medium": (110.0, 3), "fine": (75.0, 4)}
"""Spacing of the triangles in um for a bundle 2 mm long (others in proportion), and layers through the tissue."""

REFERENCE_LENGTH_UM = 2000.0


def solve_tissue(bundle: Bundle, *, fibres: Fibres = Fibres(), inclusion: PassiveCore | None = None,  # noqa: B008
                 law: TissueLaw = TissueLaw(), resolution: Resolution = "medium",  # noqa: B008
                 levels: Sequence[float] | Floats = LEVELS,
                 tell: Callable[[str], None] | None = None) -> TissueSolution:
    """Solve a microbundle in three dimensions at a few activations.

    Takes some seconds (coarse) to minutes (fine) of processor time; for a movie in seconds use `solve_membrane`.
    Raises ConfigError for a geometry without a good mesh, and CannotMeasure where no equilibrium is found.
    """
    start = time.process_time()
    if resolution not in RESOLUTIONS:
        raise ConfigError(f"resolution: expected one of {', '.join(RESOLUTIONS)}, found {resolution!r}")
    if not bundle.pillars:
        raise ConfigError("tissue: a tissue without pillars is held by nothing; give it at least one.")
    spacing, layers = RESOLUTIONS[resolution]
    spacing *= float(np.ptp(bundle.outline_um, axis=0).max()) / REFERENCE_LENGTH_UM
    mesh = bundle_mesh(bundle, spacing, layers)
    of_tissue = mesh.point_um[np.unique(mesh.cell[mesh.region == TISSUE])]
    low, high = of_tissue.min(axis=0), of_tissue.max(axis=0)

    def active(at: Floats) -> Callable[[float], Floats]:
        f = fibres.direction(at, low, high)
        share: Floats = np.ones(at.shape[:-1])
        if inclusion is not None:
            share = 1.0 - inclusion.passive(at, (low + high) / 2)
        return lambda g: active_tensor(f, g * share)

    parts: list[tuple[int, Law, Structure]] = [(TISSUE, law, active)]
    parts += [(k, PillarLaw(p.young_mpa, p.poisson), passive) for k, p in enumerate(bundle.pillars, start=1)]
    cells, body = solid_body(mesh, parts)
    bases = [base_nodes(mesh, cells, k) for k in range(1, len(bundle.pillars) + 1)]
    body.fixed[np.any(bases, axis=0)] = True
    solved = solve_levels(body, levels, tell=tell)

    node = cells.node_um
    top = with_middles(node, mesh.top)
    on_top = np.unique(top[mesh.top_region == TISSUE])
    touching = np.flatnonzero((mesh.region == TISSUE) & np.isin(cells.cell, on_top).any(axis=1))
    return TissueSolution(
        node_um=node, cell=cells.cell, region=mesh.region, top=top, top_region=mesh.top_region,
        activation=solved.activation, displacement_um=solved.displacement_um, strain_node=on_top,
        strain=nodal_strain(mesh.point_um, mesh.cell, touching, on_top, solved.displacement_um),
        pillars=bundle.pillars, **_pillar_answers(bundle, node, top, mesh.top_region, bases, solved),
        log=solved.log, spacing_um=spacing,
        facts={"kind": "tissue", "resolution": resolution, "layers": layers, "thickness_um": bundle.thickness_um,
               "fibres": asdict(fibres), "inclusion": None if inclusion is None else asdict(inclusion),
               "law": asdict(law), "seconds": time.process_time() - start})


def bundle_mesh(bundle: Bundle, spacing_um: float, layers: int) -> SolidMesh:
    """Make the tetrahedra of a bundle: `layers` through the tissue, and shaft layers of about 1.3 times the spacing."""
    depth = np.linspace(0.0, bundle.thickness_um, layers + 1)
    shafts = [bundle.thickness_um + np.linspace(0.0, p.shaft_um, max(2, round(p.shaft_um / (1.3 * spacing_um))) + 1)
              for p in bundle.pillars]
    return extrude(triangulate(bundle, spacing_um), depth, shafts)


def solid_body(mesh: SolidMesh, parts: Sequence[tuple[int, Law, Structure]]) -> tuple[Quadratic, Body]:
    """Prepare a mesh for the solver: P2 cells, and a body of its `parts` (region, law, structure), nothing fixed yet.

    The pressure lives on the vertices of tissue cells only: pillars are compressible and have none.
    """
    cells = quadratic(mesh.point_um, mesh.cell)
    blocks, pressures = [], 0
    for region, law, structure in parts:
        mine = np.flatnonzero(mesh.region == region)
        pressure = None
        if isinstance(law, TissueLaw):
            vertex, number = np.unique(mesh.cell[mine], return_inverse=True)
            pressure = pressures + number.reshape(-1, 4)
            pressures += len(vertex)
        blocks.append(Block(law, cells.cell[mine], cells.gradient[mine], cells.dx[mine], structure(cells.at_um[mine]),
                            pressure, None if pressure is None else cells.linear))
    count = len(cells.node_um)
    return cells, Body(tuple(blocks), count, pressures, 3, np.zeros((count, 3), bool))


def passive(at: Floats) -> Callable[[float], Floats]:
    """The structure of a material that never contracts: A = I."""
    identity = np.broadcast_to(np.eye(3), (*at.shape, 3))
    return lambda _: identity


def base_nodes(mesh: SolidMesh, cells: Quadratic, region: int) -> Bools:
    """Mark the nodes (n,) on the lowest face of a pillar."""
    mine = np.unique(cells.cell[mesh.region == region])
    depth = cells.node_um[mine, 2]
    marked = np.zeros(len(cells.node_um), bool)
    marked[mine[depth > depth.max() * (1 - 1e-9)]] = True
    return marked


def _pillar_answers(bundle: Bundle, node: Floats, top: Ints, top_region: Ints, bases: list[Bools],
                    solved: Levels) -> dict[str, Floats]:
    """Head displacement, force and moment (K, P, 2) of each pillar; the base carries the force without moving."""
    shape = (len(solved.activation), len(bundle.pillars), 2)
    head, force, moment = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for k, (pillar, base) in enumerate(zip(bundle.pillars, bases, strict=True)):
        face = top[top_region == k + 1]
        corner = node[face[:, :3], :2]
        area = np.abs(np.linalg.det(corner[:, 1:] - corner[:, :1]))
        # the mean of a P2 field over a straight triangle is the mean of its values at the middles of the sides
        u = solved.displacement_um[:, face[:, 3:], :2].mean(axis=2)
        head[:, k] = (u * area[:, None]).sum(axis=1) / area.sum()
        reaction = solved.force_un[:, base]
        force[:, k] = -reaction[..., :2].sum(axis=1)
        # depth grows downward: a pull towards +row at some height presses the base down on its +row side,
        # and the support answers with a negative (upward) force there
        lever = node[base, :2] - np.asarray(pillar.center_um)
        moment[:, k] = np.einsum("kn,nj->kj", -reaction[..., 2], lever)
    return {"head_um": head, "force_un": force, "moment_un_um": moment}
