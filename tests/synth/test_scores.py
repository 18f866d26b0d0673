"""Scores are zero for the truth itself, and as large as the spoiling for a spoiled truth."""

from dataclasses import replace

import numpy as np
import pytest

from microbundle.synth.cases import Case, camera
from microbundle.synth.scenes import Analytic, Domain
from microbundle.synth.scores import compare, r_squared, score
from microbundle.synth.truth import cut, true_beats

from .stand_in import StandIn

SMALL = Analytic(1.2, 3, shape=(128, 224), frames=84, side_px=40.0, inclusion=True)
ERRORS = ("mad_error_pct", "ecc_mae_pct", "rmse_px", "gain_pct", "drift_error_px", "period_error_pct",
          "peak_error_frames", "missed_beats", "extra_beats", "lost_pct")


def case(scene=SMALL):
    return Case("small", "clean, > 1 px", scene)


@pytest.fixture(scope="module")
def perfect():
    return StandIn.perfect(case().make())


def scored(analysis, scene=SMALL, domain=None):
    return score(compare(analysis.synthetic, analysis, domain or case(scene).domain))


@pytest.mark.parametrize("scene", [
    SMALL, replace(SMALL, angle_deg=20.0, turn_deg=2.0), replace(SMALL, drift_px=(0.02, -0.03)),
    replace(SMALL, first_beat=-0.2, variation=0.15), replace(SMALL, mad_px=0.1)])
def test_a_perfect_analysis_has_no_error(scene):
    scores = scored(StandIn.perfect(case(scene).make()), scene)
    for name in ERRORS:
        # On a stage that moves, the relaxed place of a point is known from a sample of the relaxed frames only.
        moves = scene.turn_deg or any(scene.drift_px)
        assert abs(getattr(scores, name)) < (0.02 if moves else 1e-3), name
    assert scores.mad_r2 > 1 - 1e-6
    assert scores.ecc_r2 > 1 - 1e-5
    assert scores.covered_pct == 100
    assert scores.true_beats >= 2


def test_amplitude_is_what_the_case_says():
    scores = scored(StandIn.perfect(case(replace(SMALL, variation=0.0)).make()))
    assert scores.true_mad_px == pytest.approx(1.2, rel=0.02)


def test_a_gain_error_is_found_in_full(perfect):
    scores = scored(perfect.spoiled(lambda u: 1.1 * u))
    assert scores.gain_pct == pytest.approx(10.0, abs=1e-3)
    assert scores.mad_error_pct == pytest.approx(10.0, abs=1e-3)
    assert 1 < scores.ecc_mae_pct < 10


def test_a_shifted_or_transposed_truth_scores_badly(perfect):
    transposed = scored(perfect.spoiled(lambda u: u[..., ::-1]))
    assert transposed.rmse_px > 0.4
    assert transposed.ecc_r2 < 0.2
    assert abs(transposed.gain_pct) > 50
    backwards = scored(perfect.spoiled(lambda u: -u))
    assert backwards.gain_pct == pytest.approx(-200, abs=1e-3)
    assert backwards.ecc_r2 < 0
    late = scored(perfect.spoiled(lambda u: np.roll(u, 2, axis=0)))
    assert late.mad_r2 < 0.9
    # The same field one sub-domain to the right.
    moved = replace(case().domain, center_px=(case().domain.center_px[0], case().domain.center_px[1] + 20.0))
    other = compare(perfect.synthetic, perfect, moved)
    here = compare(perfect.synthetic, perfect, case().domain)
    swapped = replace(here, found_px=other.found_px, mad=(here.mad[0], other.mad[1]), ecc=(here.ecc[0], other.ecc[1]))
    assert score(swapped).ecc_mae_pct > 5


def test_drift_of_the_measurement_is_found(perfect):
    t = np.arange(perfect.frame_count)[:, None, None]
    scores = scored(perfect.spoiled(lambda u: u + 0.01 * t * [1.0, 0.0]))
    rests = np.flatnonzero(true_beats(perfect.synthetic.truth).resting)
    assert 0.3 * 0.01 * np.ptp(rests) < scores.drift_error_px < 0.01 * np.ptp(rests)


def test_a_wrong_relaxed_state_is_an_error(perfect):
    beats = perfect.beats
    relaxed = beats.relaxed.copy()
    relaxed[beats.peak - 1] = True
    assert abs(scored(replace(perfect, beats=replace(beats, relaxed=relaxed))).mad_error_pct) > 3


def test_points_without_measurement_are_counted(perfect):
    def half(u):
        u = u.copy()
        u[:, :u.shape[1] // 3] = np.nan
        return u

    scores = scored(perfect.spoiled(half))
    assert 60 < scores.covered_pct < 70
    assert scores.rmse_px < 1e-3
    nothing = scored(perfect.spoiled(lambda u: np.full(u.shape, np.nan)))
    assert np.isnan(nothing.mad_error_pct)
    assert np.isnan(nothing.rmse_px)


def test_missed_extra_and_late_beats(perfect):
    beats = perfect.beats

    def with_beats(keep, late=0):
        return replace(perfect, beats=replace(
            beats, start=beats.start[keep], peak=beats.peak[keep] + late, stop=beats.stop[keep],
            complete=beats.complete[keep], left_out=beats.left_out[keep],
            beat_relaxed_px=beats.beat_relaxed_px[keep]))

    assert scored(with_beats([0, 2])).missed_beats == beats.complete.sum() - 2
    assert scored(with_beats([0, 1, 1, 2])).extra_beats == 1
    late = scored(with_beats([0, 1, 2], 3))
    assert late.peak_error_frames == pytest.approx(3, abs=1)


def test_a_movie_that_rests_has_no_errors_but_false_beats(perfect):
    still = Case("still", "motionless", replace(SMALL, mad_px=0.0), camera(1))
    rest = StandIn.perfect(still.make())
    assert scored(rest).extra_beats == 0
    assert scored(rest).rmse_px == 0
    assert scored(replace(rest, beats=perfect.beats)).extra_beats == perfect.beats.complete.sum()


def test_true_beats_of_a_clipped_cosine_with_noise():
    phase = np.linspace(0, 2 * np.pi * 5, 200)
    signal = np.clip(-np.cos(phase), 0.1, None) - 0.1 + 0.004 * np.random.default_rng(0).standard_normal(200)
    beats = cut(np.abs(signal))
    assert len(beats) == 5
    np.testing.assert_allclose(beats.peak, (np.arange(5) + 0.5) * 199 / 5, atol=2)
    assert beats.complete.all()
    assert 0.3 < beats.resting.mean() < 0.6


def test_r_squared_and_the_domain():
    true = np.array([0.0, 1.0, 2.0])
    assert r_squared(true, true) == 1
    assert r_squared(true, np.full(3, 1.0)) == 0
    assert np.isnan(r_squared(np.ones(3), true))
    points = Domain((50.0, 60.0), 40.0, 90.0).points_px
    assert points.shape == (4, 25, 2)
    np.testing.assert_allclose(points.reshape(-1, 2).mean(axis=0), (50, 60))
    # Turned by 90 degrees clockwise, the second sub-domain lies below the first.
    np.testing.assert_allclose(points[1].mean(axis=0) - points[0].mean(axis=0), (20, 0), atol=1e-9)
