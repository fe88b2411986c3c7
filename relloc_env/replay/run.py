"""The replay of recorded logs as one library call; the command line is a shell around it."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from relloc_env.config import ConfigError
from relloc_env.estimators import OwnConfig, make
from relloc_env.estimators.checks import check_finite, check_finite_prior, trust
from relloc_env.estimators.registry import Factory
from relloc_env.files import whole, write_whole
from relloc_env.folders import open_folder
from relloc_env.logs import Limits, Log, LogError
from relloc_env.logs.checks import LIMITS
from relloc_env.logs.episode import HEADER
from relloc_env.logs.text import stored
from relloc_env.metrics import TrajectoryBound
from relloc_env.replay import report, scores
from relloc_env.replay.bound import BOUND, NEEDS, bound_of
from relloc_env.replay.opening import open_logs
from relloc_env.replay.settings import Config, configure, unfit
from relloc_env.samples import ordered_pairs

Progress = Callable[[str, float], None]
"""Called with what is being done, and the part of all the work that is done."""


@dataclass(frozen=True)
class Run:
    """One estimator on one log."""

    log: Log
    estimator: str
    config: Config
    trace: scores.Trace
    depth: scores.DepthErrors | None
    tracks: list[dict[str, Any]]
    poses: list[scores.PoseErrors]
    """Per ordered pair; empty without truth."""

    def summary(self) -> dict[str, Any]:
        """Plain data: scores of this run."""
        pairs = ordered_pairs(len(self.log.robots))[: len(self.poses)]
        return {
            "log": self.log.name,
            "robots": list(self.log.robots),
            "from_s": float(self.log.time[0]),
            "to_s": float(self.log.time[-1]),
            "depth": {**scores.summarise_tracks(self.tracks), "per_track": self.tracks},
            "pose": [
                {
                    "observer": self.log.robots[a],
                    "observed": self.log.robots[b],
                    **scores.summarise_pose(scores.per_second(self.log.time, errors)),
                    "bound": scores.bound_by_second(self.log.time, errors),
                }
                for (a, b), errors in zip(pairs, self.poses, strict=True)
            ],
        }


@dataclass(frozen=True)
class ReplayResult:
    """Scores of one or more estimators on one or more logs."""

    path: Path
    options: dict[str, Any]
    runs: dict[str, list[Run]]
    """Per estimator's name, one run per log."""
    warnings: tuple[str, ...] = ()
    """What is odd about the logs and the choice of estimators, in words."""

    @property
    def bounded(self) -> bool:
        """Whether errors are held against the information bound."""
        every = (run for runs in self.runs.values() for run in runs)
        return any(run.depth is not None and np.isfinite(run.depth.bound_sd).any() for run in every)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, as in replay.json."""
        some = next(iter(self.runs.values()))
        return {
            "path": str(self.path),
            "kind": some[0].log.kind,
            "velocity": some[0].log.velocity,
            "options": self.options,
            "warnings": list(self.warnings),
            "nees_band_95": list(scores.NEES_BAND),
            "nees_median_expected": scores.NEES_MEDIAN,
            "whitened_error_band_95": list(scores.RATIO_BAND),
            "bound": BOUND if self.bounded else NEEDS,
            "depth_sure_below_sd_m": scores.SURE,
            "estimate_exists_below": {"position_sd_m": scores.CERTAIN[0], "heading_sd_rad": scores.CERTAIN[1]},
            "estimators": {
                name: {
                    "config": _plain(runs[0].config),
                    "depth": scores.summarise_tracks([track for run in runs for track in run.tracks]),
                    "pose": self._pose(runs),
                    "logs": [run.summary() for run in runs],
                }
                for name, runs in self.runs.items()
            },
        }

    @staticmethod
    def _pose(runs: list[Run]) -> dict[str, Any] | None:
        series = [scores.per_second(run.log.time, errors) for run in runs for errors in run.poses]
        return scores.summarise_pose(scores.join(series)) if series else None

    def table(self) -> tuple[list[str], list[list[str]]]:
        """Heads and cells of what the command prints, one row per estimator."""
        return report.table(self.to_dict())

    def notes(self) -> list[str]:
        """What the figures of the table are, for beside it."""
        return report.notes(self.to_dict())

    def save(self, out: str | Path) -> list[Path]:
        """Write replay.json, the series behind the figures (replay.npz) and the figures; return what was written."""
        folder = open_folder(out)
        results = folder / "replay.json"
        write_whole(results, json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n")
        arrays: dict[str, Any] = {}
        for name, runs in self.runs.items():
            for i, run in enumerate(runs):
                arrays[f"{name}/{i}/time"] = run.log.time
                if run.depth is not None:
                    arrays[f"{name}/{i}/depth_error"] = run.depth.error.astype(np.float32)
                for p, errors in enumerate(run.poses):
                    arrays[f"{name}/{i}/pose_error_{p}"] = errors.error.astype(np.float32)
                    arrays[f"{name}/{i}/nees_{p}"] = errors.nees.astype(np.float32)
                    if errors.bound is not None and errors.ratio is not None:
                        arrays[f"{name}/{i}/bound_{p}"] = errors.bound.astype(np.float32)
                        arrays[f"{name}/{i}/whitened_error_{p}"] = errors.ratio.astype(np.float32)
        series = folder / "replay.npz"
        with whole(series) as partial:
            np.savez_compressed(partial, **arrays)
        from relloc_env.replay.figures import draw

        return [results, series, *draw(self, folder)]


def _plain(config: Config) -> dict[str, Any]:
    """A configuration as plain data; a factory that cannot be found again is left out."""
    placed = not isinstance(config, OwnConfig) or config.has_place
    return config.model_dump(mode="json", exclude=None if placed else {"factory"})


def trace(log: Log, config: Config, progress: Callable[[float], None] | None = None) -> scores.Trace:
    """Run one estimator over a log, sample by sample, and keep what it believed after each."""
    count, robots, points = len(log), len(log.robots), len(log.points)
    pairs = len(ordered_pairs(robots))
    kept = scores.Trace(
        points=np.zeros((count, robots, points, 3)),
        points_covariance=np.zeros((count, robots, points, 3, 3)),
        known=np.zeros((count, robots, points), dtype=np.bool_),
        pose=np.zeros((count, pairs, 3)),
        pose_covariance=np.zeros((count, pairs, 3, 3)),
    )
    window = 1 + max(int(bits).bit_length() - 1 for bits in np.append(np.unique(log.samples.arrived), np.uint64(1)))
    estimator = make(config, 1, robots, points, message_window=window)
    trust(estimator)
    rows = np.zeros(1, dtype=np.int64)
    check_finite(log.samples, rows)
    check_finite_prior(log.prior, rows)
    estimator.reset(log.prior, rows)
    for k, block in enumerate(log.blocks()):
        estimator.update(block, rows)
        for array, value in zip(kept, estimator.estimate, strict=True):
            array[k] = value[0]
        if progress is not None and k % 200 == 0:
            progress(k / count)
    return kept


def run_estimator(
    log: Log,
    name: str,
    config: Config,
    progress: Callable[[float], None] | None = None,
    bound: TrajectoryBound | None = None,
) -> Run:
    """Run and score one estimator on one log; without truth there is a trace and no score."""
    kept = trace(log, config, progress)
    if log.truth is None:
        return Run(log, name, config, kept, None, [], [])
    depth = scores.depth_errors(log, kept, bound)
    poses = [
        scores.pose_errors(log, kept, p, int(a), int(b), bound)
        for p, (a, b) in enumerate(ordered_pairs(len(log.robots)))
    ]
    return Run(log, name, config, kept, depth, scores.score_tracks(log, depth), poses)


def replay(
    path: str | Path,
    *,
    robots: Sequence[int] | None = None,
    start: float | None = None,
    stop: float | None = None,
    velocity: str | None = None,
    estimator: str | Config | Mapping[str, Any] | Factory | Sequence[str] | None = None,
    pose_model: str | None = None,
    initial_depth: tuple[float, float] | None = None,
    initial_depth_error: float | None = None,
    initial_pose_error: tuple[float, float, float] | None = None,
    limits: Limits = LIMITS,
    out: str | Path | None = None,
    progress: Progress | None = None,
) -> ReplayResult:
    """Run estimators on a recorded log as a source of the same observations, and score them.

    Args:
        path, robots, start, stop, velocity, limits: see `open_logs`.
        estimator: one or several names, a configuration, or your own (`relloc_env.estimators.OwnConfig`); default: the
            best of the project's on this kind of log and the paper's cascade beside it.
        pose_model: "position", "velocity" or "printed": observation model of the cascade's pose filter.
        initial_depth: [m] one first guess of the depth for every track and its standard deviation; no truth is used.
        initial_depth_error: [m] the first depth guess is the truth plus this; default +1 for STAR-loc, as in the
            paper; without truth (MR.CLAM, by default) a guess of 3 ± 2 m. Own logs keep the prior they were made with.
        initial_pose_error: [m, m, rad] the first pose guess is the truth plus this; default: no truth.
        out: folder for replay.json, replay.npz and figures; default: nothing is written.
        progress: called now and then.

    Raises:
        LogError: what is wrong with the files, naming file and line.
        ValueError: what is wrong with the arguments.
    """
    logs = open_logs(path, robots=robots, start=start, stop=stop, velocity=velocity, limits=limits)
    if initial_pose_error is not None and len(logs[0].robots) == 1:
        raise ValueError("Argument `initial_pose_error` must be left out for a log of one robot")
    if initial_depth is not None:
        if initial_depth_error is not None:
            raise ValueError("Argument `initial_depth` must be left out where `initial_depth_error` is given")
        logs = [log.with_depth_guess(*initial_depth) for log in logs]
    elif initial_depth_error is None and logs[0].kind == "starloc":
        initial_depth_error = 1.0
    if initial_depth_error is not None or initial_pose_error is not None:
        logs = [log.with_initial_error(depth=initial_depth_error, pose=initial_pose_error) for log in logs]
    if estimator is None:
        several = ["cascade-critical", "cascade"] if len(logs[0].robots) == 1 else ["map-alignment", "cascade"]
        estimator = ["cascade"] if pose_model is not None else several
    chosen: list[Any] = list(estimator) if isinstance(estimator, list | tuple) else [estimator]
    out = None if out is None else open_folder(out)
    try:
        bounds = [bound_of(log) for log in logs]
    except ConfigError as error:
        raise LogError(stored(Path(path) / HEADER), f"`configuration` must be an environment's, but: {error}") from None
    odd = [unfit(logs[0], each) for each in chosen]
    warnings = [*(words for log in logs for words in log.warnings), *(words for words in odd if words is not None)]
    runs: dict[str, list[Run]] = {}
    total, done = len(chosen) * len(logs), 0
    for each in chosen:
        config = configure(logs[0], each, pose_model)
        name = config.name if isinstance(config, OwnConfig) else each if isinstance(each, str) else config.kind
        runs[name] = []
        for log, bound in zip(logs, bounds, strict=True):

            def tell(part: float, log: Log = log, name: str = name, done: int = done) -> None:
                if progress is not None:
                    progress(f"{name} on {log.name}", (done + part) / total)

            runs[name].append(run_estimator(log, name, config, tell, bound))
            done += 1
    options = {
        "robots": None if robots is None else list(robots),
        "from_s": start,
        "to_s": stop,
        "velocity": logs[0].velocity,
        "estimators": list(runs),
        "pose_model": pose_model,
        "initial_depth_m": None if initial_depth is None else list(initial_depth),
        "initial_depth_error_m": initial_depth_error,
        "limits": asdict(limits),
        "initial_pose_error": None if initial_pose_error is None else list(initial_pose_error),
    }
    result = ReplayResult(Path(path), options, runs, tuple(dict.fromkeys(warnings)))
    if out is not None:
        result.save(out)
    return result
