"""A replay as a file for the viewer of Rerun."""

from pathlib import Path

from relloc_env.rendering.rerun_file import RerunFile
from relloc_env.replay.run import ReplayResult
from relloc_env.replay.scenes import scenes


def record(result: ReplayResult, path: str | Path) -> Path:
    """Write what the first estimator of a replay believed, and the truth, to a file, .rrd.

    Raises:
        ValueError: several logs, or one without truth.
    """
    runs = next(iter(result.runs.values()))
    if len(runs) > 1:
        raise ValueError(f"Argument `rerun` needs one log, but there are {len(runs)}: choose two `robots`")
    instants = scenes(runs[0])
    first = next(instants)
    with RerunFile(path, first.title) as file:
        file.add(first)
        for scene in instants:
            file.add(scene)
    return Path(path)
