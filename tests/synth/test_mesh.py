"""Contours, triangles and tetrahedra: areas and volumes that are known, outlines that are respected, errors."""

from collections import Counter

import numpy as np
import pytest

from microbundle.errors import ConfigError, MaskUnusable
from microbundle.synth.mesh import extrude, triangulate
from microbundle.synth.outline import Bundle, Pillar, bundle_mask, default_pillars, inside, trace_outline

UM = 4.0


def polygon_area(p):
    q = np.roll(p, -1, axis=0)
    return abs(np.sum(p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1])) / 2


def triangle_areas(mesh):
    corner = mesh.point_um[mesh.triangle]
    return np.abs(np.linalg.det(corner[:, 1:] - corner[:, :1])) / 2


@pytest.fixture(scope="module")
def bundle():
    return Bundle.from_mask(bundle_mask((300, 512), UM), UM)


def test_outline_lies_on_the_border_of_the_mask():
    r, c = np.mgrid[:90, :120]
    contour = trace_outline(np.hypot(r - 40.3, c - 60.7) < 30)
    radius = np.hypot(*(contour - [40.3, 60.7]).T)
    assert abs(radius.mean() - 30) < 0.3
    assert radius.std() < 0.3
    assert polygon_area(contour) == pytest.approx(np.pi * 30**2, rel=0.02)


def test_outline_takes_the_largest_region_and_fills_holes_also_at_the_edge():
    mask = bundle_mask((300, 512), UM)
    whole = polygon_area(trace_outline(mask))
    broken = mask.copy()
    broken[140:160, 100:140] = False
    broken[5:9, 5:9] = True
    assert polygon_area(trace_outline(broken)) == pytest.approx(whole, rel=1e-6)
    cut = mask[:, 60:].copy()
    cut[130:170, :20] = False
    filled = polygon_area(trace_outline(mask[:, 60:]))
    assert polygon_area(trace_outline(cut)) == pytest.approx(filled, rel=0.01)


def test_empty_mask_is_refused():
    with pytest.raises(MaskUnusable, match="marks no pixel"):
        trace_outline(np.zeros((20, 20), bool))


def test_default_pillars_stand_at_the_ends_or_in_the_holes():
    mask = bundle_mask((300, 512), UM)
    left, right = default_pillars(mask, UM)
    assert left.center_um[1] < right.center_um[1]
    assert left.center_um[0] == pytest.approx(149.5 * UM, abs=UM)
    assert left.center_um[1] + right.center_um[1] == pytest.approx(511 * UM, abs=2 * UM)
    holed = mask.copy()
    r, c = np.mgrid[:300, :512]
    for at in (120, 390):
        holed &= np.hypot(r - 150, c - at) > 30
    centers = np.array([p.center_um for p in default_pillars(holed, UM)]) / UM
    np.testing.assert_allclose(centers, [[150, 120], [150, 390]], atol=0.5)


@pytest.mark.parametrize("spacing", [200.0, 150.0, 110.0, 75.0])
def test_triangles_cover_the_bundle_and_respect_the_pillars(bundle, spacing):
    mesh = triangulate(bundle, spacing)
    area = triangle_areas(mesh)
    assert mesh.min_angle_deg > 15
    assert area.sum() == pytest.approx(polygon_area(bundle.outline_um), rel=0.03)
    for k, pillar in enumerate(bundle.pillars, start=1):
        assert area[mesh.region == k].sum() == pytest.approx(polygon_area(pillar.polygon_um(spacing)), rel=1e-9)


def test_rectangular_pillars_are_respected_too(bundle):
    pillars = tuple(Pillar(p.center_um, (163.0, 60.0), "rectangle") for p in bundle.pillars)
    mesh = triangulate(Bundle(bundle.outline_um, pillars), 100.0)
    area = triangle_areas(mesh)
    for k in (1, 2):
        assert area[mesh.region == k].sum() == pytest.approx(163 * 60, rel=1e-9)


