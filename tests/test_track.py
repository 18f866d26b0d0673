"""Following markers: known shifts, flicker, hidden parts and large motion."""

import cv2
import numpy as np
import pytest

from microbundle.axis import measure_axis
from microbundle.config import Config
from microbundle.data import Masks, Movie, Tracks
from microbundle.markers import place_markers
from microbundle.reference import find_relaxed_frame
from microbundle.scaling import movie_scaling
from microbundle.track import track_markers

SHAPE = (120, 200)
FRAMES = 24


def masks() -> Masks:
    tissue = np.zeros(SHAPE, bool)
    tissue[25:95, 20:180] = True
    return Masks(tissue, measure_axis(tissue), "supplied")


def bump() -> np.ndarray:
    """One slow beat (T,), 0 at both ends and 1 in the middle."""
    return np.sin(np.pi * np.arange(FRAMES) / (FRAMES - 1)) ** 2


def shifted_frames(shift_px, seed: int = 0) -> np.ndarray:
    """Frames (T, R, C) of a picture shifted by (T, 2), exact by Fourier, as float."""
    grain = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=SHAPE), (0, 0), 1.6)
    spectrum = np.fft.fft2(20000 + 4000 * grain / grain.std())
    r, c = np.meshgrid(np.fft.fftfreq(SHAPE[0]), np.fft.fftfreq(SHAPE[1]), indexing="ij")
    rng = np.random.default_rng(seed + 1)
    frames = [np.fft.ifft2(spectrum * np.exp(-2j * np.pi * (r * a + c * b))).real for a, b in shift_px]
    return np.stack(frames) + rng.normal(0, 100, (len(frames), *SHAPE))


def movie(frames: np.ndarray) -> Movie:
    return Movie.from_array(np.clip(frames, 0, 65535).astype(np.uint16), fps=30)


def follow(movie: Movie, config: Config | None = None, reference: int = 0) -> Tracks:
    config = config or Config()
    markers = place_markers(movie, masks(), reference, config)
    return track_markers(movie, masks(), markers, config, lambda _: None)


def misses(tracks: Tracks, shift_px: np.ndarray) -> np.ndarray:
    """Distance (T, N) of each position from where it should be."""
    moved = tracks.position_px - tracks.position_px[tracks.reference_frame]
    return np.hypot(*np.moveaxis(moved - (shift_px - shift_px[tracks.reference_frame])[:, None], -1, 0))


@pytest.mark.parametrize("size", [0.05, 1.0, 8.0])
def test_shift_is_followed(size):
    shift = bump()[:, None] * np.array([0.6, 0.8]) * size
    tracks = follow(movie(shifted_frames(shift)))
    off = misses(tracks, shift)
    assert tracks.lost_fraction < 0.05
    assert np.nanmedian(off) < 0.03
    assert np.nanquantile(off, 0.99) < 0.12
    assert tracks.findings == ()


def test_errors_do_not_add_up_over_many_beats():
    shift = np.tile(bump(), 6)[:, None] * np.array([0.0, 3.0])
    off = misses(follow(movie(shifted_frames(shift))), shift)
    assert np.nanmedian(off[-FRAMES:]) < 0.03


def test_flicker_does_not_move_points():
    shift = bump()[:, None] * np.array([0.0, 1.5])
    frames = shifted_frames(shift)
    gain = 1 + 0.15 * np.random.default_rng(5).uniform(-1, 1, FRAMES)
    off = misses(follow(movie(frames * gain[:, None, None])), shift)
    assert np.nanmedian(off) < 0.03


def test_hot_pixel_in_every_second_frame_does_not_move_points():
    shift = bump()[:, None] * np.array([0.0, 1.5])
    frames = shifted_frames(shift)
    frames[::2, 4, 4] = 65535
    off = misses(follow(movie(frames)), shift)
    assert np.nanmedian(off) < 0.03


