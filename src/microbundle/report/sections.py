"""The parts of a report that need no script: findings, key numbers, tables, the picture with its overlays."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..analysis import Analysis
from ..data import Finding
from . import text
from .page import MISSING, Html, joined, number, tag, with_error
from .pictures import axis_line, outline, view_box
from .terms import Term, best_unit, explained, terms

if TYPE_CHECKING:
    import pandas as pd

TEXT = 0.03
"""Size of text in the picture, as a share of its width."""
NAMED_TILE = 0.045
"""Sub-domains with a smaller side, as a share of the picture's width, show their name when pointed at or chosen."""
LEVELS = {"fail": "Fail", "review": "Review", "info": "Info"}
VERDICTS = {"pass": ("Pass", "Nothing was found that speaks against these numbers."),
            "review": ("Review", "A person should look at what was found before these numbers are used."),
            "fail": ("Fail", "These numbers cannot be trusted; what was found says why.")}
CARDS = (("beat_rate_bpm", "beat_rate_per_frame", "beat_period_frames"), ("amplitude_um", "amplitude_px"),
         ("shortening_amplitude",), ("e_cc_peak",), ("cd50_s", "cd50_frames"),
         ("contraction_velocity_um_per_s", "contraction_velocity_px_per_s", "contraction_velocity_um_per_frame",
          "contraction_velocity_px_per_frame"),
         ("twitch_force_un",), ("synchrony_sd_s", "synchrony_sd_frames"))
"""Columns of the summary that are shown large: of each, the first that is there."""
INTERVALS = {"beat-to-beat spread": "beats", "measurement": "measurement",
             "beat-to-beat spread and measurement": "both"}
"""What an interval is made of, in short."""
CLOCK_TIMES = ("peak_time", "onset_time", "half_rise_time")
"""Times from the movie's start, of which a mean over beats says nothing."""
TILE_COLUMNS = ("E_cc_extreme", "E_rr", "E_rc", "E_1", "E_2", "areal_strain", "shear_max", "delay", "E_cc_cd50_s",
                "E_cc_cd50_frames")


def findings(found: Sequence[Finding]) -> Html:
    """List the findings, the worst first, each with its number and limit."""
    if not found:
        return tag("p", "No findings: nothing about this movie needs your attention.", class_="reason")
    order = {"fail": 0, "review": 1, "info": 2}
    return tag("ul", joined(_finding(f) for f in sorted(found, key=lambda f: order[f.level])), class_="findings")


def _finding(finding: Finding) -> Html:
    parts = [tag("span", LEVELS[finding.level], class_=f"level {finding.level}"),
             tag("span", joined([_sentence(finding.message), " ", tag("code", finding.key)]), class_="message")]
    if finding.value is not None:
        limit = "" if finding.limit is None else f", limit {finding.limit:.4g}"
        parts.append(tag("span", f"found {finding.value:.4g}{limit}", class_="measured"))
    return tag("li", joined(parts), class_=finding.level)


def cards(analysis: Analysis, summary: pd.DataFrame) -> Html:
    """Show the key numbers large, each with its 95 % interval, its number of beats and its definition."""
    known = terms(analysis)
    rows = {str(row["metric"]): row for row in summary.to_dict("records")}
    shown = []
    for choices in CARDS:
        name = next((name for name in choices if name in rows and rows[name]["n"] > 0), None)
        if name is not None:
            shown.append(_card(known[name], rows[name]))
    if not shown:
        return tag("p", why_no_beats(analysis), class_="reason")
    return tag("div", joined(shown), class_="cards")


def _card(term: Term, row: Mapping[Any, Any]) -> Html:
    low, high, n = row["low_95"], row["high_95"], int(row["n"])
    of = f"{n} beat{'' if n == 1 else 's'}"
    interval = (f"95 % {number(low)} to {number(high)}, {of}" if np.isfinite(low) else f"{of}, no interval")
    return tag("div", joined([
        tag("div", explained(term), class_="name"),
        tag("div", joined([number(row["mean"]), " ", tag("span", term.unit, class_="unit")]), class_="value"),
        tag("div", interval, class_="interval")]), class_="card")


def why_no_beats(analysis: Analysis) -> str:
    """Say why there are no numbers of beats."""
    told = [f.message for f in analysis.findings if f.level == "fail"]
    return _sentence(told[0]) if told else "There is no whole beat, so there are no numbers of beats."


