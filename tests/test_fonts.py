"""The light font of figures: its letters are those of the whole one, and other scripts fall back to that."""

from __future__ import annotations

import io
import re
import warnings
from pathlib import Path

import numpy as np
import pytest

from microbundle import fonts
from microbundle.style import blank, settings

LATIN = "Mean displacement (µm), 95 % – Tovar’s ΔF/F₀ AV Ti ±0.5"


def drawn(text: str, kind: str = "png") -> bytes:
    figure, out = blank(85, 10), io.BytesIO()
    figure.text(0.02, 0.3, text)
    figure.text(0.02, 0.7, text, weight="bold")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure.savefig(out, format=kind)
    return out.getvalue()


def width_px(png: bytes) -> int:
    import matplotlib.image

    ink = np.flatnonzero((matplotlib.image.imread(io.BytesIO(png))[..., :3] < 0.5).any(axis=(0, 2)))
    return int(np.ptp(ink))


def embedded(pdf: bytes) -> set[bytes]:
    """PostScript names of the fonts in a PDF."""
    return set(re.findall(rb"/FontName\s*/(?:[A-Z]{6}\+)?([\w-]+)", pdf))


def test_text_is_as_wide_as_in_the_whole_font(caplog: pytest.LogCaptureFixture) -> None:
    from matplotlib import rc_context

    with settings():
        assert fonts.figure_fonts() == [fonts.LIGHT, fonts.WHOLE]
        light = width_px(drawn(LATIN))
        with rc_context({"font.family": fonts.WHOLE}):
            assert light == pytest.approx(width_px(drawn(LATIN)), abs=3)
    assert not caplog.records


def test_a_pdf_embeds_few_letters_and_another_script_falls_back() -> None:
    with settings():
        latin, cyrillic = drawn(LATIN, "pdf"), drawn(f"{LATIN} Жук", "pdf")
    assert embedded(latin) == {b"DejaVuSans", b"DejaVuSans-Bold"}
    assert len(latin) < 40_000
    assert len(re.findall(rb"/FontFile2", cyrillic)) > len(re.findall(rb"/FontFile2", latin))


def test_it_is_made_once_and_without_room_for_it_the_whole_font_serves(monkeypatch: pytest.MonkeyPatch,
                                                                      tmp_path: Path) -> None:
    import matplotlib

    monkeypatch.setattr(matplotlib, "get_cachedir", lambda: str(tmp_path))
    made = fonts._made("bold")
    before = made.stat().st_mtime_ns
    assert fonts._made("bold") == made
    assert (list(tmp_path.iterdir()), made.stat().st_mtime_ns) == ([made], before)
    monkeypatch.setattr(matplotlib, "get_cachedir", lambda: str(tmp_path / "nothing"))
    fonts.figure_fonts.cache_clear()
    try:
        assert fonts.figure_fonts() == [fonts.WHOLE]
        with settings():
            assert drawn(LATIN)
    finally:
        fonts.figure_fonts.cache_clear()
