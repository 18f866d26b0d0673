"""Figures: every kind is drawn, with units, limits and reasons."""

from dataclasses import replace
from itertools import pairwise

import matplotlib
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from microbundle import figures
from microbundle.errors import CannotMeasure, ConfigError, OutputError
from microbundle.shown import Shown
from microbundle.style import DIVERGING, SEQUENTIAL

from .conftest import FPS, PEAK_PX, SHAPE, UM_PER_PX
from .known_pillars import PEAK_PX as PILLAR_PX
from .known_pillars import K, with_pillars


@pytest.fixture(scope="module")
def full(tissue_analysis):
    """A result that has data for every kind but delays."""
    return with_pillars(tissue_analysis, noise_px=0.01)


def texts(figure):
    return " | ".join(text.get_text() for text in figure.findobj(Text) if text.get_text())


def image_values(figure):
    """Values of the colour map that lies over the picture."""
    picture = figure.axes[0]
    return np.ma.filled(picture.images[-1].get_array().astype(float), np.nan), picture.images[-1]


@pytest.mark.parametrize("kind", [kind for kind in figures.KINDS if kind != "delay"])
def test_every_kind_draws_and_no_text_is_cut_off_or_covered(full, kind):
    figure = figures.draw(full, kind)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    width, height = canvas.get_width_height()
    named = [text for text in figure.findobj(Text) if text.get_text().strip() and text.get_visible()]
    assert named
    ticks = {label for axes in figure.axes for label in (*axes.get_xticklabels(), *axes.get_yticklabels())}
    boxes = [(text, text.get_window_extent()) for text in set(named) - ticks]
    for k, (text, box) in enumerate(boxes):
        assert box.x0 > -1, text
        assert box.y0 > -1, text
        assert box.x1 < width + 1, text
        assert box.y1 < height + 1, text
        for other, its in boxes[:k]:
            wide, high = (min(a, b) - max(c, d) for a, b, c, d in
                          ((box.x1, its.x1, box.x0, its.x0), (box.y1, its.y1, box.y0, its.y0)))
            assert min(wide, high) < 1.5, (text, other)


def test_units_follow_the_calibration(full):
    known = texts(figures.draw(full, "displacement"))
    assert "Displacement (µm)" in known
    assert "µm" in texts(figures.draw(full, "tissue"))
    assert "Time (s)" in texts(figures.draw(full, "signal"))
    assert "Force (µN)" in texts(figures.draw(full, "force"))
    bare = replace(full, um_per_px=None, time_s=None)
    unknown = texts(figures.draw(bare, "displacement"))
    assert "Displacement (px)" in unknown
    assert "µm" not in unknown
    assert "Time (frames)" in texts(figures.draw(bare, "signal"))


def test_the_scale_bar_is_as_long_as_it_says(full):
    figure = figures.draw(full, "tissue")
    axes = figure.axes[0]
    bar = next(line for line in axes.lines if line.get_linewidth() == 1.8)
    share = float(np.ptp(bar.get_xdata()))
    size = next(float(text.get_text().split()[0]) for text in axes.texts if "µm" in text.get_text())
    assert share * abs(np.subtract(*axes.get_xlim())) * UM_PER_PX == pytest.approx(size)


def test_the_map_shows_the_known_displacement(full):
    values, image = image_values(figures.draw(full, "displacement_col"))
    left, right, bottom, top = image.get_extent()
    middle = SHAPE[1] / 2 - 0.5
    row = int((SHAPE[0] / 2 - top) / (bottom - top) * values.shape[0])
    for col in (56.0, 120.0, 136.0):
        seen = values[row, int((col - left) / (right - left) * values.shape[1])]
        rest = (col - middle) / 80
        assert seen == pytest.approx(-PEAK_PX * UM_PER_PX * rest / (1 + PEAK_PX / 80), abs=0.25)
    assert image.get_cmap().name == DIVERGING
    assert image_values(figures.draw(full, "displacement"))[1].get_cmap().name == SEQUENTIAL


def test_limits_are_symmetric_given_or_shared(full):
    low, high = image_values(figures.draw(full, "displacement_col"))[1].get_clim()
    assert low == -high
    assert image_values(figures.draw(full, "displacement", limits=(0, 3)))[1].get_clim() == (0, 3)
    assert figures.draw(full, "beats", limits=(-1, 9)).axes[0].get_ylim() == (-1, 9)
    large = replace(full, um_per_px=3 * UM_PER_PX)
    shared = figures.shared_limits([full, large])
    assert shared["displacement"] == figures.shared_limits([large])["displacement"]
    assert shared["displacement"][1] > figures.shared_limits([full])["displacement"][1]
    assert "tissue" not in shared
    assert "delay" not in shared


def test_shared_limits_need_one_unit(full):
    with pytest.raises(ConfigError, match="one unit"):
        figures.shared_limits([full, replace(full, um_per_px=None)], ["displacement"])


