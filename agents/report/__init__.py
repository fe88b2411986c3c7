"""The page about a benchmark: figures of its tables, curves, maps, films, and the page they stand on."""

from agents.report.page import report

__all__ = ["report"]
