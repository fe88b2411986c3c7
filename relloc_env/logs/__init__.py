"""Recorded robots: readers that turn published data sets, and the project's own logs, into the same observations."""

from relloc_env.logs.errors import LogError
from relloc_env.logs.mrclam import CommandModel, MrclamFolder, read_mrclam
from relloc_env.logs.source import Log, Truth

__all__ = ["CommandModel", "Log", "LogError", "MrclamFolder", "Truth", "read_mrclam"]
