"""Movies: they open again, show the known motion in the right colours, and hold one frame at a time."""

import json
import weakref
from dataclasses import replace

import av
import matplotlib
import numpy as np
import pytest

from microbundle import figures
from microbundle.cli import run
from microbundle.config import Config
from microbundle.data import Movie
from microbundle.errors import CannotMeasure, ConfigError, MovieUnreadable, OutputError
from microbundle.movie_frames import EDGE, HEAD, window
from microbundle.movies import save_all, write_movie
from microbundle.shown import Shown
from microbundle.style import DIVERGING, MOVIE_OVERLAY, SEQUENTIAL

from .conftest import FPS, FRAMES, SHAPE, UM_PER_PX

PEAK_FRAME = 10


def opened(path):
    """Frames (T, R, C, 3) of a movie file, and its stream's facts."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = [as_browsers_do(frame) if path.suffix == ".mp4" else frame.to_ndarray(format="rgb24")
                  for frame in container.decode(stream)]
        return np.stack(frames), float(container.duration / av.time_base), stream.codec_context


def as_browsers_do(frame):
    """Colours (R, C, 3) of a decoded frame, by the formula of the colour space that the file names: BT.709, limited."""
    assert (frame.colorspace, frame.color_range) == (1, 1)
    rows, cols = frame.height, frame.width
    planes = frame.to_ndarray(format="yuv420p").ravel().astype(np.float32)
    y, u, v = np.split(planes, [rows * cols, rows * cols * 5 // 4])
    u, v = (part.reshape(rows // 2, cols // 2).repeat(2, axis=0).repeat(2, axis=1) - 128 for part in (u, v))
    y = 1.1644 * (y.reshape(rows, cols) - 16)
    rgb = np.stack([y + 1.7927 * v, y - 0.2132 * u - 0.5329 * v, y + 2.1124 * u], axis=-1)
    return np.clip(rgb, 0, 255).round().astype(np.uint8)


def place(analysis, point_px):
    """Where a point of the image is in the frames of a movie of 320 px."""
    view = window(Shown(analysis), 320, level=False)
    row, col = np.rint(view.picture_points(np.array(point_px, float)) + np.array([HEAD, EDGE])).astype(int)
    return slice(row - 4, row + 5), slice(col - 4, col + 5)


def test_mp4_plays_everywhere(tissue_movie, tissue_analysis, tmp_path):
    path = write_movie(tissue_movie, tissue_analysis, tmp_path / "a.mp4")
    frames, duration, codec = opened(path)
    assert len(frames) == FRAMES
    assert duration == pytest.approx(FRAMES / FPS, abs=0.05)
    assert codec.name == "h264"
    assert codec.pix_fmt == "yuv420p"
    assert frames.shape[1] % 2 == 0
    assert frames.shape[2] % 2 == 0
    content = path.read_bytes()
    assert content.index(b"moov") < content.index(b"mdat")  # a browser can start at once
    assert [file.name for file in tmp_path.iterdir()] == ["a.mp4"]


def test_gif_opens_again(tissue_movie, tissue_analysis, tmp_path):
    path = write_movie(tissue_movie, tissue_analysis, tmp_path / "a.gif", beats_only=True, level=True)
    frames, duration, codec = opened(path)
    beats = tissue_analysis.beats
    count = int((beats.stop - beats.start)[beats.complete].sum())
    assert len(frames) == count
    assert duration == pytest.approx(count * 0.03, rel=0.1)
    assert codec.name == "gif"
    assert path.stat().st_size < 1_500_000
    assert (frames[:, :4] > 245).all()  # the margin is white


@pytest.mark.parametrize(("suffix", "show", "narrow", "wide", "name", "share"), [
    # Half way between the middle and the end: 1 px, that is 4 um, at the peak.
    (".mp4", "displacement", (0.0, 8.0), (0.0, 400.0), SEQUENTIAL, (0.5, 0.01)),
    (".gif", "displacement", (0.0, 8.0), (0.0, 400.0), SEQUENTIAL, (0.5, 0.01)),
    # Shortening of 2 px in 80 everywhere: E_cc = (1 / 1.025**2 - 1) / 2 = -2.41 %.
    (".mp4", "strain", (-5.0, 5.0), (-500.0, 500.0), DIVERGING, (0.259, 0.4976)),
])
def test_pixels_have_the_colour_of_the_known_motion(tissue_movie, tissue_analysis, tmp_path, show, narrow, wide, name,
                                                    share, suffix):
    """The difference between two scales of colour leaves the picture below out."""
    point = (SHAPE[0] / 2 - 4, SHAPE[1] / 2 - 0.5 + (40 if show == "displacement" else 6))
    seen = []
    for k, limits in enumerate((narrow, wide)):
        path = write_movie(tissue_movie, tissue_analysis, tmp_path / f"{k}{suffix}", show=show, limits=limits,
                           longest_px=320)
        rows, cols = place(tissue_analysis, point)
        seen.append(opened(path)[0][PEAK_FRAME, rows, cols].astype(float).mean(axis=(0, 1)))
    colours = [255 * np.array(matplotlib.colormaps[name](x))[:3] for x in share]
    assert seen[0] - seen[1] == pytest.approx(MOVIE_OVERLAY * (colours[0] - colours[1]), abs=8)


def test_tiles_and_colours_move_with_the_tissue(tissue_movie, tissue_analysis):
    """The tissue's end moves inward by 2 px; the edge of the coloured part goes with it."""
    from microbundle.movie_frames import Painter

    shown = Shown(tissue_analysis)
    view = window(shown, 640, level=False)
    paint = Painter(tissue_movie, shown, "displacement", view, (0.0, 8.0))
    ends = []
    for t in (0, PEAK_FRAME):
        picture = paint(t, tissue_movie.frames[t])[HEAD:HEAD + view.shape[0], EDGE:EDGE + view.shape[1]]
        row = int(view.picture_points(np.array([SHAPE[0] / 2, 0.0]))[0])
        coloured = np.ptp(picture[row - 8:row + 9].astype(int), axis=2).mean(axis=0)
        there = int(view.picture_points(np.array([0.0, SHAPE[1] / 2 + 70]))[1])
        ends.append(float(np.flatnonzero(coloured > 0.5 * coloured[there])[-1]))
    assert (ends[0] - ends[1]) * view.step == pytest.approx(2.0, abs=0.6)


