"""From the tables of a run to those of a comparison: wells, groups, pairs, doses, Prism, figures, command line."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import microbundle
from microbundle import cli
from microbundle.errors import ConfigError, OutputError, ResultUnreadable
from microbundle.figures_comparison import axis_label, spread
from microbundle.statistics.wells import comparable, natural_control, read_run
from microbundle.statistics.write import write_into

from .runs import write_run

Captured = pytest.CaptureFixture[str]
Rows = list[dict[str, Any]]


def grouped(plates: int = 3, wells: int = 4, groups: tuple[str, ...] = ("control", "drug")) -> Rows:
    """All groups on each plate, with effects that differ from plate to plate."""
    rng = np.random.default_rng(5)
    return [{"group": group, "plate": f"P{p + 1}", "well": f"{'ABC'[g]}{w + 1}",
             "amplitude_um": 20 + 5 * p - 4 * g + rng.normal()}
            for p in range(plates) for g, group in enumerate(groups) for w in range(wells)]


def phased(plates: int = 3) -> Rows:
    """Wells before and after, in two groups; the drug takes away 5."""
    rng = np.random.default_rng(6)
    return [{"group": group, "plate": f"P{p}", "well": f"{'AB'[g]}{w}", "phase": phase,
             "amplitude_um": 20 + 3 * p - 5 * g * (phase == "after") + rng.normal()}
            for p in range(plates) for g, group in enumerate(("vehicle", "drug")) for w in range(3)
            for phase in ("before", "after")]


def dosed(plates: int = 2, spread_of_wells: float = 0.5) -> Rows:
    """A compound from 20 down to 8 with an EC50 of 0.3 um, and its vehicle."""
    rng = np.random.default_rng(7)
    return [{"plate": f"P{p}", "well": f"{'ABCDEFGH'[d]}{w}", "compound": "X" if dose else "DMSO", "dose_um": dose,
             "amplitude_um": 20 + 4 * p - (12 / (1 + 0.3 / dose) if dose else 0) + rng.normal(0, spread_of_wells)}
            for p in range(plates) for d, dose in enumerate((0, 0.01, 0.03, 0.1, 0.3, 1, 3, 10)) for w in range(3)]


def one(table: pd.DataFrame, **wanted: Any) -> pd.Series[Any]:
    """The one row that is wanted."""
    for name, value in wanted.items():
        table = table[table[name] == value]
    assert len(table) == 1
    return table.iloc[0]


def cells(file: Path) -> list[list[str]]:
    with file.open(newline="") as stream:
        return list(csv.reader(stream))


# --- wells ----------------------------------------------------------------------------------------------------------


def test_a_well_that_was_filmed_twice_is_one_well(tmp_path: Path) -> None:
    rows = grouped()
    again = {**rows[0], "movie": "again.tif", "amplitude_um": rows[0]["amplitude_um"] + 2}
    run = read_run(write_run(tmp_path, [*rows, again]))
    assert len(run.wells) == len(rows)
    assert (run.wells[0].movies, run.wells[0].values["amplitude_um"]) == (2, rows[0]["amplitude_um"] + 1)


def test_movies_that_do_not_count_are_left_out_and_listed(tmp_path: Path) -> None:
    rows = grouped()
    rows[0]["state"] = "failed"
    rows[1]["verdict"] = "fail"
    rows[2]["verdict"] = "review"
    write_run(tmp_path, rows)
    usual, strict = microbundle.compare(tmp_path), microbundle.compare(tmp_path, only_pass=True)
    assert usual.tables["left_out"].to_numpy().tolist() == [["m0.tif", "no result: NoTissue"],
                                                            ["m1.tif", "verdict fail"]]
    assert strict.tables["left_out"]["reason"].tolist()[-1] == "verdict review"
    assert one(usual.tables["comparison"], group="control")["n_wells"] == 10
    assert one(strict.tables["comparison"], group="control")["n_wells"] == 9
    assert any("2 movies are left out" in note for note in usual.notes)


def test_without_a_column_well_each_movie_is_one(tmp_path: Path) -> None:
    rows = [{name: value for name, value in row.items() if name != "well"} for row in grouped()]
    run = read_run(write_run(tmp_path, rows))
    assert len(run.wells) == len(rows)
    assert run.notes == ("no column well: each movie counts as a well of its own",)


def test_wells_of_one_name_on_several_days_are_pointed_out(tmp_path: Path) -> None:
    rows = [{**row, "day": day} for row in grouped() for day in (5, 7)]
    assert any("compare them with --pair day" in note for note in read_run(write_run(tmp_path / "a", rows)).notes)
    paired = read_run(write_run(tmp_path / "b", rows), pair="day", before="5", after="7")
    assert paired.notes == ()
    assert not paired.has_days


def test_metrics_are_the_key_metrics_without_pixels(tmp_path: Path) -> None:
    rows = [{**row, "amplitude_px": 1, "tissue_width_px": 2} for row in grouped()]
    write_run(tmp_path, rows, ("tissue_width_px", "amplitude_px", "amplitude_um"))
    assert read_run(tmp_path).metrics == ("tissue_width_px", "amplitude_um")
    assert read_run(tmp_path, metrics=["amplitude_px"]).metrics == ("amplitude_px",)


@pytest.mark.parametrize(("groups", "control"), [
    (("drug", "DMSO", "Vehicle"), "Vehicle"), (("b2", "b10"), "b2"), (("x", "control"), "control")])
def test_the_control_is_found_by_its_name(groups: tuple[str, ...], control: str) -> None:
    assert natural_control(groups) == control


def test_columns_by_which_a_run_is_compared() -> None:
    assert comparable(["plate", "group"])
    assert comparable(["Phase"])
    assert comparable(["dose_um"])
    assert not comparable(["plate", "well", "day"])


# --- groups ---------------------------------------------------------------------------------------------------------


def test_groups_are_compared_by_plates(tmp_path: Path) -> None:
    rows = grouped()
    found = microbundle.compare(write_run(tmp_path, rows))
    table = pd.DataFrame(rows)
    means = table.groupby(["plate", "group"])["amplitude_um"].mean().unstack()
    row = one(found.tables["comparison"], group="drug")
    assert row["p"] == pytest.approx(stats.ttest_rel(means["drug"], means["control"]).pvalue)
    assert row["difference"] == pytest.approx((means["drug"] - means["control"]).mean())
    assert row["ratio"] == pytest.approx(math.exp(np.log(table["amplitude_um"]).groupby(table["group"]).mean().diff()
                                                  .iloc[-1]))
    assert (row["n_wells"], row["n_plates"], row["n_days"], row["unit"], row["p_holm"]) == (12, 3, 1, "plate", row["p"])
    own = table.loc[table["group"] == "drug", "amplitude_um"]
    assert (row["mean"], row["sd"]) == pytest.approx((own.mean(), own.std()))
    assert found.control == "control"
    assert any("compared with control" in note for note in found.notes)


def test_another_column_and_control(tmp_path: Path) -> None:
    rows = [{**row, "line": row.pop("group")} for row in grouped(groups=("wild type", "mutant", "rescue"))]
    found = microbundle.compare(write_run(tmp_path, rows), by="line", control="mutant")
    table = found.tables["comparison"]
    assert table["group"].tolist() == ["mutant", "rescue", "wild type"]
    assert set(table["control"]) == {"mutant"}
    adjusted = table["p_holm"].to_numpy()[1:]
    assert adjusted.min() == pytest.approx(2 * table["p"].min())


def test_groups_that_are_numbers_stand_by_their_size(tmp_path: Path) -> None:
    found = microbundle.compare(write_run(tmp_path, dosed()), by="dose_um")
    assert found.tables["comparison"]["group"].tolist() == ["0", "0.01", "0.03", "0.1", "0.3", "1", "3", "10"]
    assert found.control == "0"


def test_a_group_of_one_well_is_not_estimable(tmp_path: Path) -> None:
    rows = [*grouped(), {"group": "odd", "plate": "P1", "well": "H1", "amplitude_um": 3.0}]
    row = one(microbundle.compare(write_run(tmp_path, rows)).tables["comparison"], group="odd")
    assert row["reason"].startswith("a single well")
    assert np.isnan([row["difference"], row["p"], row["ratio"], row["sd"]]).all()
    assert row["mean"] == 3


# --- pairs ----------------------------------------------------------------------------------------------------------


def test_pairs_are_compared_within_wells(tmp_path: Path) -> None:
    rows = phased()
    found = microbundle.compare(write_run(tmp_path, rows))
    table = pd.DataFrame(rows).pivot(index=["group", "plate", "well"], columns="phase", values="amplitude_um")
    change = (table["after"] - table["before"]).groupby(["group", "plate"]).mean().unstack(0)
    drug, vehicle = (one(found.tables["paired"], group=group) for group in ("drug", "vehicle"))
    assert drug["p"] == pytest.approx(stats.ttest_1samp(change["drug"], 0).pvalue)
    assert drug["change_high_95"] < 0
    assert drug["difference_p"] == pytest.approx(stats.ttest_rel(change["drug"], change["vehicle"]).pvalue)
    assert drug["difference"] == pytest.approx((change["drug"] - change["vehicle"]).mean())
    assert np.isnan(vehicle["difference"])
    assert vehicle["difference_reason"] == ""
    assert one(found.tables["comparison"], group="drug", phase="before")["n_wells"] == 9


def test_wells_without_their_other_half_are_listed(tmp_path: Path) -> None:
    found = microbundle.compare(write_run(tmp_path, phased()[:-1]))
    assert found.tables["left_out"].to_numpy().tolist() == [["P2 B2 drug", "only before in column phase"]]
    assert one(found.tables["paired"], group="drug")["n_wells"] == 8


def test_pairs_by_another_column_without_groups(tmp_path: Path) -> None:
    rows = [{"plate": row["plate"], "well": row["well"], "state_of": {"before": "t0", "after": "t1"}[row["phase"]],
             "amplitude_um": row["amplitude_um"]} for row in phased()]
    rows.append({**rows[0], "state_of": "t2"})
    found = microbundle.compare(write_run(tmp_path, rows), pair="state_of", before="t0", after="t1")
    assert set(found.tables) == {"paired", "wells", "left_out"}
    assert one(found.tables["paired"], group="")["n_wells"] == 18
    assert found.tables["left_out"]["reason"].tolist() == ["column state_of is t2"]


# --- doses ----------------------------------------------------------------------------------------------------------


def test_a_dose_response_on_several_plates(tmp_path: Path) -> None:
    found = microbundle.compare(write_run(tmp_path, dosed()))
    row = one(found.tables["dose_response"], compound="X")
    assert row["ec50_low_95"] < 0.3 < row["ec50_high_95"]
    assert row["ec50"] == pytest.approx(0.3, rel=0.3)
    assert (row["dose_unit"], row["n_doses"], row["n_wells"], row["n_plates"], row["unit"]) == ("um", 8, 48, 2, "plate")
    assert row["df"] == 16 - 2 - 3
    assert row["hill"] < 0


def test_vehicle_counts_for_every_compound_and_empty_doses_for_none(tmp_path: Path) -> None:
    rows = dosed(plates=1)
    rows += [{**row, "well": "z" + row["well"], "compound": "Y"} for row in rows if row["dose_um"]]
    rows.append({"plate": "P0", "well": "Q1", "compound": "X", "dose_um": "", "amplitude_um": 1.0})
    table = microbundle.compare(write_run(tmp_path, rows)).tables["dose_response"]
    assert table["compound"].tolist() == ["X", "Y"]
    assert table["n_wells"].tolist() == [24, 24]
    assert one(table, compound="X")["ec50"] == pytest.approx(one(table, compound="Y")["ec50"])


def test_groups_that_hold_several_doses_have_curves_of_their_own(tmp_path: Path) -> None:
    """Two lines, of which one answers to a fifth of the dose; and groups that are doses, which share a curve."""
    rows = [{"group": line, "plate": "P1", "well": f"{line}{d}{w}", "dose_nm": dose, "amplitude_um":
             20 - (12 / (1 + ec50 / dose) if dose else 0) + np.random.default_rng(100 * d + w).normal(0, 0.5)}
            for line, ec50 in (("A", 0.5), ("B", 0.1)) for d, dose in enumerate((0, 0.01, 0.03, 0.1, 0.3, 1, 3, 10))
            for w in range(3)]
    table = microbundle.compare(write_run(tmp_path / "lines", rows)).tables["dose_response"]
    assert table["group"].tolist() == ["A", "B"]
    assert table["n_wells"].tolist() == [24, 24]
    assert table["ec50"].tolist() == pytest.approx([0.5, 0.1], rel=0.3)
    named = [{**row, "group": f"d{row['dose_nm']}"} for row in rows[:24]]
    table = microbundle.compare(write_run(tmp_path / "named", named)).tables["dose_response"]
    assert table["group"].tolist() == [""]
    assert table["ec50"].tolist() == pytest.approx([0.5], rel=0.3)


def test_a_line_called_wt_keeps_its_wells_of_dose_0_for_itself(tmp_path: Path) -> None:
    rows = [{**row, "group": group, "compound": "X"} for row in dosed(plates=1) for group in ("WT", "mutant")]
    table = microbundle.compare(write_run(tmp_path, rows)).tables["dose_response"]
    assert table["n_wells"].tolist() == [24, 24]


def test_a_group_of_dose_0_alone_counts_for_all(tmp_path: Path) -> None:
    rows = [{**row, "group": "none given" if row["dose_um"] == 0 else "X"} for row in dosed(plates=1)]
    row = one(microbundle.compare(write_run(tmp_path, rows)).tables["dose_response"])
    assert (row["group"], row["n_doses"]) == ("X", 8)


def test_wells_with_several_doses_each_have_their_own_offset(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    offsets = rng.normal(0, 5, 6)
    rows = [{"well": f"A{w}", "dose": dose, "amplitude_um": offsets[w] + 30 - (12 / (1 + 0.3 / dose) if dose else 0)
             + rng.normal(0, 0.4)} for w in range(6) for dose in (0, 0.01, 0.1, 0.3, 1, 10)]
    row = one(microbundle.compare(write_run(tmp_path, rows)).tables["dose_response"])
    assert (row["unit"], row["df"]) == ("well", 36 - 6 - 3)
    assert row["ec50"] == pytest.approx(0.3, rel=0.2)


def test_a_flat_response_is_not_estimable(tmp_path: Path) -> None:
    rows = [{**row, "amplitude_um": np.random.default_rng(i).normal(10, 1)} for i, row in enumerate(dosed())]
    row = one(microbundle.compare(write_run(tmp_path, rows)).tables["dose_response"])
    assert row["reason"].startswith("flat")
    assert row["p_flat"] > 0.05
    assert math.isnan(row["ec50"])


# --- errors ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("rows", "given", "said"), [
    (grouped, {"by": "strain"}, "--by strain: .* has no such column; it has group, plate, well"),
    (grouped, {"control": "water"}, "--control water: column group has no such value; it has control, drug"),
    (grouped, {"metrics": ["amplitude"]}, "--metric amplitude: the run has no such metric. Near: amplitude_um"),
    (grouped, {"pair": "plate"}, "--before is missing; column plate has P1, P2, P3"),
    (grouped, {"pair": "plate", "before": "P1", "after": "P9"}, "--after P9: column plate has no such value"),
    (grouped, {"pair": "plate", "before": "P1", "after": "P1"}, "expected two values of column plate"),
    (grouped, {"before": "a"}, "expected a column phase, or another named with --pair"),
    (grouped, {"by": "plate", "pair": "plate"}, "a column tells groups or pairs, not both"),
    (phased, {"before": "later"}, "--before later: column phase has no such value; column phase has after, before"),
    (lambda: [{"plate": "P1", "amplitude_um": 1.0}], {}, "expected a column group, phase or dose"),
    (lambda: [{"phase": p, "amplitude_um": 1.0} for p in ("before", "after")], {}, "need the column well"),
    (lambda: grouped(groups=("drug",)), {}, "column group: expected two groups or more to compare; found drug alone"),
    (lambda: [{"dose": "high", "amplitude_um": 1.0}], {}, "movie m0.tif, column dose: .* found 'high'"),
    (lambda: [{"dose": "-1", "amplitude_um": 1.0}], {}, "a number from 0 up; found '-1'"),
    (lambda: [{"group": "a", "verdict": "fail", "amplitude_um": 1.0}], {}, "all 1 are left out, .* verdict fail"),
    (lambda: [{"well": "A1", "amplitude_um": 1.0}], {"control": "a", "pair": "well", "before": "A1", "after": "A1"},
     "expected two values"),
])
def test_what_the_run_has_not_is_an_error(rows: Callable[[], Rows], given: dict[str, Any], said: str,
                                          tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=said):
        microbundle.compare(write_run(tmp_path, rows()), **given)


def test_another_folder_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ResultUnreadable, match=r"movies\.csv: expected a table that `microbundle batch` writes"):
        microbundle.compare(tmp_path)
    (tmp_path / "movies.csv").write_text("a,b\n1,2\n")
    with pytest.raises(ResultUnreadable, match="expected the columns movie, state, verdict"):
        microbundle.compare(tmp_path)


# --- what is written ------------------------------------------------------------------------------------------------


def test_prism_column_and_nested(tmp_path: Path) -> None:
    rows = [*grouped(plates=2, wells=2), {"group": "drug", "plate": "P3", "well": "A1", "amplitude_um": 7.0}]
    write_into(write_run(tmp_path / "run", rows), tmp_path / "out")
    column = cells(tmp_path / "out/prism/amplitude_um_column.csv")
    assert column[0] == ["control", "drug"]
    assert len(column) == 6
    assert column[5] == ["", "7"]
    nested = cells(tmp_path / "out/prism/amplitude_um_nested.csv")
    assert nested[0] == ["control", "", "", "drug", "", ""]
    assert nested[1] == ["P1", "P2", "", "P1", "P2", "P3"]
    assert nested[2][5] == "7"
    assert float(nested[3][1]) == pytest.approx(rows[5]["amplitude_um"], rel=1e-6)
    assert all(len(row) == 6 for row in nested)


def test_prism_paired_and_xy(tmp_path: Path) -> None:
    write_into(write_run(tmp_path / "run", phased(plates=1)), tmp_path / "out")
    paired = cells(tmp_path / "out/prism/amplitude_um_paired.csv")
    assert paired[0] == ["well", "drug before", "drug after", "vehicle before", "vehicle after"]
    assert [row[0] for row in paired[1:]] == ["P0 A0", "P0 A1", "P0 A2", "P0 B0", "P0 B1", "P0 B2"]
    assert paired[1][1:3] == ["", ""]
    assert {"amplitude_um_column_before.csv", "amplitude_um_nested_after.csv"} <= {
        file.name for file in (tmp_path / "out/prism").iterdir()}
    write_into(write_run(tmp_path / "doses", dosed(plates=1)), tmp_path / "of_doses")
    xy = cells(tmp_path / "of_doses/prism/amplitude_um_xy.csv")
    assert xy[0] == ["dose_um", "X", "", ""]
    assert [row[0] for row in xy[1:]] == ["0", "0.01", "0.03", "0.1", "0.3", "1", "3", "10"]
    assert all(len(row) == 4 and all(row) for row in xy[1:])


def test_the_same_run_gives_the_same_bytes_and_an_older_comparison_is_replaced(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", [row | {"dose": i % 8} for i, row in enumerate(phased())])
    before = sorted(run.iterdir())
    write_into(run, tmp_path / "out")
    first = {file: file.read_bytes() for file in (tmp_path / "out").rglob("*") if file.is_file()}
    write_into(run, tmp_path / "out")
    assert {file: file.read_bytes() for file in (tmp_path / "out").rglob("*") if file.is_file()} == first
    assert {"comparison.csv", "paired.csv", "dose_response.csv", "wells.csv", "left_out.csv"} <= {
        file.name for file in first}
    assert sorted(run.iterdir()) == before
    (tmp_path / "out" / "mine.txt").touch()
    with pytest.raises(OutputError, match=r"mine\.txt, which is never replaced"):
        write_into(run, tmp_path / "out")


def test_the_wells_are_written_with_what_is_known_of_them(tmp_path: Path) -> None:
    write_into(write_run(tmp_path / "run", dosed(plates=1)), tmp_path / "out")
    table = pd.read_csv(tmp_path / "out" / "wells.csv")
    assert list(table) == ["plate", "well", "compound", "dose", "movies", "metric", "value"]
    assert len(table) == 24


def test_figures_of_all_kinds(tmp_path: Path) -> None:
    rows = [row | {"dose": dose, "compound": compound} for row in phased(plates=2) for dose in (0, 1)
            for compound in ("A/B", "A_B")]
    rows = [row for row in rows if row["dose"] == (row["group"] == "drug")]
    found = microbundle.compare(write_run(tmp_path / "run", rows))
    for name in ("a", "b"):
        microbundle.write_comparison(found, tmp_path / name)
    names = {file.stem for file in (tmp_path / "a/figures").iterdir()}
    assert names == {"amplitude_um_groups_before", "amplitude_um_groups_after", "amplitude_um_paired",
                     "amplitude_um_dose_A_B", "amplitude_um_dose_A_B_2"}
    for file in (tmp_path / "a/figures").iterdir():
        assert file.read_bytes() == (tmp_path / "b/figures" / file.name).read_bytes()
        assert file.suffix in (".png", ".pdf")


def test_labels_and_places_of_points() -> None:
    assert axis_label("amplitude_um") == "Contraction amplitude (µm)"
    assert axis_label("beat_rate_bpm") == "Beat rate (beats/min)"
    assert axis_label("my_number") == "my_number"
    aside = spread(np.array([1.0, 1, 1, 5]))
    assert len(set(aside[:3])) == 3
    assert aside[3] == 0
    assert spread(np.array([2.0])).tolist() == [0]


# --- the command line -----------------------------------------------------------------------------------------------


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder of its own, with room for wide lines."""
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.chdir(home)
    monkeypatch.setenv("COLUMNS", "200")
    return home


