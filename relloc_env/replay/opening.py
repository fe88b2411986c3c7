"""Whatever a folder holds, as logs."""

from collections.abc import Sequence
from pathlib import Path

from relloc_env.logs import Limits, Log, LogError, read_log, read_mrclam, read_starloc
from relloc_env.logs.checks import LIMITS
from relloc_env.logs.episode import HEADER
from relloc_env.logs.mrclam_files import numbers_of
from relloc_env.logs.starloc import DETECTIONS
from relloc_env.logs.text import stored


def open_logs(
    path: str | Path,
    *,
    robots: Sequence[int] | None = None,
    start: float | None = None,
    stop: float | None = None,
    velocity: str | None = None,
    limits: Limits = LIMITS,
) -> list[Log]:
    """Open whatever log `path` holds: one run, or all pairs of robots of an MR.CLAM folder.

    Args:
        path: an MR.CLAM folder, a STAR-loc sequence, or a log of the project's own format.
        robots: MR.CLAM: numbers of the robots of one run; default: all pairs.
        start, stop: [s] part of the log.
        velocity: "commands" or "mocap"; MR.CLAM has both (default "commands"), STAR-loc the second alone.
        limits: what is refused in a recording.
    """
    folder = Path(path)
    if not folder.is_dir():
        raise LogError(folder, "must be the folder of a log" if folder.exists() else "folder not found")
    if numbers_of(folder):
        chosen = "commands" if velocity is None else velocity
        data = read_mrclam(folder, robots, limits)
        if robots is None and len(data.robots) == 1:
            single = next(iter(data.robots))
            raise LogError(
                folder,
                f"must hold two robots for a pose between them, but holds robot {single} alone "
                f"(for its depths, in Python: `robots=({single},)`)",
            )
        groups = data.pairs() if robots is None else [tuple(robots)]
        return [data.log(group, velocity=chosen, start=start, stop=stop) for group in groups]  # type: ignore[arg-type]
    if stored(folder / DETECTIONS).exists():
        log, has = read_starloc(folder, limits=limits), "mocap"
    elif stored(folder / HEADER).exists():
        log, has = read_log(folder, limits), None
    else:
        raise LogError(
            folder, f"holds no log: no RobotN_Odometry.dat (MR.CLAM), no {DETECTIONS} (STAR-loc), no {HEADER}"
        )
    if robots is not None:
        raise ValueError(f"Argument `robots` must be left out for {folder}: its robots are {', '.join(log.robots)}")
    if velocity not in (None, has):
        only = "has the velocities that were recorded" if has is None else f'has velocity "{has}" alone'
        raise ValueError(f"Argument `velocity` must be left out: {folder} {only}")
    return [log if start is None and stop is None else log.cut(start, stop)]
