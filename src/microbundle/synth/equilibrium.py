"""Find the equilibrium of an active body at several activations: assembly, Newton's method, and the way along g.

Weak form: for all test displacements v and pressures q,
    sum over cells of  int P(F, p, A(g)) : grad v dX  +  u.S v  =  load.v           (S: springs of posts)
                       int q (ln J - p / kappa) dX  =  0                            (tissue only)
Both come from one energy, so the matrix is symmetric: [[K, B'], [B, -M]] with K > 0 and M > 0, which is symmetric
quasi-definite. SuperLU in its symmetric mode may then keep the diagonal as pivots, which keeps the factors small.

Cost: stress and tangent are evaluated once per Newton step at all quadrature points, the cell matrices are two
batched matrix products, and they are added up through an index that is computed once.

The body has no memory, so a few activations are solved and u(g) is interpolated: never one solve per frame. From
g = 0, where u = 0 is exact, one ramp goes up and one down. Each solve starts from the straight line through the two
before it. Where the residual is not finite (an inverted cell), or Newton does not converge, the step is halved.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from ..data import Bools, Floats, Ints
from ..errors import CannotMeasure
from .material import Law, TissueLaw, inverse_transposed

MAX_ITERATIONS = 12
SMALLEST_STEP = 1e-4
"""In activation; below it the solution is given up."""


@dataclass(frozen=True)
class Block:
    """Cells of one material, with all that assembly needs (m cells, q points, a and b nodes, d directions)."""

    law: Law
    node: Ints
    """(m, a): displacement nodes."""
    gradient: Floats
    """(m, q, a, d): gradients of the shape functions."""
    dx: Floats
    """(m, q): weights."""
    structure: Callable[[float], Floats]
    """Gives A at the points (m, q, ...) for an activation."""
    pressure_node: Ints | None = None
    """(m, b), or None for a material without pressure."""
    pressure_shape: Floats | None = None
    """(q, b)"""


@dataclass(frozen=True)
class Body:
    """Everything that has an equilibrium: n displacement nodes, then the pressure nodes."""

    blocks: tuple[Block, ...]
    nodes: int
    pressures: int
    dimension: int
    fixed: Bools
    """(n, d): displacements held at zero."""
    spring_un_per_um: sparse.csr_array | None = None
    """(n d, n d) stiffness of posts, or None."""
    load_un: Floats | None = None
    """(n, d) dead forces on the nodes, or None."""


@dataclass(frozen=True)
class SolverLog:
    """How well each step was solved; one entry per solve, halved steps included."""

    activation: Floats
    """(S,)"""
    iterations: Ints
    """(S,)"""
    residual_un: Floats
    """(S, MAX_ITERATIONS + 1): norm of the unbalanced forces before each iteration and at the end, NaN after that."""
    mean_J: Floats
    """(S,): volume of the tissue over its volume at rest."""
    worst_J: Floats
    """(S,): the J at a quadrature point of the tissue that is furthest from 1."""
    seconds: Floats
    """(S,): processor time."""
    unknowns: int


@dataclass(frozen=True)
class Levels:
    """Equilibrium at several activations."""

    activation: Floats
    """(K,), increasing."""
    displacement_um: Floats
    """(K, n, d)"""
    pressure_mpa: Floats
    """(K, pressures)"""
    force_un: Floats
    """(K, n, d): forces that the supports exert on the nodes, from fixed nodes and dead loads."""
    log: SolverLog


class Assembly:
    """Adds up residual and tangent of a body over its cells."""

    def __init__(self, body: Body) -> None:
        self.body = body
        n, d = body.nodes, body.dimension
        self.size = n * d + body.pressures
        self.dof = [self._dofs(block) for block in body.blocks]
        free = np.ones(self.size, bool)
        free[: n * d] = ~body.fixed.ravel()
        self.free = np.flatnonzero(free)
        number = np.full(self.size, -1)
        number[self.free] = np.arange(len(self.free))

        rows = [np.broadcast_to(dof[:, :, None], (*dof.shape, dof.shape[1])).ravel() for dof in self.dof]
        cols = [np.broadcast_to(dof[:, None, :], (*dof.shape, dof.shape[1])).ravel() for dof in self.dof]
        self.spring = None if body.spring_un_per_um is None else sparse.coo_array(body.spring_un_per_um)
        if self.spring is not None:
            rows.append(self.spring.row)
            cols.append(self.spring.col)
        row, col = number[np.concatenate(rows)], number[np.concatenate(cols)]
        self._kept = (row >= 0) & (col >= 0)
        N = len(self.free)
        key, self._slot = np.unique(col[self._kept].astype(np.int64) * N + row[self._kept], return_inverse=True)
        self._rows = (key % N).astype(np.int32)
        self._starts = np.searchsorted(key // N, np.arange(N + 1)).astype(np.int32)

    def _dofs(self, block: Block) -> Ints:
        d = self.body.dimension
        dof = (block.node[:, :, None] * d + np.arange(d)).reshape(len(block.node), -1)
        if block.pressure_node is not None:
            dof = np.hstack([dof, block.pressure_node + self.body.nodes * d])
        return np.asarray(dof)

    def residual(self, x: Floats, g: float) -> tuple[Floats, list[tuple[Floats, Floats, Floats]]]:
        """Give the residual (all unknowns) at x and, per block, what the tangent needs again: F, p, A."""
        body, d = self.body, self.body.dimension
        r = np.zeros(self.size)
        u = x[: body.nodes * d].reshape(-1, d)
        points: list[tuple[Floats, Floats, Floats]] = []
        for block, dof in zip(body.blocks, self.dof, strict=True):
            m, q, a, _ = block.gradient.shape
            F = np.swapaxes(u[block.node], 1, 2)[:, None] @ block.gradient + np.eye(d)
            p: Floats = np.zeros((m, q))
            A = block.structure(g)
            if block.pressure_node is not None and block.pressure_shape is not None:
                p = x[body.nodes * d + block.pressure_node] @ block.pressure_shape.T
            P = block.law.stress(F, p, A)
            force = (np.swapaxes(P, -1, -2) * block.dx[..., None, None])           # (m, q, J, i)
            cell = (block.gradient @ force).sum(axis=1).reshape(m, a * d)
            if block.pressure_shape is not None and isinstance(block.law, TissueLaw):
                gap = (np.log(np.linalg.det(F)) - p / block.law.kappa_mpa) * block.dx
                cell = np.hstack([cell, gap @ block.pressure_shape])
            r += np.bincount(dof.ravel(), cell.ravel(), minlength=self.size)
            points.append((F, p, A))
        if self.spring is not None:
            r[: body.nodes * d] += self.spring @ x[: body.nodes * d]
        if body.load_un is not None:
            r[: body.nodes * d] -= body.load_un.ravel()
        return r, points

    def tangent(self, points: list[tuple[Floats, Floats, Floats]]) -> sparse.csc_array:
        """Give the matrix of the free unknowns."""
        values = []
        d = self.body.dimension
        for block, (F, p, A) in zip(self.body.blocks, points, strict=True):
            m, q, a, _ = block.gradient.shape
            D = block.law.tangent(F, p, A) * block.dx[..., None, None, None, None]
            Gt = np.swapaxes(block.gradient, -1, -2)
            T = (D.reshape(m, q, d**3, d) @ Gt).reshape(m, q, d, d, d, a)          # q i J k b
            T = T.transpose(0, 1, 3, 2, 5, 4).reshape(m, q * d, d * a * d)         # (q J), (i b k)
            G = block.gradient.transpose(0, 2, 1, 3).reshape(m, a, q * d)
            K = (G @ T).reshape(m, a * d, a * d)
            if block.pressure_shape is not None and isinstance(block.law, TissueLaw):
                N = block.pressure_shape
                H = np.swapaxes(inverse_transposed(F) * block.dx[..., None, None], -1, -2)
                B = (block.gradient @ H).reshape(m, q, a * d)
                B = np.swapaxes(B, 1, 2) @ N                                       # (m, a d, b)
                M = np.einsum("mq,qb,qc->mbc", -block.dx / block.law.kappa_mpa, N, N)
                K = np.concatenate([np.concatenate([K, B], axis=2),
                                    np.concatenate([np.swapaxes(B, 1, 2), M], axis=2)], axis=1)
            values.append(K.ravel())
        if self.spring is not None:
            values.append(self.spring.data)
        data = np.bincount(self._slot, np.concatenate(values)[self._kept], minlength=len(self._rows))
        N_free = len(self.free)
        return sparse.csc_array((data, self._rows, self._starts), shape=(N_free, N_free))

    def volume(self, points: list[tuple[Floats, Floats, Floats]]) -> tuple[float, float]:
        """Give the mean and the worst J of the blocks with pressure; (nan, nan) where there is none."""
        J = [np.linalg.det(F).ravel() for (F, _, _), b in zip(points, self.body.blocks, strict=True)
             if b.pressure_node is not None]
        if not J:
            return np.nan, np.nan
        dx = np.concatenate([b.dx.ravel() for b in self.body.blocks if b.pressure_node is not None])
        every = np.concatenate(J)
        return float((every * dx).sum() / dx.sum()), float(every[np.abs(every - 1).argmax()])


def solve_levels(body: Body, levels: Sequence[float] | Floats, *, tolerance_um: float = 1e-6,
                 tell: Callable[[str], None] | None = None) -> Levels:
    """Solve a body at the activations `levels` (0 is added; without loads its solution is u = 0).

    A level is solved when Newton's last correction is below `tolerance_um`; the error left is of the order of its
    square. Raises CannotMeasure where no step above SMALLEST_STEP converges.
    """
    assembly = Assembly(body)
    x0 = np.zeros(assembly.size)
    records: list[tuple[float, list[float], float, float, float]] = []
    solved: dict[float, Floats] = {0.0: x0}
    if body.load_un is not None:
        solved[0.0] = _newton(assembly, x0, 0.0, tolerance_um, records)
    wanted = sorted({float(g) for g in levels} - {0.0})
    for ramp in ([g for g in wanted if g > 0], [g for g in wanted if g < 0][::-1]):
        path: list[float] = [0.0]
        todo = list(ramp)
        while todo:
            g = todo[0]
            guess = solved[path[-1]]
            if len(path) > 1:
                a, b = path[-2:]
                guess = guess + (guess - solved[a]) * (g - b) / (b - a)
            try:
                solved[g] = _newton(assembly, guess, g, tolerance_um, records)
            except _NotSolved as failure:
                if abs(g - path[-1]) < 2 * SMALLEST_STEP:
                    raise CannotMeasure(
                        f"tissue mechanics: no equilibrium found beyond activation {path[-1]:.4f} ({failure}). "
                        "Use a finer mesh, stiffer pillars, or a smaller activation.") from failure
                todo.insert(0, (g + path[-1]) / 2)
                continue
            path.append(todo.pop(0))
            if tell is not None:
                tell(f"activation {g:+.4f}: {len(records[-1][1]) - 1} iterations, {records[-1][4]:.1f} s")

    nd = body.nodes * body.dimension
    keep = sorted({0.0, *wanted})
    x = np.stack([solved[g] for g in keep])
    force = np.stack([assembly.residual(xi, g)[0][:nd] for xi, g in zip(x, keep, strict=True)])
    residual = np.full((len(records), MAX_ITERATIONS + 1), np.nan)
    for i, record in enumerate(records):
        residual[i, : len(record[1])] = record[1]
    log = SolverLog(
        activation=np.array([r[0] for r in records]), iterations=np.array([len(r[1]) - 1 for r in records], int),
        residual_un=residual, mean_J=np.array([r[2] for r in records]), worst_J=np.array([r[3] for r in records]),
        seconds=np.array([r[4] for r in records]), unknowns=len(assembly.free))
    shape = (len(keep), body.nodes, body.dimension)
    return Levels(np.array(keep), x[:, :nd].reshape(shape), x[:, nd:], force.reshape(shape), log)


class _NotSolved(Exception):
    """This step is too long."""


def _newton(assembly: Assembly, x: Floats, g: float, tolerance_um: float,
            records: list[tuple[float, list[float], float, float, float]]) -> Floats:
    """Newton's method at one activation; appends (g, residual norms, mean J, worst J, seconds)."""
    nd = assembly.body.nodes * assembly.body.dimension
    start = time.process_time()
    norms: list[float] = []
    correction = np.inf
    for _ in range(MAX_ITERATIONS + 1):
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            r, points = assembly.residual(x, g)
        if not np.isfinite(r).all():
            raise _NotSolved("the residual is not finite: a cell is turned inside out")
        norms.append(float(np.linalg.norm(r[assembly.free[assembly.free < nd]])))
        if correction < tolerance_um:
            records.append((g, norms, *assembly.volume(points), time.process_time() - start))
            return x
        if len(norms) > MAX_ITERATIONS:
            break
        matrix = assembly.tangent(points)
        try:
            factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        except RuntimeError as failure:
            raise _NotSolved(str(failure)) from failure
        dx = np.zeros_like(x)
        dx[assembly.free] = -factors.solve(r[assembly.free])
        x = x + dx
        correction = float(np.abs(dx[:nd]).max())
        if not np.isfinite(correction):
            break
    raise _NotSolved(f"Newton's method still corrects by {correction:.2g} um after {MAX_ITERATIONS} iterations")