def test_level_turns_the_tissue(tissue_analysis):
    axis = replace(tissue_analysis.masks.axis, direction=np.array([np.sin(0.2), np.cos(0.2)]))
    turned = replace(tissue_analysis, masks=replace(tissue_analysis.masks, axis=axis))
    view = window(Shown(turned), 400, level=True)
    along = view.picture_points(axis.center_px + 30 * axis.direction) - view.picture_points(axis.center_px)
    assert along == pytest.approx([0, 30 / view.step], abs=1e-9)
    assert np.allclose(view.picture_points(view.image_points(np.array([[3.0, 5.0]]))), [[3.0, 5.0]])


class Counted:
    """Frames that know how many of them are alive at once."""

    def __init__(self, array, repeat=1, fail_at=None):
        self.array, self.repeat, self.fail_at = array, repeat, fail_at
        self.alive, self.most = [], 0

    def __len__(self):
        return len(self.array) * self.repeat

    def __getitem__(self, index):
        if index == self.fail_at:
            raise MovieUnreadable("frame 40: damaged")
        frame = self.array[index % len(self.array)].copy()
        self.alive = [ref for ref in self.alive if ref() is not None] + [weakref.ref(frame)]
        self.most = max(self.most, len(self.alive))
        return frame


def counted_movie(tissue_array, **how):
    frames = Counted(tissue_array, **how)
    return Movie(name="counted", frames=frames, shape=SHAPE, time_s=np.arange(len(frames)) / FPS,
                 um_per_px=UM_PER_PX), frames


def test_frames_are_held_one_at_a_time(tissue_array, tissue_analysis, tmp_path):
    movie, frames = counted_movie(tissue_array)
    write_movie(movie, tissue_analysis, tmp_path / "a.mp4")
    assert frames.most <= 2


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_nothing_is_left_on_failure(tissue_array, tissue_analysis, tmp_path, suffix):
    movie, _ = counted_movie(tissue_array, fail_at=40)
    with pytest.raises(MovieUnreadable, match="damaged"):
        write_movie(movie, tissue_analysis, tmp_path / f"a{suffix}")
    assert list(tmp_path.iterdir()) == []


