"""True motion of a thin tissue on soft posts: an active sheet in plane stress, solved in a second or less.

Two uses. A fibrous sheet between plate-like posts after the paper's Type 2 (FibroTUG): strongly aligned fibres, soft
posts; the sheet is thin, so plane stress is its physics. And a demo of a thick Type 1 bundle in seconds: the truth is
then exact for its own field, but it is not three-dimensional physics (no bending, nothing varies through the depth).

A post is an elastic bed of stiffness k over its cross-section, with the area much stiffer than the tissue:
force = k x mean displacement, by pillar beam theory in each direction. The sheet is an incompressible neo-Hookean, so
its thickness follows the area (material.SheetLaw), and there is no pressure to solve for.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Literal

import numpy as np
from scipy import sparse

from ..data import Floats, Ints
from ..errors import ConfigError
from .activation import Fibres, PassiveCore
from .elements import Quadratic, nodal_strain, quadratic
from .equilibrium import Block, Body, solve_levels
from .material import SheetLaw, sheet_structure
from .mesh import TISSUE, triangulate
from .outline import Bundle, Pillar
from .solution import TissueSolution
from .surface import p2_shapes, with_middles

LEVELS = (-0.01, 0.0, 0.02, 0.04, 0.06, 0.08, 0.1)

SPACINGS = {"coarse": 75.0, "medium": 48.0, "fine": 30.0}
"""Spacing of the triangles in um for a sheet 2 mm long; others in proportion."""

REFERENCE_LENGTH_UM = 2000.0


def solve_membrane(bundle: Bundle, *, fibres: Fibres = Fibres(), inclusion: PassiveCore | None = None,  # noqa: B008
                   law: SheetLaw = SheetLaw(), resolution: Literal["coarse", "medium", "fine"] = "medium",  # noqa: B008
                   levels: Sequence[float] | Floats = LEVELS,
                   tell: Callable[[str], None] | None = None) -> TissueSolution:
    """Solve a bundle as a sheet in plane stress at a few activations.

    Raises ConfigError for a geometry without a good mesh or without posts, and CannotMeasure where no equilibrium is
    found. Not for strains through the depth, nor for pillars that lean: use `solve_tissue`.
    """
    start = time.process_time()
    if resolution not in SPACINGS:
        raise ConfigError(f"resolution: expected one of {', '.join(SPACINGS)}, found {resolution!r}")
    if not bundle.pillars:
        raise ConfigError("membrane: a sheet without posts is held by nothing; give it at least one pillar.")
    spacing = SPACINGS[resolution] * float(np.ptp(bundle.outline_um, axis=0).max()) / REFERENCE_LENGTH_UM
    plane = triangulate(bundle, spacing)
    cells = quadratic(plane.point_um, plane.triangle)
    node, h = cells.node_um, bundle.thickness_um
    low, high = bundle.outline_um.min(axis=0), bundle.outline_um.max(axis=0)

    blocks = []
    for region in range(len(bundle.pillars) + 1):
        mine = np.flatnonzero(plane.region == region)
        at = cells.at_um[mine]
        f = fibres.direction(at, low, high)
        share = np.full(at.shape[:-1], 1.0 if region == TISSUE else 0.0)
        if inclusion is not None and region == TISSUE:
            share = share - inclusion.passive(at, (low + high) / 2)
        stuff = law if region == TISSUE else SheetLaw(bundle.pillars[region - 1].young_mpa / 3)
        blocks.append(Block(stuff, cells.cell[mine], cells.gradient[mine], h * cells.dx[mine],
                            lambda g, f=f, share=share: sheet_structure(f, g * share)))  # type: ignore[misc]
    beds = [_mean_operator(cells, np.flatnonzero(plane.region == k + 1)) for k in range(len(bundle.pillars))]
    spring = _bed(cells, plane.region, bundle)
    body = Body(tuple(blocks), len(node), 0, 2, np.zeros((len(node), 2), bool), spring_un_per_um=spring)
    solved = solve_levels(body, levels, tell=tell)

    head = np.stack([solved.displacement_um.transpose(0, 2, 1) @ mean for mean in beds], axis=1)
    k = np.array([[p.stiffness_un_per_um(axis, h) for axis in (0, 1)] for p in bundle.pillars])
    on_tissue = np.flatnonzero(plane.region == TISSUE)
    strain_node = np.unique(cells.cell[on_tissue])
    return TissueSolution(
        node_um=node, cell=cells.cell, region=plane.region, top=with_middles(node, plane.triangle),
        top_region=plane.region, activation=solved.activation, displacement_um=solved.displacement_um,
        strain_node=strain_node,
        strain=nodal_strain(plane.point_um, plane.triangle, on_tissue, strain_node, solved.displacement_um),
        pillars=bundle.pillars, head_um=head, force_un=head * k, moment_un_um=np.full(head.shape, np.nan),
        log=solved.log, spacing_um=spacing,
        facts={"kind": "membrane", "resolution": resolution, "thickness_um": h, "fibres": asdict(fibres),
               "inclusion": None if inclusion is None else asdict(inclusion), "law": asdict(law),
               "seconds": time.process_time() - start})


ALIGNED = Fibres(0.0, 0.0)
"""All fibres along the columns, as in an aligned fibrous sheet."""

FIBROUS = SheetLaw(mu_mpa=0.0127, fibre_mpa=0.02)
"""Tissue with a passive network along the fibres; 0.02 MPa is our choice, about half of the tissue's own 3 mu."""


