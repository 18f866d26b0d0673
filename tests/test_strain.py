"""Deformation gradients of known motions, and where the sub-domains lie."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from microbundle.axis import measure_axis
from microbundle.config import Config
from microbundle.data import Beats, Masks, Strain, Tracks
from microbundle.errors import CannotMeasure
from microbundle.geometry import rotation, to_image
from microbundle.strain import fit_gradient, measure_strain
from microbundle.tiles import Tiling, place_tiles

gradients = arrays(float, (2, 2), elements=st.floats(-0.3, 0.3)).map(lambda G: np.eye(2) + G)
quick = settings(max_examples=50, deadline=None, derandomize=True)


def scattered(count: int, seed: int = 0, size: float = 40.0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, size, (count, 2))


@quick
@given(F=gradients, shift=arrays(float, 2, elements=st.floats(-50, 50)), seed=st.integers(0, 99))
def test_affine_motion_is_recovered_exactly(F, shift, seed):
    X = scattered(12, seed)
    x = X @ F.T + shift
    found, moved = fit_gradient(X, x[None])
    np.testing.assert_allclose(found[0], F, atol=1e-10)
    np.testing.assert_allclose(moved[0], x.mean(axis=0) - X.mean(axis=0), atol=1e-10)


@quick
@given(seed=st.integers(0, 999), count=st.integers(4, 15))
def test_fit_is_the_papers_least_squares_over_all_pairs(seed, count):
    rng = np.random.default_rng(seed)
    X, x = rng.uniform(0, 40, (count, 2)), rng.uniform(0, 40, (count, 2))
    i, j = np.triu_indices(count, 1)
    L0, L = (X[i] - X[j]).T, (x[i] - x[j]).T
    found, _ = fit_gradient(X, x[None])
    np.testing.assert_allclose(found[0], L @ L0.T @ np.linalg.inv(L0 @ L0.T), atol=1e-8)


@quick
@given(F=gradients, lost=st.sets(st.integers(0, 11), max_size=8), seed=st.integers(0, 99))
def test_missing_markers_are_left_out(F, lost, seed):
    X = scattered(12, seed)
    x = np.stack([X @ F.T, X @ F.T])
    x[1, list(lost)] = np.nan
    found, moved = fit_gradient(X, x)
    np.testing.assert_allclose(found, np.stack([F, F]), atol=1e-8)
    seen = [k for k in range(12) if k not in lost]
    np.testing.assert_allclose(moved[1], (X[seen] @ F.T - X[seen]).mean(axis=0), atol=1e-8)


def test_too_few_or_collinear_points_have_no_gradient():
    X = scattered(6)
    x = np.stack([X, X, X])
    x[1, 2:] = np.nan
    F, moved = fit_gradient(X, x)
    assert np.isnan(F[1]).all()
    assert np.isnan(moved[1]).all()
    assert np.isfinite(F[[0, 2]]).all()
    line = np.stack([np.arange(6.0), 2 * np.arange(6.0)], 1)
    assert np.isnan(fit_gradient(line, line[None])[0]).all()


def some_strain(F: np.ndarray) -> Strain:
    """One sub-domain in one frame."""
    return Strain(("A1",), (1, 1), (40.0, 40.0), np.zeros((1, 4, 2)), 0.0, np.zeros((1, 1, 2)), F[None, None],
                  np.array([9]), ("",))


@quick
@given(F=gradients)
def test_principal_strains_are_eigenvalues_and_the_angle_is_that_of_the_smaller(F):
    strain = some_strain(F)
    E = strain.E[0, 0]
    np.testing.assert_allclose(E, 0.5 * (F.T @ F - np.eye(2)), atol=1e-12)
    value, angle = strain.principal
    np.testing.assert_allclose(value[0, 0], np.linalg.eigvalsh(E), atol=1e-10)
    assert -90 <= angle[0, 0] <= 90
    a = np.radians(angle[0, 0])
    v = np.array([np.sin(a), np.cos(a)])  # (row, col)
    assert v @ E @ v == pytest.approx(value[0, 0, 0], abs=1e-10)
    assert strain.J[0, 0] == pytest.approx(np.linalg.det(F))


@quick
@given(F=gradients, degrees=st.floats(-180, 180))
def test_rigid_turn_after_the_motion_changes_no_strain(F, degrees):
    a = np.radians(degrees)
    turn = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    np.testing.assert_allclose(some_strain(turn @ F).E, some_strain(F).E, atol=1e-12)


def test_labels_go_on_past_z():
    labels = Tiling(np.zeros(2), (54, 2), (5, 5), np.zeros(2), np.array([0.0, 1.0])).labels
    assert labels[:4] == ("A1", "A2", "B1", "B2")
    assert labels[50:54] == ("Z1", "Z2", "AA1", "AA2")
    assert labels[-2:] == ("BB1", "BB2")
    assert len(set(labels)) == 108


# --- a strip with markers -------------------------------------------------------------------------------------------


def masks(angle_deg: float = 0.0, shape=(300, 300)) -> Masks:
    row, col = np.mgrid[:shape[0], :shape[1]].astype(float)
    direction = np.array([np.sin(np.radians(angle_deg)), np.cos(np.radians(angle_deg))])
    along = (row - 149.5) * direction[0] + (col - 149.5) * direction[1]
    across = (row - 149.5) * direction[1] - (col - 149.5) * direction[0]
    tissue = (np.abs(along) < 120) & (np.abs(across) < 45)
    return Masks(tissue, measure_axis(tissue), "supplied")


def moved(F: np.ndarray, masks: Masks, spacing: float = 7.0, keep=lambda points: np.ones(len(points), bool),
          noise: float = 0.0) -> tuple[Tracks, Beats]:
    """Markers of a regular grid, at rest in frame 0 and 2 and moved by F (in the image's axes) in frame 1."""
    rows, cols = (np.arange(0, n, spacing) for n in masks.tissue.shape)
    X = np.stack(np.meshgrid(rows, cols, indexing="ij"), -1).reshape(-1, 2) + 0.3
    X = X[masks.tissue[tuple(X.astype(int).T)]]
    X = X[keep(X)]
    x = np.stack([X, (X - 150) @ F.T + 150, X])
    x += np.random.default_rng(0).normal(0, noise, x.shape)
    tracks = Tracks(x, np.ones(x.shape[:2], bool), "default", 0, 17)
    beats = Beats(np.array([0.0, 1, 0]), 0.01, np.array([0]), np.array([1]), np.array([3]), np.array([True]),
                  np.array([True, False, True]), X, X[None], "default")
    return tracks, beats


@pytest.mark.parametrize("angle", [0.0, 30.0, -43.0, 80.0])
def test_strain_is_that_along_and_across_the_tissue(angle):
    found = masks(angle)
    R = rotation(found.axis.direction)
    in_tissue = np.array([[1.02, 0.01], [0.0, 0.95]])
    strain = measure_strain(*moved(R.T @ in_tissue @ R, found), found, Config())
    assert strain.grid == (2, 2)
    assert strain.angle_deg == pytest.approx(angle, abs=1)
    np.testing.assert_allclose(strain.F[1], np.broadcast_to(in_tissue, (4, 2, 2)), atol=1e-9)
    np.testing.assert_allclose(strain.F[0], np.broadcast_to(np.eye(2), (4, 2, 2)), atol=1e-9)
    # the centres move with the tissue
    expected = (strain.center_px[0] - 150) @ (R.T @ in_tissue @ R).T + 150
    np.testing.assert_allclose(strain.center_px[1], expected, atol=0.2)


def test_corners_are_clockwise_squares_in_the_tissue():
    found = masks(25.0)
    strain = measure_strain(*moved(np.eye(2), found), found, Config())
    side = np.diff(strain.corner_px, axis=1)
    np.testing.assert_allclose(np.hypot(side[..., 0], side[..., 1]), 40)
    np.testing.assert_allclose(side[:, 0] @ found.axis.direction, 40)
    np.testing.assert_allclose(strain.corner_px.mean(axis=1), strain.center_px[0], atol=1e-6)
    inside = strain.corner_px.reshape(-1, 2).round().astype(int)
    assert found.tissue[inside[:, 0], inside[:, 1]].all()


def test_tiles_by_number_share_the_room():
    tiling = place_tiles(masks(), Config.from_dict({"strain": {"tiles": [3, 5]}}))
    assert tiling.grid == (3, 5)
    assert tiling.side[0] == np.floor(min(89 * 0.9 / 3, 239 * 0.5 * 0.9 / 5))
    middle = tiling.boxes[:, [0, 2]].min(axis=0) + 0.5 * np.array([3, 5]) * tiling.side
    np.testing.assert_allclose(middle, masks().axis.center_px, atol=1)


def test_given_extents_are_used_and_may_be_one_tile():
    config = Config.from_dict({"strain": {"extents_px": [130, 180, 120, 170], "shrink_rows": 0, "shrink_columns": 0,
                                          "tile_px": 45}})
    tiling = place_tiles(masks(), config)
    assert tiling.grid == (1, 1)
    np.testing.assert_allclose(tiling.boxes, [[132.5, 177.5, 122.5, 167.5]])
    strain = measure_strain(*moved(np.diag([1.0, 0.96]), masks()), masks(), config)
    np.testing.assert_allclose(strain.F[1, 0], np.diag([1.0, 0.96]), atol=1e-9)


def test_no_room_for_a_tile_is_an_error_that_says_what_to_change():
    with pytest.raises(CannotMeasure, match="tile_px"):
        place_tiles(masks(), Config.from_dict({"strain": {"tile_px": 90}}))


def test_tile_without_enough_spread_out_markers_is_nan_with_a_reason():
    boxes = place_tiles(masks(), Config()).boxes

    def keep(points):
        in_tile = [(points > box[[0, 2]]).all(axis=1) & (points < box[[1, 3]]).all(axis=1) for box in boxes]
        one_column = np.abs(points[:, 1] - points[in_tile[1], 1][0]) < 1
        few = np.cumsum(in_tile[2]) <= 2
        return ~in_tile[0] & (~in_tile[1] | one_column) & (~in_tile[2] | few)

    strain = measure_strain(*moved(np.diag([1.0, 0.96]), masks(), keep=keep), masks(), Config())
    assert strain.reason[0] == "0 markers, needs 4"
    assert "one line" in strain.reason[1]
    assert strain.reason[2] == "2 markers, needs 4"
    assert strain.reason[3] == ""
    assert np.isnan(strain.F[:, :3]).all()
    np.testing.assert_allclose(strain.F[1, 3], np.diag([1.0, 0.96]), atol=1e-9)


def test_one_wild_marker_that_is_flagged_changes_nothing():
    found = masks()
    tracks, beats = moved(np.diag([1.0, 0.96]), found)
    position, ok = tracks.position_px.copy(), tracks.ok.copy()
    ok[1, 40:60] = False
    position[1, 40:60] = np.nan
    strain = measure_strain(Tracks(position, ok, "default", 0, 17), beats, found, Config())
    np.testing.assert_allclose(strain.F[1], np.broadcast_to(np.diag([1.0, 0.96]), (4, 2, 2)), atol=1e-9)


def test_noise_of_tracking_averages_out():
    found = masks()
    strain = measure_strain(*moved(np.eye(2), found, noise=0.05), found, Config())
    assert np.abs(strain.E[1]).max() < 0.05 / (40 * 0.29 * np.sqrt(30)) * 4


def test_turned_tiles_come_back_into_the_image():
    found = masks(30.0)
    tiling = place_tiles(found, Config())
    strain = measure_strain(*moved(np.eye(2), found), found, Config())
    middle = 0.5 * (tiling.boxes[:, ::2] + tiling.boxes[:, 1::2])
    np.testing.assert_allclose(to_image(middle, tiling.center, tiling.direction), strain.center_px[0], atol=1e-9)