def summary_table(analysis: Analysis, summary: pd.DataFrame) -> Html:
    """Table of all metrics of the movie."""
    known = terms(analysis)
    rows = {str(row["metric"]): row for row in summary.to_dict("records") if row["n"] > 0}
    shown = [term for term in best_unit(known, list(rows)) if not term.metric.key.endswith(CLOCK_TIMES)]
    head = ("Metric", "Unit", "n", "Mean", "SE of measurement", "SD of beats", "95 % interval", "by")
    body = []
    for term in shown:
        row = rows[term.column]
        interval = f"{number(row['low_95'])} to {number(row['high_95'])}" if np.isfinite(row["low_95"]) else MISSING
        body.append((explained(term), term.unit, str(int(row["n"])), number(row["mean"]), number(row["se"], 2),
                     number(row["sd"], 3), interval, INTERVALS.get(row["interval"], MISSING)))
    return table(head, body, "All metrics of the movie, over whole beats")


def table(head: Sequence[object], body: Sequence[Sequence[object]], caption: str) -> Html:
    """Write a table whose first column names its rows."""
    top = tag("tr", joined(tag("th", cell, scope="col") for cell in head))
    lines = [tag("tr", joined([tag("th", row[0], scope="row"), *(tag("td", cell) for cell in row[1:])]))
             for row in body]
    return tag("div", tag("table", joined([tag("caption", caption), tag("thead", top), tag("tbody", joined(lines))])),
               class_="scroll", tabindex="0", role="region", aria_label=caption)


def beat_table(analysis: Analysis, rows: pd.DataFrame, caption: str, names: Sequence[str] | None = None) -> Html:
    """Table with a row for each metric and a column for each beat (named `names`), values with standard errors."""
    known = terms(analysis)
    shown = [term for term in best_unit(known, [str(c) for c in rows.columns]) if rows[term.column].notna().any()]
    if names is None:
        names = [analysis.beats.label(int(beat)) for beat in rows["beat"]]
    body = []
    for term in shown:
        values = rows[term.column].to_numpy(float)
        error = rows[term.error_column].to_numpy(float) if term.error_column in rows else np.full(len(values), np.nan)
        body.append((explained(term), term.unit, *map(with_error, values, error)))
    return table(("Metric", "Unit", *names), body, caption)


def tile_table(analysis: Analysis, rows: pd.DataFrame) -> Html:
    """Table with a row for each sub-domain: means over the whole beats, or why it has no strain."""
    if analysis.strain is None:
        return tag("p", why_no_strain(analysis), class_="reason")
    known = terms(analysis)
    shown = [known[name] for name in rows.columns if name in known and known[name].column.startswith(TILE_COLUMNS)
             and (known[name].metric.key in TILE_COLUMNS or name in TILE_COLUMNS)]
    whole = rows[rows["complete"]] if len(rows) else rows
    body = []
    for s, name in enumerate(analysis.strain.label):
        own = whole[whole["subdomain"] == name] if len(whole) else whole
        means = [number(float(own[term.column].mean())) if len(own) else MISSING for term in shown]
        body.append((name, *means, str(int(analysis.strain.count[s])), analysis.strain.reason[s] or ""))
    head = ("Sub-domain", *(joined([explained(term), f" {term.unit}"]) for term in shown), "markers", "why no strain")
    return table(head, body, "Sub-domains, means over whole beats")


def tables(analysis: Analysis, made: Mapping[str, pd.DataFrame]) -> Iterator[tuple[str, str, Html]]:
    """Give the tables of a report: id, title, and the table or why there is none."""
    none = tag("p", why_no_beats(analysis), class_="reason")
    beats = len(analysis.beats) > 0
    yield "summary", "Movie", summary_table(analysis, made["summary"])
    yield "beats", "Beats", beat_table(analysis, made["beats"], "Beats, by the mean absolute displacement, "
                                       "± standard error of the measurement") if beats else none
    yield "shortening", "Shortening", beat_table(analysis, made["shortening"], "Beats, by the tissue's length, "
                                                 "± standard error of the measurement") if beats else none
    yield "subdomains", "Sub-domains", tile_table(analysis, made["subdomains"]) if beats else none
    yield "pillars", "Pillars", _pillar_tables(analysis, made) if beats or analysis.pillars is None else none


def _pillar_tables(analysis: Analysis, made: Mapping[str, pd.DataFrame]) -> Html:
    if analysis.pillars is None:
        return tag("p", why_no_pillars(analysis), class_="reason")
    rows = made["pillars"].sort_values(["pillar", "beat"], kind="stable")
    names = [f"pillar {pillar}, {analysis.beats.label(int(beat))}" for pillar, beat in
             zip(rows["pillar"], rows["beat"], strict=True)]
    parts = [beat_table(analysis, rows, "Pillars, beat by beat, ± standard error of the measurement", names)]
    if len(made["budget"]):
        body = [(str(row["quantity"]), str(row["source"]), number(row["se_pct"], 2) if np.isfinite(row["se_pct"])
                 else "not given") for row in made["budget"].to_dict("records")]
        parts.append(table(("Quantity", "Source of error", "standard error, %"), body,
                           "What the forces are uncertain by"))
    return joined(parts)