def test_files_are_not_replaced_unasked(tissue_movie, tissue_analysis, tmp_path):
    path = tmp_path / "a.gif"
    path.write_text("mine")
    with pytest.raises(OutputError, match="expected a new file"):
        write_movie(tissue_movie, tissue_analysis, path)
    assert path.read_text() == "mine"
    with pytest.raises(OutputError, match="cannot be written"):
        write_movie(tissue_movie, tissue_analysis, path / "below" / "b.gif")


def test_wrong_arguments_are_named(tissue_array, tissue_movie, tissue_analysis, tmp_path):
    with pytest.raises(ConfigError, match="ends in"):
        write_movie(tissue_movie, tissue_analysis, tmp_path / "a.avi")
    with pytest.raises(ConfigError, match="show: expected"):
        write_movie(tissue_movie, tissue_analysis, tmp_path / "a.mp4", show="stress")
    with pytest.raises(ConfigError, match="lower first"):
        write_movie(tissue_movie, tissue_analysis, tmp_path / "a.mp4", limits=(1, 1))
    with pytest.raises(ConfigError, match="the one that was analyzed"):
        write_movie(counted_movie(tissue_array, repeat=2)[0], tissue_analysis, tmp_path / "a.mp4")
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_shown_is_told(tissue_movie, tissue_analysis, tmp_path):
    beats = replace(tissue_analysis.beats, complete=np.zeros(len(tissue_analysis.beats), bool))
    with pytest.raises(CannotMeasure, match="no whole beat"):
        write_movie(tissue_movie, replace(tissue_analysis, beats=beats), tmp_path / "a.mp4", beats_only=True)
    left_out = save_all(tissue_movie, replace(tissue_analysis, strain=None), tmp_path / "movies")
    assert list(left_out) == ["strain"]
    assert [file.name for file in (tmp_path / "movies").iterdir()] == ["displacement.mp4"]


def test_the_cuts_of_the_analysis_are_made_again(tissue_movie, tissue_analysis, tmp_path):
    config = Config.from_dict({"reading": {"first_frame": 5}})
    part = replace(
        tissue_analysis, config=config, time_s=tissue_analysis.time_s[5:],
        tracks=replace(tissue_analysis.tracks, position_px=tissue_analysis.tracks.position_px[5:],
                       ok=tissue_analysis.tracks.ok[5:], field=None, residual=None),
        beats=replace(tissue_analysis.beats, signal_px=tissue_analysis.beats.signal_px[5:],
                      relaxed=tissue_analysis.beats.relaxed[5:], peak=tissue_analysis.beats.peak - 5))
    path = write_movie(tissue_movie, part, tmp_path / "a.mp4", fps=10)
    frames, duration, _ = opened(path)
    assert len(frames) == FRAMES - 5
    assert duration == pytest.approx((FRAMES - 5) / 10, abs=0.1)


def test_the_command_line_writes_pictures_into_the_result(tissue_folder, tmp_path, capsys, monkeypatch):
    some = ("displacement", "force", "quality")
    monkeypatch.setattr(figures, "KINDS", {kind: figures.KINDS[kind] for kind in some})
    out = tmp_path / "out"
    arguments = ["analyze", str(tissue_folder), "--out", str(out), "--method", "fast", "--no-report"]
    assert run([*arguments, "--figures", "--movies"]) == 0
    told = capsys.readouterr().out
    assert "no figure force: no pillars were followed" in told
    assert sorted(file.name for file in (out / "movies").iterdir()) == ["displacement.mp4", "strain.mp4"]
    drawn = {file.name for file in (out / "figures").iterdir()}
    assert drawn == {"displacement.png", "displacement.pdf", "quality.png", "quality.pdf"}
    listed = json.loads((out / "microbundle.json").read_text())["files"]  # so that --overwrite may replace them
    assert {"figures/quality.png", "movies/strain.mp4"} <= set(listed)
