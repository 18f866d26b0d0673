"""Reports that open in any browser: one page for each movie, and an index over many."""

from .build import NAME, write_report
from .index import summarize, write_index

__all__ = ["NAME", "summarize", "write_index", "write_report"]