def fibrous_sheet(*, length_um: float = 400.0, width_um: float = 90.0, plate_um: tuple[float, float] = (150.0, 32.0),
                  stiffness_un_per_um: float = 0.41, thickness_um: float = 12.0, waist: float = 0.75,
                  center_um: tuple[float, float] = (150.0, 280.0)) -> Bundle:
    """Make a sheet between two plate-like posts after the paper's Type 2 (solve it with ALIGNED and FIBROUS).

    `length_um` is the distance between the plates' middles, `plate_um` their extent (rows, cols), `waist` the width at
    the middle over `width_um`. The outline wraps the plates by a fifth of their thickness; 0.41 uN/um is a soft post.
    """
    rows, cols = plate_um
    rim = 0.4 * cols
    end = length_um / 2 + cols / 2 + rim
    inner = length_um / 2 - cols / 2 - rim
    x = np.linspace(-inner, inner, 41)
    half = width_um / 2 * (waist + (1 - waist) * (x / inner) ** 2)
    half = half + (rows / 2 + rim - half[-1]) * np.clip((np.abs(x) / inner - 0.7) / 0.3, 0, 1) ** 2
    upper = np.stack([-half, x], axis=1)
    side = np.linspace(-1, 1, 9)[:, None] * np.array([[rows / 2 + rim, 0.0]])
    right = side + np.array([0.0, end])
    contour = np.vstack([upper, right, -upper, -right]) + np.asarray(center_um)
    post = [Pillar((center_um[0], center_um[1] + s * length_um / 2), plate_um, "rectangle", shaft_um=200.0)
            for s in (-1, 1)]
    return Bundle(contour, tuple(p.with_stiffness(stiffness_un_per_um, thickness_um) for p in post), thickness_um)


def _mean_operator(cells: Quadratic, mine: Ints) -> Floats:
    """Weights (n,) of the mean of a P2 field over some triangles: only the middles of sides count."""
    area = cells.dx[mine].sum(axis=1)
    weight = np.repeat(area[:, None] / 3, 3, axis=1)
    total = np.bincount(cells.cell[mine, 3:].ravel(), weight.ravel(), minlength=len(cells.node_um))
    return np.asarray(total / area.sum())


def _bed(cells: Quadratic, region: Ints, bundle: Bundle) -> sparse.csr_array:
    """Stiffness matrix (2 n, 2 n) of the posts: k over the area, times the integral of two shape functions."""
    n = len(cells.node_um)
    # degree 4 is needed for products of quadratic shapes: six points (Dunavant 1985)
    a, b, wa, wb = 0.445948490915965, 0.091576213509771, 0.223381589678011, 0.109951743655322
    bary = np.array([[a, a, 1 - 2 * a], [a, 1 - 2 * a, a], [1 - 2 * a, a, a],
                     [b, b, 1 - 2 * b], [b, 1 - 2 * b, b], [1 - 2 * b, b, b]])
    N = p2_shapes(bary)[0]
    mass = np.einsum("q,qa,qb->ab", [wa] * 3 + [wb] * 3, N, N)
    total = sparse.csr_array((2 * n, 2 * n))
    for k, pillar in enumerate(bundle.pillars, start=1):
        mine = cells.cell[region == k]
        area = cells.dx[region == k].sum(axis=1)
        for axis in (0, 1):
            bed = pillar.stiffness_un_per_um(axis, bundle.thickness_um) / area.sum()
            dof = 2 * mine + axis
            row = np.broadcast_to(dof[:, :, None], (len(mine), 6, 6)).ravel()
            col = np.broadcast_to(dof[:, None, :], (len(mine), 6, 6)).ravel()
            value = (bed * area[:, None, None] * mass).ravel()
            total = total + sparse.csr_array(sparse.coo_array((value, (row, col)), shape=(2 * n, 2 * n)))
    return total