def test_polygon_of_a_round_pillar_bends_like_the_circle():
    pillar = Pillar((0.0, 0.0), (300.0, 300.0))
    p = pillar.polygon_um(100.0)
    q = np.roll(p, -1, axis=0)
    cross = p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]
    moment = abs(np.sum(cross * (p[:, 1] ** 2 + p[:, 1] * q[:, 1] + q[:, 1] ** 2))) / 12
    assert moment == pytest.approx(pillar.second_moment_um4(1), rel=1e-12)


def test_pillar_mask_gives_centre_and_diameter():
    r, c = np.mgrid[:90, :120]
    pillar = Pillar.from_mask(np.hypot(r - 40, c - 60) < 25, UM)
    assert pillar.center_um == pytest.approx((160, 240))
    assert pillar.size_um[0] == pytest.approx(200, rel=0.01)
    with pytest.raises(MaskUnusable):
        Pillar.from_mask(np.zeros((5, 5), bool), UM)


def test_stiffness_can_be_chosen():
    plate = Pillar((0.0, 0.0), (150.0, 32.0), "rectangle").with_stiffness(0.41, 12.0)
    assert plate.stiffness_un_per_um(1, 12.0) == pytest.approx(0.41)
    assert plate.stiffness_un_per_um(0, 12.0) == pytest.approx(0.41 * (150 / 32) ** 2)


def test_tetrahedra_fill_the_solid_and_share_whole_faces(bundle):
    plane = triangulate(bundle, 200.0)
    shafts = [np.array([400.0, 700.0, 995.0])] * 2
    mesh = extrude(plane, np.linspace(0, 400, 3), shafts)
    corner = mesh.point_um[mesh.cell]
    volume = np.abs(np.linalg.det(corner[:, 1:] - corner[:, :1])) / 6
    area = triangle_areas(plane)
    assert volume.min() > 0
    assert volume.sum() == pytest.approx(400 * area.sum() + 595 * area[plane.region > 0].sum(), rel=1e-12)
    faces = Counter(tuple(sorted(int(v) for v in np.delete(cell, k))) for cell in mesh.cell for k in range(4))
    assert set(faces.values()) == {1, 2}
    outer = np.array([face for face, count in faces.items() if count == 1])
    p = mesh.point_um[outer]
    skin = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1).sum() / 2
    contour = np.hypot(*np.diff(np.vstack([r := _loop(plane), r[:1]]), axis=0).T).sum()
    rings = sum(np.hypot(*(np.roll(q, -1, axis=0) - q).T).sum() for q in (x.polygon_um(200.0) for x in bundle.pillars))
    # upper and lower face, the tissue's side, the shafts' sides: nothing else is open
    assert skin == pytest.approx(2 * area.sum() + 400 * contour + 595 * rings, rel=1e-9)


def _loop(plane):
    edges = Counter(tuple(sorted(map(int, (t[i], t[(i + 1) % 3])))) for t in plane.triangle for i in range(3))
    after = {}
    for a, b in (e for e, count in edges.items() if count == 1):
        after.setdefault(a, []).append(b)
        after.setdefault(b, []).append(a)
    path = [next(iter(after))]
    before = -1
    while True:
        ahead = [v for v in after[path[-1]] if v != before]
        before = path[-1]
        if ahead[0] == path[0] and len(path) > 2:
            return plane.point_um[path]
        path.append(ahead[0])


def test_misplaced_pillars_are_refused(bundle):
    outside = Pillar((100.0, 100.0), (200.0, 200.0))
    with pytest.raises(ConfigError, match="does not lie inside"):
        triangulate(Bundle(bundle.outline_um, (outside,)), 150.0)
    one = Pillar((600.0, 500.0), (300.0, 300.0))
    two = Pillar((600.0, 600.0), (300.0, 300.0))
    with pytest.raises(ConfigError, match="overlaps"):
        triangulate(Bundle(bundle.outline_um, (one, two)), 150.0)
    with pytest.raises(ConfigError, match="pillar"):
        Pillar((0.0, 0.0), (-1.0, -1.0))


def test_inside_counts_crossings():
    square = np.array([[0.0, 0.0], [0.0, 2.0], [2.0, 2.0], [2.0, 0.0]])
    np.testing.assert_array_equal(inside(np.array([[1.0, 1.0], [3.0, 1.0], [1.0, -1.0]]), square), [True, False, False])
