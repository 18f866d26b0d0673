"""Beats of known shape are measured to a tenth of a frame, whatever the frame rate, the drift and the sign of time."""

import numpy as np
import pytest

from microbundle.data import Beats
from microbundle.waveform import beat_shapes

PERIOD_S, FIRST_S, COUNT = 1.0, 0.37, 4


def cosine(t):
    """A beat that is as fast up as down, from -0.25 to 0.25 s."""
    return np.where(np.abs(t) < 0.25, 0.5 + 0.5 * np.cos(np.pi * t / 0.25), 0.0)


def skewed(t):
    """A beat that rises in 0.2 s and falls in 0.4 s."""
    x = np.clip((t + 0.2) / 0.6, 0, 1)
    return (x * 3) ** 2 * ((1 - x) * 1.5) ** 4


def bell(t):
    """A smooth beat without a first moment."""
    return np.exp(-0.5 * (t / 0.09)**2)


def train(shape, t):
    return sum(shape(t - FIRST_S - i * PERIOD_S) for i in range(-1, COUNT + 1))


def beats_of(signal, fps):
    """Beats cut half way between peaks, at rest where the true signal is near zero."""
    t = np.arange(len(signal)) / fps
    peak = [round((FIRST_S + i * PERIOD_S) * fps) for i in range(COUNT)]
    start = [max(0, round(p - 0.37 * PERIOD_S * fps)) for p in peak]
    stop = [s + round(PERIOD_S * fps) for s in start]
    stop[-1] = min(stop[-1], len(t))
    none = np.zeros((0, 2))
    return Beats(signal, 0.0, np.array(start), np.array(peak), np.array(stop), np.ones(COUNT, bool), signal < 1e-6,
                 none, np.zeros((COUNT, 0, 2)), "known")


def truth(shape):
    """Definitions of docs/metrics.md, applied to the exact curve, in seconds."""
    t = np.linspace(-0.5, 0.63, 200_001)
    y = shape(t)
    top = int(np.argmax(y))
    up, down = t[:top + 1], t[top:]

    def rise(x):
        return np.interp(x, y[:top + 1], up)

    def fall(x):
        return np.interp(-x, -y[top:], down)

    slope = np.gradient(y, t)
    steepest = int(np.argmax(slope))
    return {
        "onset_time": t[steepest] - y[steepest] / slope[steepest],
        "amplitude": y[top], "time_to_peak": t[top] - rise(0.1), "relax50": fall(0.5) - t[top],
        "relax90": fall(0.1) - t[top], "t_up_20_80": rise(0.8) - rise(0.2), "t_down_80_20": fall(0.2) - fall(0.8),
        "cd10": fall(0.9) - rise(0.9), "cd50": fall(0.5) - rise(0.5), "cd90": fall(0.1) - rise(0.1),
        "area": np.trapezoid(y, t), "half_rise_time": rise(0.5), "peak_time": t[top],
        "contraction_velocity": slope.max(), "relaxation_velocity": slope.min(),
        "mean_contraction_velocity": 0.8 * y[top] / (rise(0.9) - rise(0.1)),
    }


TIMES = ("time_to_peak", "relax50", "relax90", "t_up_20_80", "t_down_80_20", "cd10", "cd50", "cd90")
SIZES = {"amplitude": 0, "area": 1, "contraction_velocity": -1, "relaxation_velocity": -1,
         "mean_contraction_velocity": -1}
"""Metrics of size, with the power of time in their unit."""


def measured(signal, fps, **settings):
    return beat_shapes(signal[:, None], np.arange(len(signal), dtype=float), beats_of(signal, fps), **settings)


