"""Write docs/metrics.md and docs/compat.md from what is in the program: python benchmarks/write_metrics.py"""

from pathlib import Path

from microbundle.compat_definitions import TOOLS, names
from microbundle.dictionary import METRICS
from microbundle.lookup import LEVELS, all_units

DOCS = Path(__file__).parent.parent / "docs"


def cell(text: str) -> str:
    """Text that does not end a table's cell."""
    return text.replace("|", "\\|")


def metrics_page() -> str:
    """The dictionary, level by level."""
    lines = ["# Metrics", "", "Each key has one definition. A column's name is the key and its unit; the first unit is "
             "that without calibration, the last that with it. With the method `accurate` the standard error of the "
             "measurement stands beside each value whose column says so: `key_se_unit`. `microbundle metrics` prints "
             "this list, `microbundle metrics KEY` one entry with its source. What other tools call a number, and how "
             "theirs differs: [compat](compat.md).", ""]
    for level, (title, table) in LEVELS.items():
        lines += [f"## {title} ({table})", "", "| key | units | error | definition | elsewhere |",
                  "|---|---|---|---|---|"]
        lines += [f"| `{m.key}` | {all_units(m)} | {'yes' if m.error else ''} | {cell(m.definition)} | "
                  f"{cell(m.elsewhere)} |" for m in METRICS if m.level == level]
        lines.append("")
    lines += ["## Sources", ""]
    for source in dict.fromkeys(m.source for m in METRICS if m.source):
        keys = dict.fromkeys(m.key for m in METRICS if m.source == source and m.level not in (
            "shortening", "trace") and not m.key.startswith(("E_cc_", "force_cd")))
        lines.append(f"- {source}: {', '.join(f'`{key}`' for key in keys)}")
    return "\n".join([*lines, "", "All others are defined here.", ""])


def compat_page() -> str:
    """Each tool's numbers, their definitions, and ours."""
    lines = ["# Other tools' columns", "", "`microbundle analyze --compat TOOL` writes `compat_TOOL.csv`: a row for "
             "each beat (and pillar), with the names and definitions of that tool, so that series go on where they "
             "began. Beats are those of this program, the signals are its displacements and forces; units in brackets "
             "are those of your calibration (`px` and `frames` without it). No standard errors: for these use our own "
             "columns. In Python: `microbundle.compat_columns(analysis, \"pulse3d\")`.", ""]
    for key, tool in TOOLS.items():
        time, per, rate = tool.units
        parts = {"time": time, "per": per, "rate": rate, "size": "uN" if key == "pulse3d" else "um",
                 "amplitude": "Active Twitch Force"}
        lines += [f"## {tool.title}: `--compat {key}`", "", tool.signal, "",
                  "| name there | its definition | our key | the difference |", "|---|---|---|---|"]
        for column in tool.columns:
            shown = names(column, **parts)
            name = shown[0] if len(shown) == 1 else f"{shown[0]}` to `{shown[-1]}"
            ours = ", ".join(f"`{one}`" if one.isidentifier() else one for one in column.ours.split(", ")) or "-"
            lines.append(f"| `{cell(name)}` | {cell(column.definition)} | {ours} | {cell(column.difference)} |")
        lines += ["", f"Left out: {tool.left_out}", "", f"Source: {tool.source}.", ""]
    return "\n".join(lines)


if __name__ == "__main__":
    (DOCS / "metrics.md").write_text(metrics_page(), encoding="utf-8")
    (DOCS / "compat.md").write_text(compat_page(), encoding="utf-8")