def test_the_command_prints_and_writes(elsewhere: Path, tmp_path: Path, capsys: Captured) -> None:
    rows = [*grouped(), {"group": "odd", "plate": "P1", "well": "H1", "amplitude_um": 3.0}]
    run = write_run(tmp_path / "plate_1", rows)
    assert cli.run(["compare", str(run), "--no-figures"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "Groups, compared with control" in out
    assert "12 on 3 plates" in out
    assert "info: not estimable: a single well in the group; a spread needs 2" in out
    assert (elsewhere / "plate_1_comparison" / "comparison.csv").is_file()
    assert cli.run(["compare", str(run), "--no-figures"]) == 6
    assert "--overwrite" in capsys.readouterr().err
    assert cli.run(["compare", str(run), "--no-figures", "--overwrite", "--quiet"]) == 0
    assert capsys.readouterr().out == ""


def test_the_command_prints_pairs_and_doses(elsewhere: Path, tmp_path: Path, capsys: Captured) -> None:
    paired = write_run(tmp_path / "a", phased())
    assert cli.run(["compare", str(paired), "--no-figures", "--metric", "amplitude_um", "--control", "drug"]) == 0
    assert "after less before" in capsys.readouterr().out
    assert cli.run(["compare", str(write_run(tmp_path / "b", dosed())), "--out", "here"]) == 0
    assert "EC50 (95 % interval)" in capsys.readouterr().out
    assert (elsewhere / "here/figures/amplitude_um_dose_X.pdf").is_file()


@pytest.mark.usefixtures("elsewhere")
def test_json_holds_the_tables(tmp_path: Path, capsys: Captured) -> None:
    run = write_run(tmp_path / "run", grouped())
    assert cli.run(["compare", str(run), "--no-figures", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["control"] == "control"
    assert told["comparison"][0]["difference"] is None
    assert told["comparison"][1]["n_wells"] == 12
    assert told["left_out"] == []


@pytest.mark.parametrize(("arguments", "code"), [(["--by", "nothing"], 2), (["--metric", "nothing"], 2)])
def test_wrong_lines_write_nothing(arguments: list[str], code: int, elsewhere: Path, tmp_path: Path,
                                   capsys: Captured) -> None:
    run = write_run(tmp_path / "run", grouped())
    assert cli.run(["compare", str(run), *arguments]) == code
    assert capsys.readouterr().err.startswith("error: ")
    assert list(elsewhere.iterdir()) == []
    assert cli.run(["compare", str(tmp_path / "none")]) == 4