def why_no_strain(analysis: Analysis) -> str:
    """Say why there is no strain."""
    return _reason(analysis, "no_strain", "No sub-domain fits into the tissue.")


def why_no_pillars(analysis: Analysis) -> str:
    """Say why there is nothing about pillars."""
    if analysis.config.pillars.masks == "none":
        return "Pillars were left out, as the setting pillars.masks = none asks."
    return _reason(analysis, "no_pillars", "No pillars were found in this movie, and no pillar masks came with it.")


def _reason(analysis: Analysis, key: str, otherwise: str) -> str:
    return _sentence(next((f.message for f in analysis.findings if f.key == key), otherwise))


def _sentence(message: str) -> str:
    return message[:1].upper() + message[1:]


def picture(analysis: Analysis, uri: str) -> Html:
    """Draw the relaxed frame with mask, axis, pillars and sub-domains over it; the map lies between the two layers."""
    left, top, width, height = view_box(analysis)
    box = f"{left} {top} {width} {height}"
    rows, cols = analysis.image.shape
    alt = (f"Relaxed frame of {analysis.name} with the outline of the tissue, its axis"
           f"{', the pillars' if analysis.pillars is not None else ''}"
           f"{', and the sub-domains' if analysis.strain is not None else ''}")
    under = tag("svg", Html(f'<image href="{uri}" x="0" y="0" width="{cols}" height="{rows}" '
                            'preserveAspectRatio="none"/>'), viewBox=box, class_="under", aria_hidden="true")
    dense = analysis.strain is not None and min(analysis.strain.side_px) < NAMED_TILE * width
    over = tag("svg", joined(_overlay(analysis)), viewBox=box, class_="over dense" if dense else "over", role="group",
               aria_label=alt, font_size=f"{TEXT * width:.1f}")
    return joined([under, tag("canvas", "", aria_hidden="true"), over])


def _overlay(analysis: Analysis) -> Iterator[Html]:
    one, other = axis_line(analysis.masks)
    yield tag("path", "", d=outline(analysis.masks.tissue), class_="mask")
    yield tag("path", "", d=f"M{one[1]:.1f} {one[0]:.1f}L{other[1]:.1f} {other[0]:.1f}", class_="axis")
    if analysis.pillars is not None:
        heads = analysis.pillars.pillars
        for name, mask, center in zip(heads.names, heads.masks, heads.center_px, strict=True):
            yield tag("path", tag("title", f"pillar {name}"), d=outline(mask), class_="pillar")
            yield tag("text", f"P{name}", x=f"{center[1]:.1f}", y=f"{center[0]:.1f}", class_="pillar-name")
    if analysis.strain is not None:
        found = analysis.strain
        for s, (name, corners) in enumerate(zip(found.label, found.corner_px + 0.5, strict=True)):
            points = " ".join(f"{x:.1f},{y:.1f}" for y, x in corners)
            told = f"{name}: {found.reason[s]}" if found.reason[s] else name
            middle = corners.mean(axis=0)
            yield tag("g", joined([tag("title", told), tag("polygon", "", points=points),
                                   tag("text", name, x=f"{middle[1]:.1f}", y=f"{middle[0]:.1f}")]),
                      class_="tile none" if found.reason[s] else "tile", data_tile=s)
    yield tag("path", "", class_="arrows")


def settings(analysis: Analysis) -> Html:
    """List the settings: those that differ from the defaults, and all."""
    changed = text.changed_settings(analysis.config)
    own = (table(("Setting", "Value"), [(tag("code", k), str(v)) for k, v in changed.items()],
                 "Settings that differ from the defaults") if changed else tag("p", "All settings are the defaults."))
    every = table(("Setting", "Value"), [(tag("code", k), str(v)) for k, v in
                                         text.all_settings(analysis.config).items()], "All settings")
    return joined([own, tag("details", joined([tag("summary", "All settings"), every]))])


def provenance(analysis: Analysis) -> Html:
    """List where the numbers come from."""
    return tag("dl", joined(joined([tag("dt", key), tag("dd", value)])
                            for key, value in text.provenance(analysis).items()))


def methods(analysis: Analysis) -> Html:
    """Write the methods paragraph and its references."""
    return joined([tag("p", text.methods_paragraph(analysis)),
                   tag("ol", joined(tag("li", work) for work in text.references(analysis)))])

