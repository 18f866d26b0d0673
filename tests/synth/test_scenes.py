"""Scenes: a solution is computed once and kept, the sheet and the bundle move as much as they say."""

from dataclasses import replace

import numpy as np
import pytest

from microbundle.synth import scenes
from microbundle.synth.cases import Case
from microbundle.synth.scenes import Analytic, Sheet, cache_folder, painted


def test_a_solution_is_kept_in_the_cache_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("MICROBUNDLE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(scenes, "_solved", {})
    case = Case("sheet", "clean, sub-pixel", Sheet(1, frames=30))
    case.scene.prepare()
    (file,) = (tmp_path / "cache" / "solutions").iterdir()
    made = case.make()
    mad = made.truth.mad_px(case.domain.points_px.reshape(-1, 2))
    assert 0.1 < mad.max() < 2
    assert made.movie.frames[13].shape == (300, 560)

    # Another process finds it there; a damaged file is solved anew.
    def never(*_, **__):
        raise AssertionError("solved again")

    monkeypatch.setattr(scenes, "_solved", {})
    monkeypatch.setattr(scenes, "solve_membrane", never)
    case.scene.prepare()
    file.write_bytes(b"damaged")
    monkeypatch.setattr(scenes, "_solved", {})
    with pytest.raises(AssertionError, match="solved again"):
        case.scene.prepare()


def test_the_cache_folder_is_the_users_choice(monkeypatch, tmp_path):
    monkeypatch.setenv("MICROBUNDLE_CACHE", str(tmp_path))
    assert cache_folder() == tmp_path
    monkeypatch.delenv("MICROBUNDLE_CACHE")
    assert cache_folder().parts[-1] in ("microbundle", "Cache")


@pytest.mark.parametrize("change", [{}, {"inclusion": True}, {"angle_deg": 30.0}, {"delay_frames": 5.0}])
def test_an_analytic_scene_moves_by_its_amplitude(change):
    scene = replace(Analytic(0.7, 4, shape=(160, 224), frames=60, side_px=40.0, variation=0.0), **change)
    picture = scene.picture()
    motion, stage = scene.motion(picture)
    points = scene.domain(picture).points_px.reshape(-1, 2)
    assert stage is None
    assert picture.tissue[tuple(np.rint(points).astype(int).T)].all()
    mad = [np.hypot(*motion.displacement_px(points, t).T).mean() for t in range(60)]
    assert max(mad) == pytest.approx(0.7, rel=0.03)


def test_rows_are_cut_from_the_middle():
    whole, part = painted((224, 224), 3), painted((128, 224), 3)
    np.testing.assert_array_equal(part.image, whole.image[48:176])
    assert part.center_px == (whole.center_px[0] - 48, whole.center_px[1])
    assert part.tissue.any()
    assert (part.body & ~part.tissue).any()
