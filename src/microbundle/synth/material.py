"""How the materials answer to a deformation gradient: energy, stress and tangent, at many points at once.

Letters: F deformation gradient (..., d, d); J = det F; H = F^-T; P = dW/dF first Piola-Kirchhoff stress; the tangent
dP/dF has the indices iJkL. Active strain (S1 Appendix): F = Fe Fa with
Fa = (1 - g) f f' + (1 - g)^(-1/2) (I - f f'), so that the elastic energy sees tr(Fe' Fe) = tr(F A F'), with
A = Fa^-1 Fa^-T = f f' / (1 - g)^2 + (1 - g) (I - f f'). Moduli are in MPa, energies in MPa (uJ/mm^3).

Three laws:
- tissue, nearly incompressible neo-Hookean with the pressure as an unknown,
  W = mu/2 (J^(-2/3) tr(F A F') - 3) + p ln J - p^2 / (2 kappa),
  which is Pezzuto's mixed form of kappa/2 (ln J)^2: stationary in p means p = kappa ln J;
- pillar, W = mu/2 (F:F - 3 - 2 ln J) + lambda/2 ((J^2 - 1)/2 - ln J);
- sheet, the incompressible neo-Hookean in plane stress, where the thickness follows as 1/J,
  W = mu/2 (tr(F A F') + A33/J^2 - 3) + mu_f/8 (|F f|^2 - 1)^2, with a passive fibre network of modulus mu_f.

Each tangent was derived by hand from dJ = J H:dF and dH = -H dF' H; a test holds it to finite differences.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..data import Floats


class Law(Protocol):
    """What the equilibrium needs to know of a material."""

    def energy(self, F: Floats, p: Floats, A: Floats) -> Floats: ...

    def stress(self, F: Floats, p: Floats, A: Floats) -> Floats: ...

    def tangent(self, F: Floats, p: Floats, A: Floats) -> Floats: ...


@dataclass(frozen=True)
class TissueLaw:
    """Active, nearly incompressible neo-Hookean tissue; the published moduli are the default."""

    mu_mpa: float = 0.0127
    kappa_mpa: float = 10.0

    def energy(self, F: Floats, p: Floats, A: Floats) -> Floats:
        """W (...) at F (..., 3, 3), pressure p (...) and A (..., 3, 3)."""
        J = np.linalg.det(F)
        I1 = ((F @ A) * F).sum(axis=(-1, -2))
        return np.asarray(self.mu_mpa / 2 * (J ** (-2 / 3) * I1 - 3) + p * np.log(J) - p**2 / (2 * self.kappa_mpa))

    def stress(self, F: Floats, p: Floats, A: Floats) -> Floats:
        """P = mu J^(-2/3) (F A - I1/3 H) + p H."""
        J, H, FA = np.linalg.det(F), inverse_transposed(F), F @ A
        I1 = (FA * F).sum(axis=(-1, -2))
        return np.asarray(_at(self.mu_mpa * J ** (-2 / 3)) * (FA - _at(I1 / 3) * H) + _at(p) * H)

    def tangent(self, F: Floats, p: Floats, A: Floats) -> Floats:
        """dP/dF (..., 3, 3, 3, 3) at constant p."""
        J, H, FA = np.linalg.det(F), inverse_transposed(F), F @ A
        I1 = (FA * F).sum(axis=(-1, -2))
        c = self.mu_mpa * J ** (-2 / 3)
        S = _at(c * 2 / 3) * FA
        K = -_outer(H, S) - _outer(S, H) + _outer(_at(c * I1 * 2 / 9) * H, H) + _swap(_at(c * I1 / 3 - p) * H, H)
        return _add_identity(K, _at(c) * A)


@dataclass(frozen=True)
class PillarLaw:
    """Compressible neo-Hookean pillar; nothing is active in it, and it has no pressure."""

    young_mpa: float = 1.6
    poisson: float = 0.47

    @property
    def lame_mpa(self) -> tuple[float, float]:
        """Shear modulus mu and Lame's lambda."""
        E, nu = self.young_mpa, self.poisson
        return E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))

    def energy(self, F: Floats, p: Floats, A: Floats) -> Floats:  # noqa: ARG002
        """W (...) at F (..., 3, 3)."""
        mu, lam = self.lame_mpa
        J = np.linalg.det(F)
        return np.asarray(mu / 2 * ((F * F).sum(axis=(-1, -2)) - 3 - 2 * np.log(J))
                          + lam / 2 * ((J**2 - 1) / 2 - np.log(J)))

    def stress(self, F: Floats, p: Floats, A: Floats) -> Floats:  # noqa: ARG002
        """P = mu (F - H) + lambda/2 (J^2 - 1) H."""
        mu, lam = self.lame_mpa
        J, H = np.linalg.det(F), inverse_transposed(F)
        return np.asarray(mu * (F - H) + _at(lam / 2 * (J**2 - 1)) * H)

    def tangent(self, F: Floats, p: Floats, A: Floats) -> Floats:  # noqa: ARG002
        """dP/dF (..., 3, 3, 3, 3)."""
        mu, lam = self.lame_mpa
        J, H = np.linalg.det(F), inverse_transposed(F)
        K = _outer(_at(lam * J**2) * H, H) + _swap(_at(mu - lam / 2 * (J**2 - 1)) * H, H)
        return _add_identity(K, np.broadcast_to(mu * np.eye(3), F.shape))


