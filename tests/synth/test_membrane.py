"""The plane-stress sheet: free contraction on soft posts, force and deflection, fibres, speed of its few solves."""

import numpy as np
import pytest

from microbundle.errors import ConfigError
from microbundle.synth.activation import Fibres
from microbundle.synth.membrane import ALIGNED, FIBROUS, LEVELS, fibrous_sheet, solve_membrane
from microbundle.synth.outline import Bundle, Pillar, bundle_mask

UM = 4.0
PEAK = LEVELS.index(0.08)


@pytest.fixture(scope="module")
def bundle():
    return Bundle.from_mask(bundle_mask((300, 512), UM), UM)


@pytest.fixture(scope="module")
def sheet():
    return solve_membrane(fibrous_sheet(), fibres=ALIGNED, law=FIBROUS)


def test_force_is_stiffness_times_deflection_and_balances(sheet):
    k = sheet.pillars[0].stiffness_un_per_um(1, 12.0)
    assert k == pytest.approx(0.41)
    np.testing.assert_allclose(sheet.force_un[..., 1], k * sheet.head_um[..., 1])
    np.testing.assert_allclose(sheet.force_un.sum(axis=1), 0, atol=1e-9)
    assert sheet.head_um[PEAK, 0, 1] > 1
    assert sheet.head_um[PEAK, 1, 1] < -1


def test_posts_move_as_rigid_plates(sheet):
    plate = np.unique(sheet.cell[sheet.region == 1])
    u = sheet.displacement_um[PEAK, plate, 1]
    assert np.ptp(u) < 0.1 * abs(u.mean())


def test_a_small_post_lets_the_sheet_contract_freely():
    """One post holds it in place; everywhere far from it the stretch along the fibres is 1 - g."""
    angle = np.linspace(0, 2 * np.pi, 80, endpoint=False)
    outline = np.stack([250 * np.sin(angle), 1000 * np.cos(angle)], axis=1)
    lone = Bundle(outline, (Pillar((0.0, -700.0), (80.0, 80.0)),), 20.0)
    solved = solve_membrane(lone, fibres=Fibres(0.0, 0.0), levels=[0.05], resolution="coarse")
    far = solved.node_um[solved.strain_node, 1] > 0
    E = solved.strain[-1, far]
    assert np.abs(E[:, 1, 1] - (0.95**2 - 1) / 2).max() < 1e-3
    assert np.abs(E[:, 0, 0] - (1 / 0.95 - 1) / 2).max() < 1e-3
    np.testing.assert_allclose(solved.force_un, 0, atol=1e-8)


def test_passive_fibres_hold_the_contraction_back(sheet):
    soft = solve_membrane(fibrous_sheet(), fibres=ALIGNED)
    assert 0.3 < sheet.head_um[PEAK, 0, 1] / soft.head_um[PEAK, 0, 1] < 0.95


def test_demo_of_a_thick_bundle_is_quick_and_smooth(bundle):
    solved = solve_membrane(bundle)
    assert 4000 < solved.log.unknowns < 8000
    assert solved.log.seconds.mean() < 1.0
    motion = solved.motion(np.array([0.0, 0.08]), UM)
    px = np.argwhere(bundle_mask((300, 512), UM)).astype(float)[::53]
    assert not motion.displacement_px(px, 0).any()
    J = np.linalg.det(motion.gradient(px, 1))
    assert 0.85 < J.min() < J.max() < 1.1
    assert solved.surface.gap_rms_um < 0.1
    assert solved.surface.gap_F < 0.5 * solved.surface.jump_F
    assert np.isnan(solved.worst_J)


def test_a_sheet_without_posts_is_refused(bundle):
    with pytest.raises(ConfigError, match="without posts"):
        solve_membrane(Bundle(bundle.outline_um, ()))
    with pytest.raises(ConfigError, match="resolution"):
        solve_membrane(bundle, resolution="finest")
