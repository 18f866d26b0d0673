"""Write docs/metrics.md from the dictionary in the program: python benchmarks/write_metrics.py"""

from pathlib import Path

from microbundle.dictionary import METRICS, Metric, columns

LEVELS = {"movie": "Per movie (`summary.csv`)",
          "beat": "Per beat, by the mean absolute displacement (`beats.csv`; over the whole beats in `summary.csv`)",
          "shortening": "Per beat, by the tissue's length (`shortening.csv`; over the whole beats in `summary.csv`)",
          "subdomain": "Per sub-domain and beat (`subdomains.csv`)", "pillar": "Per pillar and beat (`pillars.csv`)",
          "trace": "Per beat of a second signal (`microbundle trace`)", "frame": "Per frame (`frames.csv`)",
          "pillar_frame": "Per pillar and frame (`pillar_frames.csv`)"}


def units(metric: Metric) -> str:
    """Units without calibration and with it."""
    names = [name for calibration in ((None, None), (1.0, 1.0)) for name, _ in columns(metric, *calibration)]
    return ", ".join(dict.fromkeys(name.removeprefix(metric.key).removeprefix("_") for name in names if
                                   name != metric.key)) or "1"


def page() -> str:
    lines = ["# Metrics", "", "Each key has one definition. A column's name is the key and its unit; the first unit is "
             "that without calibration, the last that with it. With the method `accurate` the standard error of the "
             "measurement stands beside each value whose column says so: `key_se_unit`. `microbundle metrics KEY` "
             "prints an entry.", ""]
    for level, title in LEVELS.items():
        lines += [f"## {title}", "", "| key | units | error | definition | elsewhere |", "|---|---|---|---|---|"]
        lines += [f"| `{m.key}` | {units(m)} | {'yes' if m.error else ''} | {m.definition} | {m.elsewhere} |"
                  for m in METRICS if m.level == level]
        lines.append("")
    return "\n".join(lines)


if __name__ == "__main__":
    (Path(__file__).parent.parent / "docs" / "metrics.md").write_text(page(), encoding="utf-8")