@dataclass(frozen=True)
class SheetLaw:
    """Active incompressible neo-Hookean sheet in plane stress, with an optional network of passive fibres.

    `A` carries the in-plane part of the active tensor and A33 = 1 - g in its place (2, 2), and the fibre direction's
    f f' with a third index, see `sheet_structure`: shape (..., 2, 2, 3).
    """

    mu_mpa: float = 0.0127
    fibre_mpa: float = 0.0

    def energy(self, F: Floats, p: Floats, A: Floats) -> Floats:  # noqa: ARG002
        """W (...) at F (..., 2, 2)."""
        A2, A33, ff = A[..., 0], A[..., 0, 0, 1], A[..., 2]
        J = np.linalg.det(F)
        I4 = ((F @ ff) * F).sum(axis=(-1, -2))
        return np.asarray(self.mu_mpa / 2 * (((F @ A2) * F).sum(axis=(-1, -2)) + A33 / J**2 - 3)
                          + self.fibre_mpa / 8 * (I4 - 1) ** 2)

    def stress(self, F: Floats, p: Floats, A: Floats) -> Floats:  # noqa: ARG002
        """P = mu (F A - A33 J^-2 H) + mu_f/2 (|F f|^2 - 1) F f f'."""
        A2, A33, ff = A[..., 0], A[..., 0, 0, 1], A[..., 2]
        J, H, Fff = np.linalg.det(F), inverse_transposed(F), F @ ff
        I4 = (Fff * F).sum(axis=(-1, -2))
        return np.asarray(self.mu_mpa * (F @ A2 - _at(A33 / J**2) * H) + _at(self.fibre_mpa / 2 * (I4 - 1)) * Fff)

    def tangent(self, F: Floats, p: Floats, A: Floats) -> Floats:  # noqa: ARG002
        """dP/dF (..., 2, 2, 2, 2)."""
        A2, A33, ff = A[..., 0], A[..., 0, 0, 1], A[..., 2]
        J, H, Fff = np.linalg.det(F), inverse_transposed(F), F @ ff
        I4 = (Fff * F).sum(axis=(-1, -2))
        c = self.mu_mpa * A33 / J**2
        K = _outer(_at(2 * c) * H, H) + _swap(_at(c) * H, H) + _outer(self.fibre_mpa * Fff, Fff)
        return _add_identity(K, self.mu_mpa * A2 + _at(self.fibre_mpa / 2 * (I4 - 1)) * ff)


def active_tensor(f: Floats, g: Floats) -> Floats:
    """A = f f' / (1 - g)^2 + (1 - g) (I - f f') of unit fibres f (..., d) with activation g (...)."""
    ff = f[..., :, None] * f[..., None, :]
    return np.asarray(_at(1 / (1 - g) ** 2) * ff + _at(1 - g) * (np.eye(f.shape[-1]) - ff))


def sheet_structure(f: Floats, g: Floats) -> Floats:
    """Pack A, A33 and f f' of a sheet's unit fibres f (..., 2) with activation g (...) as (..., 2, 2, 3)."""
    ff = f[..., :, None] * f[..., None, :]
    return np.stack([active_tensor(f, g), np.broadcast_to(_at(1 - g), ff.shape), ff], axis=-1)


def inverse_transposed(F: Floats) -> Floats:
    """H = F^-T."""
    return np.asarray(np.swapaxes(np.linalg.inv(F), -1, -2))


def _at(scalar: Floats) -> Floats:
    return np.asarray(scalar)[..., None, None]


def _outer(a: Floats, b: Floats) -> Floats:
    """a_iJ b_kL"""
    return np.asarray(a[..., :, :, None, None] * b[..., None, None, :, :])


def _swap(a: Floats, b: Floats) -> Floats:
    """a_iL b_kJ: what -dH = H dF' H looks like in indices."""
    return np.asarray(a[..., :, None, None, :] * np.swapaxes(b, -1, -2)[..., None, :, :, None])


def _add_identity(K: Floats, A: Floats) -> Floats:
    """K_iJkL + delta_ik A_JL"""
    for i in range(A.shape[-1]):
        K[..., i, :, i, :] += A
    return K
