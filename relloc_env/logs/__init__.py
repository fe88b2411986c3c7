"""Recorded robots: readers that turn published data sets, and the project's own logs, into the same observations."""

from relloc_env.logs.checks import Limits
from relloc_env.logs.episode import LogWriter, write_log
from relloc_env.logs.episode_reader import read_log
from relloc_env.logs.errors import LogError
from relloc_env.logs.mrclam import CommandModel, MrclamFolder, read_mrclam
from relloc_env.logs.source import Log, Truth
from relloc_env.logs.starloc import read_starloc

__all__ = [
    "CommandModel",
    "Limits",
    "Log",
    "LogError",
    "LogWriter",
    "MrclamFolder",
    "Truth",
    "read_log",
    "read_mrclam",
    "read_starloc",
    "write_log",
]