@pytest.mark.parametrize("shape", [cosine, bell, skewed])
@pytest.mark.parametrize("fps", [20, 30, 60, 200])
def test_times_are_right_to_a_tenth_of_a_frame(shape, fps):
    t = np.arange(int((FIRST_S + COUNT * PERIOD_S) * fps)) / fps
    found, exact = measured(train(shape, t), fps), truth(shape)
    for name in TIMES:
        np.testing.assert_allclose(found[name][1:3, 0], exact[name] * fps, atol=0.1, err_msg=name)
    for name in ("peak_time", "half_rise_time", "onset_time"):
        at = (FIRST_S + PERIOD_S * np.arange(COUNT) + exact[name]) * fps
        np.testing.assert_allclose(found[name][1:3, 0], at[1:3], atol=0.1, err_msg=name)
    for name, power in SIZES.items():
        # A slope is a mean over a frame, which at 20 frames/s blunts the steepest one.
        limit = 0.005 if name in ("amplitude", "area") or fps > 60 else 0.05
        np.testing.assert_allclose(found[name][1:3, 0], exact[name] * fps**power, rtol=limit, err_msg=name)


def test_diastole_is_from_the_fall_to_the_next_onset():
    t, exact = np.arange(430) / 100, truth(skewed)
    found = measured(train(skewed, t), 100)
    fall = exact["relax90"] + exact["peak_time"]
    np.testing.assert_allclose(found["diastolic_interval"][1:3, 0], 100 * (PERIOD_S + exact["onset_time"] - fall),
                               atol=0.2)
    assert np.isnan(found["diastolic_interval"][-1, 0])


def test_drift_within_a_beat_changes_nothing():
    t = np.arange(130) / 30
    plain = train(skewed, t)
    both = np.stack([plain, plain + 0.004 * np.arange(130)], axis=1)
    found = beat_shapes(both, np.arange(130.0), beats_of(plain, 30))
    for name in (*TIMES, *SIZES):
        np.testing.assert_allclose(found[name][1:3, 1], found[name][1:3, 0], rtol=1e-6, err_msg=name)


def test_uneven_frame_times_are_followed():
    steps = np.random.default_rng(3).uniform(0.7, 1.3, 260)
    clock = np.cumsum(steps) - steps[0]
    signal = train(bell, clock / 60)
    found = beat_shapes(signal[:, None], clock, beats_at(clock / 60, signal))
    exact = truth(bell)
    for name in TIMES:
        np.testing.assert_allclose(found[name][1:3, 0], exact[name] * 60, atol=0.1, err_msg=name)


def beats_at(time_s, signal):
    """Beats cut at known times."""
    peaks = FIRST_S + PERIOD_S * np.arange(COUNT)
    edges = np.searchsorted(time_s, np.append(peaks, peaks[-1] + PERIOD_S) - 0.37 * PERIOD_S)
    none = np.zeros((0, 2))
    return Beats(signal, 0.0, edges[:-1], np.searchsorted(time_s, peaks), np.minimum(edges[1:], len(signal)),
                 np.ones(COUNT, bool), signal < 1e-6, none, np.zeros((COUNT, 0, 2)), "known")


def test_what_a_movie_does_not_show_is_nan():
    t = np.arange(130) / 30
    signal = train(cosine, t)
    beats = beats_of(signal.copy(), 30)
    signal[60:75] = np.nan  # half of the third beat
    found = beat_shapes(np.stack([signal, np.full(130, np.nan)], axis=1), np.arange(130.0), beats)
    assert np.isnan(found["cd50"][:, 1]).all()
    assert np.isnan(found["amplitude"][2, 0])
    assert np.isfinite(found["cd50"][0, 0])
    rising = beat_shapes(np.arange(40.0)[:, None], np.arange(40.0), cut_at(40))
    assert np.isnan(rising["amplitude"]).all()
    assert np.isnan(rising["cd90"]).all()


def cut_at(count):
    one = np.array([0])
    return Beats(np.zeros(count), 0.0, one, one + count - 1, one + count, np.zeros(1, bool), np.zeros(count, bool),
                 np.zeros((0, 2)), np.zeros((1, 0, 2)), "known")