def test_hidden_points_are_lost_and_the_others_are_not():
    shift = bump()[:, None] * np.array([0.0, 1.0])
    frames = shifted_frames(shift)
    hidden = slice(6, 14)
    blot = cv2.GaussianBlur(np.random.default_rng(9).normal(size=(50, 50)), (0, 0), 1.6)
    frames[hidden, 35:85, 80:130] = 15000 + 9000 * blot / np.abs(blot).max()
    tracks = follow(movie(frames))
    at = tracks.position_px[0]
    under = (np.abs(at[:, 0] - 60) < 15) & (np.abs(at[:, 1] - 105) < 15)
    clear = (np.abs(at[:, 0] - 60) > 40) | (np.abs(at[:, 1] - 105) > 45)
    assert under.sum() > 10
    assert (~tracks.ok[hidden][:, under]).mean() > 0.9
    assert tracks.ok[:, clear].mean() > 0.95
    assert tracks.ok[20:, under].mean() > 0.9  # found again
    assert np.isnan(tracks.position_px[~tracks.ok]).all()
    assert np.isfinite(tracks.position_px[tracks.ok]).all()
    assert np.nanquantile(misses(tracks, shift)[:, clear], 0.99) < 0.15


def test_points_that_leave_are_not_counted_as_followed():
    """A strip that turns into other texture altogether is lost, and the result says so."""
    frames = shifted_frames(np.zeros((FRAMES, 2)))
    frames[8:, :, 100:] = shifted_frames(np.zeros((FRAMES - 8, 2)), seed=50)[:, :, 100:]
    tracks = follow(movie(frames))
    gone = tracks.position_px[0][:, 1] > 120
    assert (~tracks.ok[8:][:, gone]).mean() > 0.9
    assert "markers_lost" in {f.key for f in tracks.findings}


def test_one_wild_point_does_not_widen_the_window():
    shift = bump()[:, None] * np.array([0.0, 1.5])
    frames = shifted_frames(shift)
    plain = follow(movie(frames)).window_px
    rng = np.random.default_rng(3)
    for t in range(2, FRAMES):  # a glint that dances around
        r, c = rng.integers(40, 80), rng.integers(60, 140)
        frames[t, r:r + 5, c:c + 5] = 60000
    assert follow(movie(frames)).window_px == plain


def test_given_window_is_used():
    frames = shifted_frames(np.zeros((6, 2)))
    assert follow(movie(frames), Config.from_dict({"tracking": {"window_px": 31}})).window_px == 31


def test_any_reference_frame_gives_the_same_motion():
    shift = bump()[:, None] * np.array([0.0, 2.0])
    for reference in (0, 10, FRAMES - 1):
        off = misses(follow(movie(shifted_frames(shift)), reference=reference), shift)
        assert np.nanmedian(off) < 0.04


def test_number_format_does_not_matter():
    shift = bump()[:, None] * np.array([0.0, 1.5])
    frames = shifted_frames(shift)
    for changed, limit in ((frames.astype(np.uint16), 0.03), ((frames / 160).astype(np.uint8), 0.06),
                           ((frames / 65536).astype(np.float32), 0.03), (frames - 20000, 0.03)):
        assert np.nanmedian(misses(follow(Movie.from_array(changed)), shift)) < limit


def test_relaxed_frame_is_one_of_those_at_rest():
    beat = np.concatenate([bump()[FRAMES // 2:], np.zeros(8), bump(), np.zeros(8)])  # starts contracted
    x = np.arange(SHAPE[1]) - 99.5
    grain = shifted_frames(np.zeros((1, 2)))[0].astype(np.float32)
    rows = np.mgrid[:SHAPE[0], :SHAPE[1]][0].astype(np.float32)
    frames = np.stack([cv2.remap(grain, np.broadcast_to(x / (1 - 0.03 * a) + 99.5, SHAPE).astype(np.float32), rows,
                                 cv2.INTER_CUBIC) for a in beat])
    chosen = find_relaxed_frame(movie(frames), masks(), Config())
    assert beat[chosen] < 0.1
    assert find_relaxed_frame(movie(frames), masks(), Config.from_dict({"tracking": {"reference_frame": 5}})) == 5
    assert find_relaxed_frame(movie(frames), masks(), Config(method="paper")) == 0


def test_scaling_undoes_flicker_and_ignores_what_lies_outside():
    frames = shifted_frames(np.zeros((8, 2)))
    still = movie(frames)
    scale = movie_scaling(still, masks().tissue)
    frames[4] *= 1.2
    frames[5, 2, 2] = 65535
    changed = movie(frames)
    again = movie_scaling(changed, masks().tissue)
    inside = again.tissue
    for t in (4, 5):
        difference = again(changed.frames[t]).astype(float) - scale(still.frames[t])
        assert np.abs(difference[inside]).mean() < 4
    assert (again.origin <= (25, 20)).all()
