"""What a person decided on a movie, as the app reads and writes it: a list, in the order in which it is replayed.

The sidecar of a result folder lies beside it, and its masks beside that, so that a result can be replaced as a whole.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ..batch.state import whole
from ..data import Bools
from .answers import Refused

KINDS = ("drop_beat", "mark_beat", "use_mask", "settings", "verdict", "note")
MOST = 1000
MASK = re.compile(r"tissue|pillar_[1-9]\d?")


def sidecar(result: Path) -> Path:
    """Where the decisions on a result are kept."""
    return result.with_name(f"{result.name}.decisions.json")


def read(result: Path) -> tuple[list[dict[str, Any]], str]:
    """Read the decisions on a result, and what tells this list from another. None where there are none."""
    try:
        content = sidecar(result).read_bytes()
        listed = json.loads(content)
    except FileNotFoundError:
        return [], "none"
    except (OSError, ValueError):
        raise Refused(422, "DecisionsUnreadable", f"{sidecar(result).name}: expected a list of decisions; the file is "
                      "damaged. Move it away to begin anew") from None
    return listed, hashlib.sha256(content).hexdigest()[:16]


def write(result: Path, decisions: Any, masks: Mapping[str, Bools], version: str | None) -> str:
    """Replace the decisions on a result, if nobody else did since `version`; returns the new version.

    Raises Refused for another version, with the decisions that are there, and for what is no decision. Raises OSError.
    """
    if not isinstance(decisions, list) or len(decisions) > MOST or not all(
            isinstance(one, dict) and one.get("kind") in KINDS for one in decisions):
        raise Refused(422, "BadDecision", f"decisions: expected a list of at most {MOST}, each of a kind of "
                      f"{', '.join(KINDS)}")
    known, now = read(result)
    if version is not None and version != now:
        raise Refused(409, "Changed", "another window, or another person, has changed what was decided on this movie",
                      decisions=known, version=now)
    result.parent.mkdir(parents=True, exist_ok=True)
    for name, mask in masks.items():
        png = cv2.imencode(".png", mask.astype(np.uint8) * 255)[1].tobytes()
        partial = result.parent / f".{result.name}.{name}.partial-png"
        partial.write_bytes(png)
        partial.replace(result.parent / f"{result.name}.{name}.png")
    with whole(sidecar(result)) as stream:
        stream.write(json.dumps(decisions, indent=1) + "\n")
    return read(result)[1]
