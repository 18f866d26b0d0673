"""A second signal: known calcium-like beats, their errors, and the delay of the contraction."""

import numpy as np
import pytest

from microbundle.dictionary import METRICS, columns
from microbundle.errors import CannotMeasure, MovieUnreadable
from microbundle.trace import cut_trace, mean_trace, read_trace, trace_delays, trace_table, trace_values

from .conftest import FPS, PERIOD_FRAMES
from .test_waveform import skewed, truth

BASE, RISE = 200.0, 0.5


def calcium(fps=100.0, beats=6, noise=0.0, bleaching=0.0, late=0.0, period=0.8, seed=0):
    """Times and values of beats of dF/F0 = 0.5, with peaks at 0.4, 1.2, 2.0, ... s."""
    t = np.arange(int(beats * period * fps)) / fps
    course = sum(skewed(t - 0.4 - late - i * period) for i in range(beats + 1))
    value = BASE * (1 - bleaching * t) * (1 + RISE * course)
    return t, value + noise * np.random.default_rng(seed).standard_normal(len(t))


@pytest.mark.parametrize("bleaching", [0.0, 0.02])
def test_a_known_trace(bleaching):
    trace = cut_trace("calcium", *calcium(bleaching=bleaching))
    whole = trace.beats.complete
    values, _ = trace_values(trace)
    exact = truth(skewed)
    np.testing.assert_allclose(values["trace_amplitude"][whole], RISE, rtol=0.02)
    np.testing.assert_allclose(values["trace_cd50"][whole], 100 * exact["cd50"], atol=0.5)
    np.testing.assert_allclose(values["trace_relax90"][whole], 100 * exact["relax90"], atol=1.0)
    np.testing.assert_allclose(values["trace_period"][whole][:-1], 80, atol=0.2)


def test_dips_are_beats_where_they_are_said_to_be():
    t, value = calcium()
    trace = cut_trace("voltage", t, 2 * BASE - value, inverted=True)
    assert trace.beats.complete.sum() == cut_trace("calcium", t, value).beats.complete.sum()
    np.testing.assert_allclose(trace_values(trace)[0]["trace_amplitude"][trace.beats.complete], RISE, rtol=0.02)


def test_intervals_hold_the_truth():
    """Over noisy traces an interval of 95 % of each time holds the truth in most cases."""
    held = {name: [] for name in ("time_to_peak", "cd50", "relax50", "t_down_80_20")}
    exact = truth(skewed)
    for seed in range(25):
        trace = cut_trace("calcium", *calcium(noise=2.0, seed=seed))
        values, errors = trace_values(trace)
        for name, hits in held.items():
            away = np.abs(values[f"trace_{name}"] - 100 * exact[name])[trace.beats.complete]
            hits += (away < 2.04 * errors[f"trace_{name}"][trace.beats.complete]).tolist()
    for name, hits in held.items():
        assert 0.80 < np.mean(hits) <= 1, name


def test_columns_are_those_of_the_dictionary(tissue_analysis):
    table = trace_table(cut_trace("calcium", *calcium()), tissue_analysis)
    levels = {"trace_cd10", "trace_cd50", "trace_cd90"} | {m.key for m in METRICS if not m.key.startswith("trace_cd")}
    entries = [m for m in METRICS if m.level == "trace" and m.key in levels]
    known = {name for m in entries for e in ((False, True) if m.error else (False,))
             for name, _ in columns(m, None, 0.01, error=e)}
    assert set(table.columns) - {"beat", "complete"} == known


def test_delay_of_the_contraction(tissue_analysis):
    """The small tissue beats every 0.8 s with peaks near frames 10, 34 and 58; the trace runs 50 ms ahead."""
    t, _ = calcium()
    first = 10 / FPS - 0.05
    peaks = first + np.arange(8) * PERIOD_FRAMES / FPS
    value = BASE * (1 + RISE * np.exp(-0.5 * ((t[:, None] - peaks) / 0.06) ** 2).sum(axis=1))
    found = trace_delays(cut_trace("calcium", t, value), tissue_analysis)["contraction_delay_peak"]
    assert np.isfinite(found).sum() >= 2
    np.testing.assert_allclose(found[np.isfinite(found)], 0.05, atol=0.01)


def test_noise_is_no_beat():
    t = np.arange(500) / 100
    trace = cut_trace("noise", t, 100 + np.random.default_rng(4).standard_normal(500))
    assert len(trace.beats) == 0
    assert trace.findings[0].key == "no_beats"
    assert len(trace_table(trace)) == 0


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_tables_are_read(tmp_path, separator):
    t, value = calcium(beats=2)
    lines = [separator.join(("time_s", "F"))] + [f"{a}{separator}{b}" for a, b in zip(t, value, strict=True)]
    (tmp_path / "trace.csv").write_text("\n".join(lines))
    time_s, read = read_trace(tmp_path / "trace.csv")
    np.testing.assert_allclose(time_s, t)
    np.testing.assert_allclose(read, value)


def test_one_column_needs_a_rate(tmp_path):
    (tmp_path / "trace.txt").write_text("F\n" + "\n".join(f"{v:.3f}" for v in calcium()[1]))
    with pytest.raises(MovieUnreadable, match="--fps"):
        read_trace(tmp_path / "trace.txt")
    assert read_trace(tmp_path / "trace.txt", fps=50)[0][1] == pytest.approx(0.02)


def test_bad_traces_are_refused(tmp_path, tissue_movie):
    with pytest.raises(MovieUnreadable, match="nothing"):
        read_trace(tmp_path / "nothing.csv")
    with pytest.raises(CannotMeasure, match="at least 8"):
        cut_trace("short", np.arange(4.0), np.ones(4))
    with pytest.raises(CannotMeasure, match="times that grow"):
        cut_trace("backwards", np.array([0, 1, 2, 3, 3, 4, 5, 6, 7.0]), np.ones(9))
    with pytest.raises(CannotMeasure, match="mask"):
        mean_trace(tissue_movie, np.ones((3, 3), bool))


def test_a_second_channel_is_averaged_over_the_mask(tissue_movie):
    mask = np.zeros(tissue_movie.shape, bool)
    mask[40:80, 60:130] = True
    time_s, value = mean_trace(tissue_movie, mask)
    assert len(time_s) == tissue_movie.count
    assert value[5] == pytest.approx(np.asarray(tissue_movie.frames[5])[mask].mean())