def test_kinds_without_data_are_left_out_with_a_reason(tissue_analysis, full, tmp_path):
    bare = replace(tissue_analysis, pillars=None, strain=None)
    kinds = ["tissue", "force", "pillar_displacement", "strain_cc", "quality"]
    saved = figures.save_all(bare, tmp_path, formats=("png", "svg"), kinds=kinds)
    assert [file.name for file in saved.files] == ["tissue.png", "tissue.svg", "quality.png", "quality.svg"]
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted(file.name for file in saved.files)
    assert saved.left_out == {"force": "no pillars were followed", "pillar_displacement": "no pillars were followed",
                              "strain_cc": "no sub-domain has a strain"}
    with pytest.raises(CannotMeasure, match="no pillars"):
        figures.draw(bare, "force")
    assert "half a frame" in figures.why_not(full, "delay")
    assert "stiffness" in figures.why_not(replace(full, config=tissue_analysis.config), "force")
    beats = full.beats
    none = replace(beats, start=beats.start[:0], peak=beats.peak[:0], stop=beats.stop[:0],
                   complete=beats.complete[:0], left_out=beats.left_out[:0],
                   beat_relaxed_px=beats.beat_relaxed_px[:0])
    still = replace(full, beats=none)
    assert figures.why_not(still, "displacement") == "the movie has no beats"
    assert figures.draw(still, "signal").axes


def test_numbers_in_the_strain_map_are_those_of_the_result(full):
    strain = full.strain
    shown = 100 * strain.E[full.beats.peak[full.beats.complete]].mean(axis=0)[:, 1, 1]
    written = texts(figures.draw(full, "strain_cc"))
    for value in shown:
        assert f"{value:+.1f}".replace("-", "−") in written
    assert shown.mean() == pytest.approx(-2.4, abs=0.3)


def test_colours_of_sub_domains_follow_their_strain(full):
    figure = figures.draw(full, "strain_cc", limits=(-5, 5))
    tiles = figure.axes[0].collections[0].get_facecolors()
    value = Shown(full).strain[0, 1, 1] * 100
    assert tuple(tiles[0][:3]) == pytest.approx(matplotlib.colormaps[DIVERGING]((value + 5) / 10)[:3])


def test_force_is_deflection_times_stiffness(full):
    force = figures.draw(full, "force").axes[0]
    tops = sorted((float(line.get_ydata().max()) for line in force.lines), reverse=True)
    assert tops == pytest.approx([K * UM_PER_PX * px for px in PILLAR_PX], rel=0.05)
    assert len(force.collections) == 2  # a band for each pillar


def test_one_beat_and_a_width_can_be_asked_for(full):
    figure = figures.draw(full, "displacement", beat=1, width_mm=120)
    assert "beat 1" in texts(figure)
    assert figure.get_figwidth() * 25.4 == pytest.approx(120)
    with pytest.raises(ConfigError, match="beat: expected"):
        figures.draw(full, "displacement", beat=99)


def test_wrong_arguments_are_named(full, tmp_path):
    with pytest.raises(ConfigError, match="kinds: expected"):
        figures.draw(full, "displacemet")
    with pytest.raises(ConfigError, match="lower first"):
        figures.draw(full, "displacement", limits=(3, 0))
    with pytest.raises(ConfigError, match="formats"):
        figures.save_all(full, tmp_path, formats=("bmp",))
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        figures.save_all(full, tmp_path / "file" / "below", kinds=["quality"])


def test_the_worst_finding_stands_first(full):
    order = [text.get_text() for text in figures.draw(full, "quality").axes[0].texts]
    levels = [text for text in order[1:] if text in ("fail", "review", "info")]
    assert levels == sorted(levels, key=["fail", "review", "info"].index)
    assert order[0] == full.verdict


def test_fast_results_draw_too(full):
    """Results without a field or errors: the markers are interpolated."""
    plain = replace(full, tracks=replace(full.tracks, field=None))
    figure = figures.draw(plain, "displacement")
    values, _ = image_values(figure)
    field, _ = image_values(figures.draw(full, "displacement"))
    both = np.isfinite(values) & np.isfinite(field)
    assert np.abs(values - field)[both].mean() < 0.25
    assert "standard error" not in texts(figures.draw(plain, "strain_cc_series"))
    assert "standard error" in texts(figures.draw(full, "strain_cc_series"))


def test_the_delay_map_shows_known_delays(full):
    """The strain of each column of sub-domains comes two frames after that of the column before."""
    rows, cols = full.strain.grid
    late = 2 * np.tile(np.arange(cols), rows)
    F = np.stack([np.roll(full.strain.F[:, s], late[s], axis=0) for s in range(len(late))], axis=1)
    shown = Shown(replace(full, strain=replace(full.strain, F=F)))
    assert shown.delay * FPS == pytest.approx(late - np.median(late), abs=0.3)
    figure = figures.draw(shown.analysis, "delay")
    assert "Delay (ms)" in texts(figure)
    assert f"{1e3 * shown.delay[0]:+.0f}".replace("-", "−") in texts(figure)


def test_a_tissue_that_stands_upright_keeps_its_title_and_remarks(full):
    """The picture is narrow then, and the figure as wide as ever."""
    tissue = full.masks.tissue & (np.abs(np.arange(SHAPE[1]) - 96) < 14)
    upright = replace(full, masks=replace(full.masks, tissue=tissue), pillars=None)
    for kind in ("displacement", "principal", "tissue"):
        figure = figures.draw(upright, kind)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        boxes = [text.get_window_extent() for text in figure.axes[0].findobj(Text) if text.get_text().strip()]
        assert max(box.x1 for box in boxes) < canvas.get_width_height()[0] + 1
        below = sorted((box.x0, box.x1) for box in boxes if box.y1 < figure.axes[0].get_window_extent().y0)
        assert all(right <= left + 1 for (_, right), (left, _) in pairwise(below))
