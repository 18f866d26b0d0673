"""Other tools' columns: their definitions on signals whose numbers are known, and their names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from scipy.signal import peak_widths

from microbundle import ConfigError, analyze, compat_columns, read_movie, tables
from microbundle.analysis import Analysis
from microbundle.compat import NUMBERS, SIGNALS
from microbundle.compat_definitions import TOOLS, ToolName, names
from microbundle.compat_trace import Trace
from microbundle.config import Config
from microbundle.dictionary import BY_KEY, IDENTITY

from .known_pillars import DEPTH, PEAK_PX, UM, K, with_pillars

RISE, FALL, PEAKS, LENGTH = 10, 20, (20, 70, 120), 160


def triangles(*, tail: float = 0.0, scale: float = 1.0) -> Trace:
    """Three triangular beats 50 frames apart, 10 frames up and 20 down, 2 high, on a floor that rises by `tail` in the
    course of each fall; a frame lasts `scale`."""
    t = np.arange(LENGTH)
    values = np.zeros(LENGTH)
    for n, peak in enumerate(PEAKS):
        up, down = (t - (peak - RISE)) / RISE, 1 - (t - peak) / FALL
        values += 2 * np.clip(np.minimum(up, down), 0, 1)
        values += tail * np.clip((t - peak) / FALL, 0, 1) * (n == 1)
    edges = np.array([5, 50, 100, 150])
    return Trace("drawn", "um", values, t * scale, edges[:-1], edges[1:], np.ones(3, bool))


def test_a_beat_is_told_by_its_peak_and_valleys() -> None:
    trace = triangles()
    assert list(trace.peak) == list(PEAKS)
    assert trace.usable.all()
    assert len(trace.valley) == 4
    assert (trace.values[trace.valley] == 0).all()
    assert replace(trace, whole=np.array([True, False, True])).usable.tolist() == [True, False, True]


def test_musclemotion_counts_whole_frames_from_the_lowest_before_the_peak() -> None:
    trace = triangles(scale=10.0)
    bent = replace(trace, values=2 * (trace.values / 2) ** 0.99)  # no frame lies on a level
    found = NUMBERS["musclemotion"](bent)
    # the first of three frames below 10, 50 and 90 % of the height, from the peak outwards
    np.testing.assert_allclose(found["Time-to-peak ({time})"], 100)
    np.testing.assert_allclose(found["Relaxation Time ({time})"], 190)
    np.testing.assert_allclose(found["Contraction duration [10% above baseline] ({time})"], 290)
    np.testing.assert_allclose(found["50-to-50 transient ({time})"], 60 + 110)
    np.testing.assert_allclose(found["10-to-10 transient ({time})"], 20 + 30)
    np.testing.assert_array_equal(found["Peak-to-peak time ({time})"], [np.nan, 500, 500])
    np.testing.assert_allclose(found["Contraction amplitude ({size})"], 2)
    lifted = NUMBERS["musclemotion"](replace(triangles(), values=triangles().values + 0.5))
    np.testing.assert_allclose(lifted["Baseline value ({size})"], 0.5)
    np.testing.assert_allclose(lifted["Peak amplitude ({size})"], 2.5)


def test_beatprofiler_takes_shares_of_the_prominence() -> None:
    found = NUMBERS["beatprofiler"](triangles(scale=0.1))
    np.testing.assert_allclose(found["fwhm [{time}]"], 1.5)
    np.testing.assert_allclose(found["contract50 [{time}]"], 0.5)
    np.testing.assert_allclose(found["relax90 [{time}]"], 1.8)
    np.testing.assert_allclose(found["tau [{time}]"], 2 * (1 - np.exp(-1)))
    np.testing.assert_allclose(found["raw amplitude [{size}]"], 2)
    np.testing.assert_allclose(found["contraction speed [{size}/{per}]"], 2)
    np.testing.assert_allclose(found["relaxation speed [{size}/{per}]"], 1)
    np.testing.assert_array_equal(found["beat index"], PEAKS)
    # where the floor rises by half of the height, the prominence is above the higher valley
    assert NUMBERS["beatprofiler"](triangles(tail=1.0))["raw amplitude [{size}]"][1] == pytest.approx(1)


def test_pulse3d_measures_each_side_from_its_own_valley() -> None:
    found = NUMBERS["pulse3d"](triangles(scale=0.1))
    np.testing.assert_array_equal(found["Twitch Period ({time})"], [5, 5, np.nan])
    np.testing.assert_allclose(found["Twitch Width 50 ({time})"], 1.5)
    np.testing.assert_allclose(found["Twitch Width 90 ({time})"], 2.7)
    np.testing.assert_allclose(found["Time From Contraction 10 to Peak ({time})"], 0.9)
    np.testing.assert_allclose(found["Time From Peak to Relaxation 90 ({time})"], 1.8)
    np.testing.assert_allclose(found["Twitch Contraction Velocity ({size}/{per})"], 2)
    np.testing.assert_allclose(found["Twitch Relaxation Velocity ({size}/{per})"], 1)
    np.testing.assert_allclose(found["Area Under Curve ({size} * {per})"], 0.5 * 2.7 * 1.8)
    np.testing.assert_array_equal(found["Twitch Interval Irregularity ({time})"], [np.nan, 0, np.nan])
    uneven = NUMBERS["pulse3d"](triangles(tail=1.0))
    np.testing.assert_allclose(uneven["{amplitude} ({size})"], [2, 1.5, 2])
    np.testing.assert_allclose(uneven["Fraction of Maximum {amplitude}"], [1, 0.75, 1])
    assert uneven["Time From Peak to Relaxation 50 ({time})"][1] == pytest.approx(10)


def test_pillartrack_averages_velocity_over_three_frames() -> None:
    found = NUMBERS["pillartrack"](triangles(scale=0.1))
    np.testing.assert_allclose(found["t50 ({time})"], 1.5)
    np.testing.assert_allclose(found["t80 ({time})"], 2.4)
    np.testing.assert_allclose(found["contraction velocity ({size}/{per})"], 2)
    np.testing.assert_allclose(found["relaxation velocity ({size}/{per})"], -1)
    sharp = replace(triangles(), values=np.isin(np.arange(LENGTH), PEAKS).astype(float))
    np.testing.assert_allclose(NUMBERS["pillartrack"](sharp)["contraction velocity ({size}/{per})"], 1 / 3)


def test_times_of_the_tissue_agree_with_ours_where_it_rests(tissue_analysis: Analysis) -> None:
    ours = tables(tissue_analysis)["beats"]
    muscle, profiler, pulse = (compat_columns(tissue_analysis, tool) for tool in ("musclemotion", "beatprofiler",
                                                                                  "pulse3d"))
    np.testing.assert_allclose(muscle["Contraction amplitude (um)"], ours["amplitude_um"], rtol=0.01)
    np.testing.assert_allclose(muscle["90-to-90 transient (ms)"], 1e3 * ours["cd90_s"], atol=2e3 / 30)
    np.testing.assert_allclose(profiler["fwhm [s]"], ours["cd50_s"], rtol=0.01)
    np.testing.assert_allclose(profiler["relax90 [s]"], ours["relax90_s"], atol=0.005)
    np.testing.assert_allclose(pulse["Twitch Width 50 (seconds)"], ours["cd50_s"], rtol=0.01)
    np.testing.assert_allclose(pulse["Twitch Amplitude (um)"], ours["amplitude_um"], rtol=0.01)
    assert (muscle["signal"] == "mean absolute displacement").all()
    assert (pulse["pillar"] == "").all()


def test_pillars_of_known_motion(tissue_analysis: Analysis) -> None:
    unloaded = ((64.0, 11.0), (64.0, 181.0))
    analysis = with_pillars(tissue_analysis, unloaded=unloaded)
    width = UM * analysis.masks.axis.width_center_px
    track = compat_columns(analysis, "pillartrack")
    assert list(track["pillar"]) == ["1"] * 3 + ["2"] * 3
    np.testing.assert_allclose(track["mean absolute displacement (um)"], UM * np.repeat(PEAK_PX, 3), rtol=1e-3)
    np.testing.assert_allclose(track["pillar_force_abs (uN)"], K * UM * np.repeat(PEAK_PX, 3), rtol=1e-3)
    np.testing.assert_allclose(track["tissue_stress (MPa)"], K * UM * np.mean(PEAK_PX) / (width * DEPTH), rtol=1e-3)
    pulse = compat_columns(analysis, "pulse3d")
    np.testing.assert_allclose(pulse["Active Twitch Force (uN)"], K * UM * np.repeat(PEAK_PX, 3), rtol=1e-3)
    profiler = compat_columns(analysis, "beatprofiler")
    shorter = UM * sum(PEAK_PX)
    np.testing.assert_allclose(profiler["deflection [um]"], shorter, rtol=1e-3)
    np.testing.assert_allclose(profiler["passive length [um]"], UM * 160, rtol=1e-3)
    np.testing.assert_allclose(profiler["active length [um]"], UM * 160 - shorter, rtol=1e-3)
    np.testing.assert_allclose(profiler["active force [uN]"], 0.5 * K * shorter, rtol=1e-3)
    np.testing.assert_allclose(profiler["passive tension [uN]"], 0.5 * K * UM * 10, rtol=1e-3)
    work = 1e-3 * 0.25 * K * ((UM * 10 + shorter) ** 2 - (UM * 10) ** 2)
    np.testing.assert_allclose(profiler["work per contraction cycle [nJ]"], work, rtol=1e-3)


def test_units_and_columns_follow_what_is_known(tissue_analysis: Analysis) -> None:
    bare = replace(tissue_analysis, time_s=None, um_per_px=None)
    assert "Contraction amplitude (px)" in compat_columns(bare, "musclemotion")
    assert "Time-to-peak (frames)" in compat_columns(bare, "musclemotion")
    assert "contraction speed [px/frame]" in compat_columns(bare, "beatprofiler")
    assert "Twitch Frequency (per frame)" in compat_columns(bare, "pulse3d")
    weak = replace(with_pillars(tissue_analysis), config=Config())
    assert "pillar_force_abs (uN)" not in compat_columns(weak, "pillartrack")
    assert "active force [uN]" not in compat_columns(weak, "beatprofiler")
    assert "Twitch Amplitude (um)" in compat_columns(weak, "pulse3d")


@pytest.mark.parametrize("tool", TOOLS)
def test_without_beats_or_pillars_there_are_columns_but_no_rows(tissue_analysis: Analysis, tool: str) -> None:
    beats = tissue_analysis.beats
    none = {name: getattr(beats, name)[:0] for name in ("start", "peak", "stop", "complete", "left_out",
                                                          "beat_relaxed_px")}
    found = compat_columns(replace(tissue_analysis, beats=replace(beats, **none)), tool)
    assert len(found) == 0
    assert len(found.columns) > 5
    assert len(compat_columns(tissue_analysis, "pillartrack")) == 0


def test_a_lost_frame_is_bridged_and_a_lost_beat_left_out(tissue_analysis: Analysis) -> None:
    analysis = with_pillars(tissue_analysis)
    assert analysis.pillars is not None
    shift = analysis.pillars.shift_px.copy()
    shift[30], shift[50:66] = np.nan, np.nan
    found = compat_columns(replace(analysis, pillars=replace(analysis.pillars, shift_px=shift)), "pillartrack")
    assert found["t50 (s)"].isna().tolist() == [False, False, True] * 2
    np.testing.assert_allclose(found["t50 (s)"].dropna(), 0.2, rtol=0.02)


def test_an_unknown_tool_is_named_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match=r"found 'pulse3D'\. Did you mean 'pulse3d'"):
        compat_columns(None, "pulse3D")  # type: ignore[arg-type]


def test_every_definition_is_computed_and_every_key_exists() -> None:
    assert set(get_args(ToolName)) == set(TOOLS) == set(SIGNALS) == set(NUMBERS)
    for key, tool in TOOLS.items():
        parts = {one: f"{{{one}}}" for one in ("size", "time", "per", "rate", "amplitude")}
        defined = [name for column in tool.columns for name in names(column, **parts)]
        assert len(set(defined)) == len(defined)
        computed = set(NUMBERS[key](triangles()))
        assert computed <= set(defined)
        for column in tool.columns:
            assert column.definition
            assert column.difference
            for ours in column.ours.split(", "):
                assert not ours.isidentifier() or ours in BY_KEY or ours in IDENTITY, ours


def test_pillartrack_gives_the_published_tools_numbers(data_folder: Path, golden_folder: Path) -> None:
    """On the movie and pillar masks that come with the tool, tracked as it tracks."""
    golden = np.load(golden_folder / "mbc_pillar.npz")
    movie = read_movie(data_folder / "type1_bright", fps=30, um_per_px=4)
    settings = {"method": "paper", "reading": {"stop_frame": 100}, "pillars": {"stiffness_un_per_um": 2.677}}
    found = compat_columns(analyze(movie, Config.from_dict(settings)), "pillartrack")
    for name, rows in found.groupby("pillar"):
        theirs = golden[f"pillar{name}_abs_disp"]
        whole = rows.dropna()
        assert len(whole) >= 2
        peaks = whole["beat_peaks"].to_numpy(int)
        t50, t80 = (peak_widths(theirs, peaks, share)[0] / 30 for share in (0.5, 0.8))
        np.testing.assert_allclose(whole["t50 (s)"], t50, rtol=0.005)
        np.testing.assert_allclose(whole["t80 (s)"], t80, rtol=0.005)
        force = golden[f"pillar{name}_force_abs"][peaks]
        np.testing.assert_allclose(whole["pillar_force_abs (uN)"], force, rtol=0.005)
