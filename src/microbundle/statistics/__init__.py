"""Conclusions from whole plates: wells, compared between groups, before and after, and over doses.

    comparison = microbundle.compare("plate_1_results", control="vehicle")
    comparison.tables["comparison"]
    microbundle.write_comparison(comparison, "plate_1_comparison")

`wells` reads a run into wells, which are the sample; `estimates` turns numbers of wells into a difference with its
interval, by the spread of the level that repeats it; `groups` and `paired` make their tables with it; `curve` fits a
dose-response, and `dose` makes the table; `compare` brings all together, `prism` and `write` write it.
"""
