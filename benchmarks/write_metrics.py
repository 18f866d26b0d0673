"""Write docs/metrics.md from the dictionary in the program: python benchmarks/write_metrics.py"""

from pathlib import Path

from microbundle.dictionary import METRICS, UNITS

LEVELS = {"movie": "Per movie (`summary.csv`)", "beat": "Per beat (`beats.csv`; over the whole beats in `summary.csv`)",
          "subdomain": "Per sub-domain and beat (`subdomains.csv`)", "frame": "Per frame (`frames.csv`)"}


def page() -> str:
    lines = ["# Metrics", "", "Each key has one definition. A column's name is the key and its unit; the first unit is "
             "that without calibration, the second that with it. With the method `accurate` the standard error of the "
             "measurement stands beside each value whose column says so: `key_se_unit`.", ""]
    for level, title in LEVELS.items():
        lines += [f"## {title}", "", "| key | units | error | definition |", "|---|---|---|---|"]
        for m in (m for m in METRICS if m.level == level):
            units = ", ".join(dict.fromkeys(u for u in UNITS[m.kind] if u)) or "1"
            lines.append(f"| `{m.key}` | {units} | {'yes' if m.has_error else ''} | {m.definition} |")
        lines.append("")
    return "\n".join(lines)


if __name__ == "__main__":
    (Path(__file__).parent.parent / "docs" / "metrics.md").write_text(page(), encoding="utf-8")
