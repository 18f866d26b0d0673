"""The accurate method beside a slow, dense implementation of its steps, on a small piece of tissue.

    MICROBUNDLE_ORACLE=FILE python benchmarks/oracle.py [SEEDS]

FILE is a Python file with `hiacc(movie, mask)`, which gives a field and its parameters, and `field.tracks(parameters,
points)`, which gives rows and columns (P, T). Both get the same movies, the same mask of at most 90 px width, and frame
0 as the reference; errors are those of `peers.py`. microbundle leaves the outermost pixels of a mask out, for around
real tissue the ground shines through there; so that the same pixels count for both, its mask is wider by these. Without
the variable nothing is run.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from types import ModuleType

import numpy as np
from peer_tools import microbundle
from peers import FIRST_SEED, KINDS, Question, ask, errors
from scipy import ndimage

from microbundle.data import Bools, Floats
from microbundle.register import EDGE_PX

WIDTH_PX = 90


def load(path: str) -> ModuleType:
    """Load a Python file."""
    spec = importlib.util.spec_from_file_location("oracle_file", path)
    if spec is None or spec.loader is None:
        raise SystemExit(f"MICROBUNDLE_ORACLE: expected a Python file, found {path}")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def small(kind: str, seed: int) -> Question:
    """A movie of which only a piece of the tissue is measured, from its first frame."""
    question = ask(kind, seed)
    if not question.beats.resting[0]:
        raise SystemExit(f"{kind}, seed {seed}: expected a movie that starts at rest")
    tissue = question.tissue.copy()
    middle = int(question.home_px[:, 1].mean())
    tissue[:, :middle - WIDTH_PX // 2] = False
    tissue[:, middle + WIDTH_PX // 2:] = False
    return replace(question, tissue=tissue, reference=0, seen_px=question.home_px + question.true_px[0])


def wider(tissue: Bools) -> Bools:
    """The mask with the pixels around it that microbundle leaves out."""
    return np.asarray(ndimage.binary_dilation(tissue, iterations=EDGE_PX))


def by_oracle(module: ModuleType, question: Question) -> Floats:
    """Displacement (T, P, 2) that the file gives."""
    top = float(question.frames.max())
    field, parameters = module.hiacc((question.frames / top).astype(np.float32), question.tissue)
    row, col = field.tracks(parameters, question.seen_px)
    return np.stack([row.T, col.T], axis=-1) - question.seen_px


def rows(path: str, seeds: int) -> Iterator[str]:
    """Lines of the table."""
    module, ours = load(path), microbundle("accurate")
    yield "| movie | oracle: RMSE px, peak %, E_cc % | accurate: RMSE px, peak %, E_cc % | RMSE, accurate / oracle |"
    yield "|---|---|---|---|"
    for kind in KINDS:
        both = []
        for seed in range(FIRST_SEED, FIRST_SEED + seeds):
            q = small(kind, seed)
            both.append([errors(q, by_oracle(module, q)),
                         errors(q, ours(q.frames, q.reference, q.seen_px, wider(q.tissue)))])
        table = np.array(both)  # seed, method, error
        share = table[:, 1, 0] / table[:, 0, 0]
        cells = [f"{r:.4f}, {p:.2f}, {e:.2f}" for r, p, e in table.mean(axis=0)]
        yield f"| {kind} | {cells[0]} | {cells[1]} | {share.mean():.2f} ({share.min():.2f} to {share.max():.2f}) |"


if __name__ == "__main__":
    if "MICROBUNDLE_ORACLE" not in os.environ:
        raise SystemExit("MICROBUNDLE_ORACLE is not set; there is nothing to compare with")
    for text in rows(os.environ["MICROBUNDLE_ORACLE"], int(sys.argv[1]) if len(sys.argv) > 1 else 3):
        print(text, flush=True)
