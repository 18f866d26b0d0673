"""Stress and tangent against finite differences of the energy, and the states that must be free of stress."""

import numpy as np
import pytest

from microbundle.synth.material import PillarLaw, SheetLaw, TissueLaw, active_tensor, sheet_structure

LAWS = [
    pytest.param(TissueLaw(), 3, id="tissue"),
    pytest.param(PillarLaw(), 3, id="pillar"),
    pytest.param(SheetLaw(fibre_mpa=0.02), 2, id="sheet"),
]


def some_state(d):
    random = np.random.default_rng(3)
    F = np.eye(d) + 0.15 * random.normal(size=(d, d))
    f = random.normal(size=d)
    f /= np.linalg.norm(f)
    g = np.array(0.07)
    return F, np.array(0.004), active_tensor(f, g) if d == 3 else sheet_structure(f, g)


def differences(function, F, eps=1e-6):
    d = len(F)
    out = np.empty((*np.shape(function(F)), d, d))
    for k in range(d):
        for L in range(d):
            step = np.zeros((d, d))
            step[k, L] = eps
            out[..., k, L] = (function(F + step) - function(F - step)) / (2 * eps)
    return out


@pytest.mark.parametrize(("law", "d"), LAWS)
def test_stress_is_the_slope_of_the_energy(law, d):
    F, p, A = some_state(d)
    expected = differences(lambda at: law.energy(at, p, A), F)
    np.testing.assert_allclose(law.stress(F, p, A), expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("law", "d"), LAWS)
def test_tangent_is_the_slope_of_the_stress(law, d):
    F, p, A = some_state(d)
    tangent = law.tangent(F, p, A)
    np.testing.assert_allclose(tangent, differences(lambda at: law.stress(at, p, A), F), rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(tangent, tangent.transpose(2, 3, 0, 1), atol=1e-12)


@pytest.mark.parametrize("g", [-0.01, 0.0, 0.08, 0.3])
def test_free_contraction_has_no_stress(g):
    f = np.array([0.2, 0.97, 0.1])
    f /= np.linalg.norm(f)
    Fa = (1 - g) * np.outer(f, f) + (1 - g) ** -0.5 * (np.eye(3) - np.outer(f, f))
    assert np.abs(TissueLaw().stress(Fa, np.array(0.0), active_tensor(f, np.array(g)))).max() < 1e-15
    f = f[:2] / np.linalg.norm(f[:2])
    Fa = (1 - g) * np.outer(f, f) + (1 - g) ** -0.5 * (np.eye(2) - np.outer(f, f))
    assert np.abs(SheetLaw().stress(Fa, np.array(0.0), sheet_structure(f, np.array(g)))).max() < 1e-15


def test_small_strains_of_a_pillar_follow_hooke():
    law, e = PillarLaw(young_mpa=1.6, poisson=0.47), 1e-6
    F = np.eye(3) + e * np.diag([-0.47, -0.47, 1.0])
    stress = law.stress(F, np.array(0.0), np.eye(3))
    np.testing.assert_allclose(stress, 1.6 * e * np.diag([0, 0, 1.0]), atol=1e-11)
