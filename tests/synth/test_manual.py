"""Hand-clicked points beside a result: exact clicks agree, rough ones say how rough they are."""

import json

import numpy as np
import pytest

from microbundle.errors import CannotMeasure, MovieUnreadable, OutputError
from microbundle.store import save
from microbundle.synth import commands
from microbundle.synth.cases import case_set
from microbundle.synth.manual import compare_clicks, read_clicks

from .stand_in import StandIn

FRAMES = range(20, 50, 2)


@pytest.fixture(scope="module")
def perfect():
    return StandIn.perfect(case_set("smoke")[0].make())


def write(path, analysis, noise):
    """Two people click ten points; the noise of each in px."""
    truth = analysis.synthetic.truth
    rng = np.random.default_rng(0)
    points = truth.points_px(9.0)[::7][:10]
    lines = ["person,point,frame,row,col"]
    for person, sigma in noise.items():
        for t in FRAMES:
            seen = points + truth.displacement_px(points, t) + sigma * rng.standard_normal(points.shape)
            lines += [f"{person},{k},{t},{row:.6f},{col:.6f}" for k, (row, col) in enumerate(seen)]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_exact_clicks_agree(perfect, tmp_path):
    first, both = compare_clicks(perfect, read_clicks(write(tmp_path / "c.csv", perfect, {"one": 0.0})))
    assert (first.person, first.points, first.clicks) == ("one", 10, 10 * (len(FRAMES) - 1))
    assert first.r2_row > 0.9999
    assert first.r2_col > 0.9999
    assert first.mae_col_px < 1e-3
    assert np.isnan(first.spread_px)
    assert both.person == "all"


def test_two_people_spread(perfect, tmp_path):
    one, two, _ = compare_clicks(perfect, read_clicks(write(tmp_path / "c.csv", perfect, {"a": 0.1, "b": 0.3})))
    assert one.mae_row_px < two.mae_row_px
    assert two.mae_row_px == pytest.approx(0.3 * np.sqrt(2) * np.sqrt(2 / np.pi), rel=0.35)
    assert one.spread_px == two.spread_px
    # Mean length of a plane vector with sqrt(2 (0.1^2 + 0.3^2)) in each direction.
    assert one.spread_px == pytest.approx(np.sqrt(np.pi / 2) * np.sqrt(2 * 0.1), rel=0.3)
    assert one.r2_col > two.r2_col


def test_the_command(tissue_analysis, tmp_path, capsys):
    points = tissue_analysis.tracks.position_px[:, tissue_analysis.tracks.ok.all(axis=0)][:, ::40]
    clicks = tmp_path / "c.csv"
    clicks.write_text("person,point,frame,row,col\n" + "".join(
        f"me,{k},{t},{row},{col}\n" for t in range(4, 16) for k, (row, col) in enumerate(points[t])))
    result = save(tissue_analysis, tmp_path / "result")
    assert commands.compare_clicks(result, clicks, out=tmp_path / "table.csv", json=True) == 0
    people = json.loads(capsys.readouterr().out)["people"]
    assert people[0]["r2_col"] > 0.98
    assert people[1]["person"] == "all"
    assert (tmp_path / "table.csv").read_text().startswith("person,points,clicks,r2_row")
    with pytest.raises(OutputError, match="not replaced"):
        commands.compare_clicks(result, clicks, out=tmp_path / "table.csv")


def test_wrong_files_are_refused(perfect, tmp_path):
    file = tmp_path / "c.csv"
    file.write_text("person,point,frame,row\na,1,0,3\n")
    with pytest.raises(MovieUnreadable, match="col not found"):
        read_clicks(file)
    file.write_text("person,point,frame,row,col\na,1,0,3,four\n")
    with pytest.raises(MovieUnreadable, match="line 2"):
        read_clicks(file)
    file.write_text("person,point,frame,row,col\na,1,900,3,4\n")
    with pytest.raises(CannotMeasure, match="900"):
        compare_clicks(perfect, read_clicks(file))
    with pytest.raises(MovieUnreadable):
        read_clicks(tmp_path / "none.csv")
