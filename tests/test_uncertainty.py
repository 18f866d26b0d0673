"""Standard errors: against the errors that are really made, on movies whose motion is known."""

import numpy as np
import pytest

from microbundle import Config, analyze
from microbundle.metrics import tables
from microbundle.synth.cases import Analytic, Case, camera
from microbundle.synth.scores import compare
from microbundle.uncertainty import alternatives, displacement_error_at, standard_errors

ENOUGH = 2.04
"""Standard errors from 32 draws to either side that hold 95 %."""


@pytest.fixture(scope="module")
def noisy():
    """A movie of 0.8 px with camera noise: the result, and its comparison with the truth."""
    case = Case("noisy", "noisy", Analytic(0.8, 5, shape=(160, 256), frames=100, side_px=60.0),
                camera(5, electrons=4_000, read=0.005))
    made = case.make().drawn()
    analysis = analyze(made.movie)
    return analysis, compare(made, analysis, case.domain)


def test_displacement_is_as_wrong_as_it_says(noisy):
    analysis, found = noisy
    points = found.domain.points_px.reshape(-1, 2)
    error = displacement_error_at(analysis, points)
    assert error.shape == (analysis.frame_count, len(points), 2)
    peaks = [window[np.argmax(found.mad[0][window])] for window in found.windows]
    away = np.abs(found.beat_error_px[peaks]) / error[peaks]
    assert 0.8 < (away < ENOUGH).mean() <= 1
    assert 0.5 < np.sqrt(np.nanmean(away**2)) < 1.5


def test_strain_is_as_wrong_as_it_says(noisy):
    analysis, found = noisy
    true, seen = found.own_ecc
    error = standard_errors(analysis, lambda a: {"E": a.strain.E[..., 1, 1]})["E"]
    peaks = [window[np.argmax(found.mad[0][window])] for window in found.windows]
    away = np.abs(seen - true)[peaks] / error[peaks]
    assert np.isfinite(away).any()
    assert np.nanmean(away < ENOUGH) > 0.8
    assert np.nanmean(away < 0.1) < 0.5, "the errors are far too large"


def test_more_noise_gives_larger_errors(noisy):
    quiet = Case("quiet", "clean", Analytic(0.8, 5, shape=(160, 256), frames=100, side_px=60.0), camera(5))
    result = analyze(quiet.make().drawn().movie)
    less, more = (tables(a)["beats"]["e_cc_peak_se"].mean() for a in (result, noisy[0]))
    assert more > 1.3 * less > 0


def test_alternatives_are_results_around_the_result(noisy):
    analysis, _ = noisy
    others = list(alternatives(analysis))
    assert len(others) == 32
    position = np.mean([o.tracks.position_px for o in others], axis=0)
    np.testing.assert_allclose(position, analysis.tracks.position_px, atol=0.05)
    assert all(np.abs(o.tracks.position_px - analysis.tracks.position_px).max() > 0 for o in others)
    assert not list(alternatives(others[0])), "an alternative has none of its own"


def test_alternatives_can_be_repeated(noisy):
    one, other = (next(iter(alternatives(noisy[0]))) for _ in range(2))
    np.testing.assert_array_equal(one.tracks.position_px, other.tracks.position_px)
    np.testing.assert_array_equal(one.strain.F, other.strain.F)


def test_noise_pushes_a_mean_of_lengths_up(noisy):
    frames = tables(noisy[0])["frames"]
    rest = frames["relaxed"]
    raw, corrected = (frames[f"mean_absolute_displacement{c}_px"][rest].mean() for c in ("", "_corrected"))
    assert abs(corrected) < raw


def test_a_method_that_does_not_know_its_errors_gives_none(tissue_movie):
    result = analyze(tissue_movie, Config(method="fast"))
    assert list(alternatives(result)) == []
    assert np.isnan(displacement_error_at(result, np.array([[64.0, 96.0]]))).all()
