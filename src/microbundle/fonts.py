"""The font of figures: matplotlib's own DejaVu Sans, of which only what figures need is kept.

A PDF holds the letters it shows, and cutting these out of the whole font takes a third of a second for each figure,
most of it for rules of other scripts. Out of a font of Latin and Greek letters and signs it takes a fifth of that. It
is made once, beside matplotlib's own list of fonts. Text in any other script falls back to the whole font.
"""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

WHOLE = "DejaVu Sans"
LIGHT = "DejaVu Sans for figures"
WEIGHTS = ("normal", "bold")
KEPT = (range(0x20, 0x180), range(0x370, 0x400), range(0x2010, 0x20A0), range(0x2190, 0x21A0), range(0x2200, 0x2270))
"""Latin and Greek letters, punctuation, super- and subscripts, arrows, mathematical signs."""
RULES = ("GSUB", "GPOS", "GDEF", "FFTM", "MATH")
"""Tables of rules that Latin and Greek do without; pairs of letters have a table of their own."""
FAMILY_NAMES = (1, 4, 16)
VERSION = 1
"""Of what is made of the font."""


@cache
def figure_fonts() -> list[str]:
    """Families for matplotlib's `font.family`: the light font, where it can be made, and the whole one."""
    from matplotlib import font_manager, ft2font

    with suppress(Exception):  # a figure in the whole font is as good, and only later
        for file in [_made(weight) for weight in WEIGHTS]:
            ft2font.FT2Font(str(file))
            font_manager.fontManager.addfont(file)
        return [LIGHT, WHOLE]
    return [WHOLE]


def _made(weight: str) -> Path:
    """The file of the light font of a weight, made where it is not there yet; it appears whole."""
    import matplotlib
    from matplotlib import font_manager

    home = Path(matplotlib.get_cachedir())
    file = home / f"microbundle-{VERSION}-{matplotlib.__version__}-{weight}.ttf"
    if not file.exists():
        handle, partial = tempfile.mkstemp(prefix=f".{file.name}.partial-", dir=home)
        os.close(handle)
        try:
            wanted = font_manager.FontProperties(family=WHOLE, weight=weight)
            _make(font_manager.findfont(wanted, fallback_to_default=False), partial)
            os.replace(partial, file)
        finally:
            Path(partial).unlink(missing_ok=True)
    return file


def _make(whole: str, file: str) -> None:
    from fontTools import subset, ttLib

    font = ttLib.TTFont(whole)
    options = subset.Options(layout_features=[], drop_tables=list(RULES), legacy_kern=True, glyph_names=True,
                             notdef_outline=True, name_IDs=["*"], hinting=True)
    letters = subset.Subsetter(options)
    letters.populate(unicodes=[code for codes in KEPT for code in codes])
    letters.subset(font)
    for name in font["name"].names:
        if name.nameID in FAMILY_NAMES:  # its PostScript name stays, which editors of PDFs look for
            name.string = LIGHT
    font.save(file)
