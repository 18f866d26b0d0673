"""The room of scikit-fem: from a mesh of triangles or tetrahedra to shape functions at quadrature points.

scikit-fem numbers the quadratic nodes and evaluates the shape functions; everything after that is ours. It belongs to
the extra `synth` and is loaded when it is first needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..data import Floats, Ints
from ..errors import MicrobundleError


@dataclass(frozen=True)
class Quadratic:
    """P2 shape functions on m straight cells with q quadrature points, a nodes each, in d directions."""

    node_um: Floats
    """(n, d): the vertices of the mesh in their order, then the middles of its edges."""
    cell: Ints
    """(m, a): corners, then the middles of edges."""
    gradient: Floats
    """(m, q, a, d), per um"""
    dx: Floats
    """(m, q): weights, in um^d"""
    at_um: Floats
    """(m, q, d): quadrature points."""
    linear: Floats
    """(q, d + 1): the P1 shape functions at the quadrature points."""


def quadratic(vertex_um: Floats, simplex: Ints) -> Quadratic:
    """Prepare P2 cells on simplices (m, d + 1) with vertices (V, d).

    The rule has degree 2 (four points on a tetrahedron), as the published one: it integrates the stiffness of straight
    P2 cells exactly where F is constant.
    """
    mesh, element, corner = _kind(vertex_um, simplex)
    skfem = import_skfem()
    basis = skfem.Basis(mesh, element, intorder=2)
    points = basis.dx.shape[1]
    linear = skfem.Basis(mesh, corner, intorder=2)
    return Quadratic(
        node_um=np.asarray(basis.doflocs.T), cell=np.asarray(basis.element_dofs.T), gradient=_gradient(basis),
        dx=np.asarray(basis.dx), at_um=np.asarray(basis.global_coordinates()).transpose(1, 2, 0),
        linear=np.stack([np.asarray(b[0]).reshape(-1, points)[0] for b in linear.basis], axis=-1))


def nodal_strain(vertex_um: Floats, simplex: Ints, chosen: Ints, node: Ints, displacement_um: Floats) -> Floats:
    """Give the Green-Lagrange strain (K, t, d, d) at P2 nodes (t,): the mean over the `chosen` cells that meet there.

    The deformation gradient is averaged with the cells' volumes, then squared.
    """
    mesh, element, _ = _kind(vertex_um, simplex)
    local = np.asarray(element.doflocs).T
    basis = import_skfem().Basis(mesh, element, elements=chosen, quadrature=(local, np.ones(local.shape[1])))
    cell, G = np.asarray(basis.element_dofs.T), _gradient(basis)
    d = vertex_um.shape[1]
    number = np.full(displacement_um.shape[1], -1)
    number[node] = np.arange(len(node))
    slot = number[cell].ravel()
    mine = slot >= 0
    size = np.asarray(basis.dx).ravel()[mine]
    total = np.bincount(slot[mine], size, minlength=len(node))
    E = []
    for u in displacement_um:
        F = (np.swapaxes(u[cell], 1, 2)[:, None] @ G).reshape(-1, d * d)[mine]
        mean = np.stack([np.bincount(slot[mine], F[:, k] * size, minlength=len(node)) for k in range(d * d)], axis=1)
        F = (mean / total[:, None]).reshape(-1, d, d) + np.eye(d)
        E.append((np.swapaxes(F, 1, 2) @ F - np.eye(d)) / 2)
    return np.stack(E)


def import_skfem() -> Any:
    """Load scikit-fem, or say which extra brings it."""
    try:
        import skfem
    except ImportError as error:
        raise MicrobundleError("tissue mechanics needs scikit-fem, which is not installed: "
                               'pip install "microbundle[synth]"') from error
    return skfem


def _kind(vertex_um: Floats, simplex: Ints) -> tuple[Any, Any, Any]:
    skfem = import_skfem()
    if vertex_um.shape[1] == 3:
        mesh, two, one = skfem.MeshTet, skfem.ElementTetP2(), skfem.ElementTetP1()
    else:
        mesh, two, one = skfem.MeshTri, skfem.ElementTriP2(), skfem.ElementTriP1()
    # the cells keep their order, so that other arrays over cells and vertices still fit
    return mesh(vertex_um.T.copy(), simplex.T.copy(), sort_t=False), two, one


def _gradient(basis: Any) -> Floats:
    """(m, q, a, d)"""
    return np.stack([np.asarray(b[0].grad).transpose(1, 2, 0) for b in basis.basis], axis=2)
