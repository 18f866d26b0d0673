"""How a run was made: a small file in its folder, so that it can be understood, cited, opened by the app, continued."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from ..config import Config
from ..errors import ConfigError, ResultUnreadable
from .plan import Plan
from .state import whole

RECIPE = "run.json"


@dataclass(frozen=True)
class Recipe:
    """All that a run is made of, but for what people decide on its movies."""

    source: str
    """Full path of the folder, manifest or movie."""
    pattern: str | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Those that differ from the defaults, nested as in a TOML file; a manifest's win over them."""
    report: bool = True
    figures: bool = False
    movies: bool = False
    excel: bool = False
    wells: int | None = None
    version: str = ""
    """Of microbundle."""

    def __post_init__(self) -> None:
        if not (isinstance(self.source, str) and isinstance(self.pattern, str | None)
                and isinstance(self.wells, int | None)):
            raise TypeError("source, pattern or wells is of another kind")
        Config.from_dict(dict(self.settings), source="settings")


def write_recipe(out: Path, plan: Plan, *, excel: bool, wells: int | None) -> None:
    """Write how a run is made into its folder. Raises OSError."""
    made = Recipe(str(plan.source.resolve()), plan.pattern, plan.config.model_dump(mode="json", exclude_unset=True),
                  plan.report, plan.figures, plan.movies, excel, wells, plan.version)
    with whole(out / RECIPE) as stream:
        stream.write(json.dumps(asdict(made), indent=1) + "\n")


def read_recipe(out: Path) -> Recipe:
    """Read how the run of a folder was made. Raises ResultUnreadable where the folder does not say."""
    known = {one.name for one in fields(Recipe)}
    try:
        kept = json.loads((out / RECIPE).read_text(encoding="utf-8"))
        return Recipe(**{name: value for name, value in kept.items() if name in known})
    except (OSError, ValueError, TypeError, AttributeError, ConfigError) as error:
        raise ResultUnreadable(f"{out / RECIPE}: expected how this run was made, as microbundle batch writes it; it "
                               f"cannot be read: {error}. Run its command again, which writes it anew") from None
