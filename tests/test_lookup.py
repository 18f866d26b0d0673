"""The dictionary of metrics in words: units, places, near names, and the docs that are written from it."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

from microbundle.dictionary import METRICS
from microbundle.errors import ConfigError
from microbundle.lookup import CALIBRATED, UNCALIBRATED, all_units, as_dict, entries, entry_lines, place, units

ROOT = Path(__file__).parent.parent


@pytest.mark.parametrize(("key", "without", "known"), [
    ("amplitude", ["px"], ["px", "um"]), ("cd50", ["frames"], ["s"]), ("duty", ["1"], ["1"]),
    ("tissue_area", ["px2"], ["px2", "um2"]), ("power", ["nj_per_frame"], ["nw"]),
    ("contraction_velocity", ["px_per_frame"], ["um_per_s"]), ("tissue_angle", ["deg"], ["deg"]),
])
def test_units_without_calibration_and_with_it(key: str, without: list[str], known: list[str]) -> None:
    (metric,) = entries(key)
    assert (units(metric, UNCALIBRATED), units(metric, CALIBRATED)) == (without, known)
    assert all_units(metric) == ", ".join(dict.fromkeys(without + known))


def test_an_entry_says_where_it_is_written() -> None:
    assert place(entries("E_cc")[0]) == "subdomains.csv, and in each frame strain.csv"
    assert place(entries("E_1")[0]) == "subdomains.csv"
    assert place(entries("tissue_width")[0]) == "summary.csv"
    assert "  standard error  no" in list(entry_lines(entries("tissue_width")[0]))
    assert "  standard error  se in summary.csv" in list(entry_lines(entries("drift")[0]))


def test_a_column_leads_to_its_key() -> None:
    for name in ("force_cd50_s", "force_cd50_frames", "force_cd50_se_s"):
        assert [metric.key for metric in entries(name)] == ["force_cd50"]
    with pytest.raises(ConfigError, match=r"found 'tissue_width_se_um'\. Near: "):
        entries("tissue_width_se_um")  # has no standard error
    with pytest.raises(ConfigError, match="found ''"):
        entries("")


def test_every_entry_can_be_told() -> None:
    for metric in METRICS:
        assert all(as_dict(metric)[name] for name in ("key", "level", "written_in", "definition", "units_calibrated"))
        assert all(line.strip() for line in entry_lines(metric))


@pytest.mark.parametrize("name", ["metrics", "compat"])
def test_the_docs_are_those_of_the_program(name: str) -> None:
    script = ROOT / "benchmarks" / "write_metrics.py"
    if not script.is_file():
        pytest.skip("the benchmarks are not here")
    written = (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    assert written == runpy.run_path(str(script))[f"{name}_page"](), "run python benchmarks/write_metrics.py"
