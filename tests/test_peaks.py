"""Peaks are those that scipy finds, on signals of every kind."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal as scipy_signal

from microbundle.peaks import find_peaks

LEVELS = st.lists(st.integers(-5, 5), max_size=60)
"""Few levels, so that there are plateaus and peaks of one height."""


@given(LEVELS, st.floats(0, 6), st.floats(1, 12))
def test_peaks_of_coarse_signals_are_those_of_scipy(levels: list[int], prominence: float, distance: float) -> None:
    signal = np.array(levels, float)
    found = find_peaks(signal, prominence=prominence, distance=distance)
    expected, _ = scipy_signal.find_peaks(signal, prominence=prominence, distance=distance)
    assert found.tolist() == expected.tolist()


@given(st.integers(0, 2**32 - 1), st.floats(0, 3), st.floats(1, 30))
def test_peaks_of_noisy_beats_are_those_of_scipy(seed: int, prominence: float, distance: float) -> None:
    rng = np.random.default_rng(seed)
    signal = np.sin(np.arange(200) / rng.uniform(2, 20)) + rng.normal(0, rng.uniform(0, 1), 200)
    found = find_peaks(signal, prominence=prominence, distance=distance)
    expected, _ = scipy_signal.find_peaks(signal, prominence=prominence, distance=distance)
    assert found.tolist() == expected.tolist()
