"""Settings: TOML there and back, one clear sentence for each wrong one, and the same text in every place."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError
from pydantic.fields import FieldInfo

from microbundle import cli
from microbundle.commands import settings_from
from microbundle.config import Config, Params, merge
from microbundle.errors import ConfigError

Names = tuple[str, ...]


def every_field(model: type[Params] = Config, above: Names = ()) -> Iterator[tuple[Names, FieldInfo]]:
    """All settings of the tree by the names on their way, groups left out."""
    for name, field in model.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, Params):
            yield from every_field(field.annotation, (*above, name))
        else:
            yield (*above, name), field


FIELDS = dict(every_field())
EXAMPLES: dict[str, Any] = {
    "method": "paper", "fps": 25.0, "um_per_px": 0.5, "axis_deg": -10.0, "reading.crop_px": [1, 50, 2, 60],
    "reading.series": 1, "reading.channel": 1, "reading.z": 2, "reading.stop_frame": 40,
    "reading.kernel": [[0.0, 1.0, 0.0]] * 3, "reading.drop_flashes": True,
    "mask.method": "sobel", "tracking.window_px": 31, "tracking.reference_frame": 3, "grid.method": "thin_plate",
    "grid.extrapolate": True, "registration.whiten": "never",
    "registration.threads": 1, "strain.tiles": [3, 5], "strain.extents_px": [10.0, 50.0, 10.0, 90.0],
    "pillars.masks": "supplied", "pillars.profile": "circle", "pillars.unloaded_px": [[10.0, 20.0], [30.0, 40.0]],
    **{f"pillars.{name}": 2.5 for name in (
        "stiffness_un_per_um", "stiffness_error_pct", "modulus_mpa", "width_um", "thickness_um", "diameter_um",
        "length_um", "force_height_um", "depth_um", "depth_error_pct", "um_per_px_error_pct")},
    "metrics.levels_pct": [20, 80], "metrics.pacing_hz": 1.5, "metrics.fibre_deg": -12.0,
}


def example(name: str) -> Any:
    """Another allowed value than the default: given above, or for a number a little more than the default."""
    default = FIELDS[tuple(name.split("."))].default
    return EXAMPLES[name] if name in EXAMPLES else (default + 0.125 if isinstance(default, float) else default + 1)


def toml(name: str, value: Any) -> str:
    table, _, key = name.rpartition(".")
    written = {True: "true", False: "false"}.get(value, repr(value)) if isinstance(value, bool) else repr(value)
    return (f"[{table}]\n" if table else "") + f"{key} = {written}\n"


def flags(name: str, value: Any) -> list[str]:
    flag = "--" + name.replace("_", "-")
    if isinstance(value, bool):
        return [flag]
    if isinstance(value, list) and isinstance(value[0], list):
        return [part for row in value for part in (flag, str(row).replace(" ", ""))]
    if name == "metrics.levels_pct":  # any number of values: the flag once for each
        return [part for one in value for part in (flag, str(one))]
    return [flag, *map(str, value if isinstance(value, list) else [value])]


def value_at(config: Config, name: str) -> Any:
    found: Any = config.model_dump(mode="json")
    for part in name.split("."):
        found = found[part]
    return found


NAMES = [".".join(path) for path in FIELDS]


@pytest.mark.parametrize("name", NAMES)
def test_every_setting_has_a_help_text(name: str) -> None:
    text = FIELDS[tuple(name.split("."))].description
    assert text is not None
    assert text.endswith(".")


@pytest.mark.parametrize("name", NAMES)
def test_every_setting_is_a_toml_key(name: str, tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(toml(name, example(name)))
    config = Config.from_toml(tmp_path / "s.toml")
    assert value_at(config, name) == example(name) != value_at(Config(), name)


@pytest.mark.parametrize("name", NAMES)
def test_every_setting_is_a_flag(name: str) -> None:
    _, bound, _ = cli.app.parse_args(["analyze", "movie", *flags(name, example(name))], exit_on_error=False,
                                     print_error=False)
    assert value_at(settings_from(None, bound.arguments["config"]), name) == example(name)


def test_help_shows_every_setting_with_its_text(monkeypatch: pytest.MonkeyPatch,
                                                capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("COLUMNS", "1000")
    assert cli.run(["analyze", "--help"]) == 0
    shown = re.sub(r"[\s│]+", " ", capsys.readouterr().out)
    for path, field in FIELDS.items():
        flag = "--" + ".".join(path).replace("_", "-")
        text = re.sub(r"\s+", " ", str(field.description))
        assert re.search(rf"{re.escape(flag)} [^─]*?{re.escape(text)}", shown), flag


def test_settings_go_through_toml_and_json_unchanged(tmp_path: Path) -> None:
    text = "".join(toml(n, example(n)) for n in NAMES if "." not in n)
    for group in dict.fromkeys(n.split(".")[0] for n in NAMES if "." in n):
        text += f"[{group}]\n"
        text += "".join(toml(n, example(n)).split("\n", 1)[1] for n in NAMES if n.startswith(group + "."))
    (tmp_path / "s.toml").write_text(text)
    config = Config.from_toml(tmp_path / "s.toml")
    assert Config.from_dict(tomllib.loads(text)) == config
    assert Config.model_validate_json(config.model_dump_json()) == config
    assert all(value_at(config, name) == example(name) for name in NAMES)


def test_settings_are_frozen() -> None:
    with pytest.raises(ValidationError):
        Config().fps = 3.0  # type: ignore[misc]


# --- what is wrong, in one sentence ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("text", "said"), [
    ("fsp = 3", "unknown setting 'fsp'"),
    ("[tracking]\nwindow = 3", "unknown setting 'tracking.window'"),
    ("[trakcing]\nwindow_px = 3", "unknown setting 'trakcing'"),
    ("fps = 'fast'", "fps: expected a valid number"),
    ("fps = 0", "fps: expected greater than 0; found 0"),
    ("fps = nan", "fps: expected a finite number"),
    ("fps = inf", "fps: expected a finite number"),
    ("method = 'papre'", "method: expected 'default', 'accurate', 'fast' or 'paper'; found 'papre'"),
    ("mask = 3", "mask: expected"),
    ("[tracking]\nwindow_px = 3", "tracking.window_px: expected greater than or equal to 5; found 3"),
    ("[tracking]\nwindow_px = 21.5", "tracking.window_px: expected a valid integer"),
    ("[strain]\nclip_columns = 1.0", "strain.clip_columns: expected less than 1"),
    ("[strain]\ntiles = [0, 3]", "strain.tiles.0: expected greater than or equal to 1"),
    ("[strain]\ntiles = [3]", "strain.tiles.1 is missing"),
    ("[strain]\nextents_px = [9, 1, 0, 5]", "strain: extents_px (9.0, 1.0, 0.0, 5.0) must be first row < end row"),
    ("[reading]\ncrop_px = [5, 1, 0, 9]", "reading: crop_px (5, 1, 0, 9) must be first row < end row"),
    ("[reading]\nfirst_frame = 9\nstop_frame = 9", "reading: stop_frame 9 must be larger than first_frame 9"),
    ("[reading]\nkernel = [[1, 0], [0, 1]]", "reading: kernel must have an odd number of rows of one odd length"),
    ("[reading]\nkernel = []", "reading: kernel must have an odd number"),
    ("fps = ", "expected a readable TOML file of settings"),
])
def test_a_wrong_setting_is_one_sentence_with_key_and_file(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "my settings.toml"
    file.write_text(text)
    with pytest.raises(ConfigError) as caught:
        Config.from_toml(file)
    message = str(caught.value)
    assert said in message
    assert message.startswith(f"{file}: ")
    assert "\n" not in message
    assert "pydantic" not in message
    assert "http" not in message


def test_each_wrong_setting_has_its_own_line() -> None:
    with pytest.raises(ConfigError) as caught:
        Config.from_dict({"fps": -1, "grid": {"spacing_px": 0}}, source="here")
    assert [line.split(":")[:2] for line in str(caught.value).splitlines()] == [["here", " fps"],
                                                                              ["here", " grid.spacing_px"]]


@pytest.mark.parametrize("content", [None, b"\xff\xfe\x00"])
def test_an_unreadable_file_is_refused(tmp_path: Path, content: bytes | None) -> None:
    file = tmp_path / "s.toml"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(ConfigError, match=r"s\.toml: expected a readable TOML file"):
        Config.from_toml(file)


# --- file and flags -------------------------------------------------------------------------------------------------


def test_flags_win_over_the_file_setting_by_setting(tmp_path: Path) -> None:
    file = tmp_path / "s.toml"
    file.write_text("fps = 10\num_per_px = 2\n[strain]\ntile_px = 20\nmin_markers = 6\n")
    given = Config.from_dict({"fps": 30, "strain": {"tile_px": 40}})  # 40 is the default, but it was given
    config = settings_from(file, given)
    assert (config.fps, config.um_per_px) == (30, 2)
    assert (config.strain.tile_px, config.strain.min_markers) == (40, 6)


def test_a_clash_of_file_and_flags_names_both(tmp_path: Path) -> None:
    file = tmp_path / "s.toml"
    file.write_text("[reading]\nfirst_frame = 50\n")
    with pytest.raises(ConfigError, match=r"command line with .*s\.toml: reading: stop_frame 40 must be larger"):
        settings_from(file, Config.from_dict({"reading": {"stop_frame": 40}}))


def test_merge_keeps_what_is_below() -> None:
    below = {"a": {"b": 1, "c": 2}, "d": 3}
    assert merge(below, {"a": {"c": 4}, "e": 5}) == {"a": {"b": 1, "c": 4}, "d": 3, "e": 5}
    assert below == {"a": {"b": 1, "c": 2}, "d": 3}
