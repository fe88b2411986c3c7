"""A folder of results: `benchmark.json`, what was asked for and what failed, and a `.npz` file for each job.

Files are put in their place whole: what was stopped is done again, what is there is not.
"""

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agents.errors import AgentError
from agents.jobs import Asked, Job
from agents.playing import CURVES, SCORES
from relloc_env.samples import Float

ASKED = "benchmark.json"
FAILED = "failed"
"""Entry of `benchmark.json`: jobs that raised."""
ABOUT = ("act_seconds", "knows_truth", "files")
"""Fields of a result that are kept beside its job."""


@dataclass(frozen=True)
class Result:
    """What became of the episodes of one job, in the order of the seeds."""

    job: Job
    scores: dict[str, Float]
    """(N,) of each of `playing.SCORES`; NaN for those that were none when it was made."""
    time: Float
    """[s] (T,)"""
    curves: dict[str, Float]
    """(3, T) quartiles over the episodes, of each of `playing.CURVES`."""
    ways: Float
    """[m, m, rad] (K, T, R, 3) of the first episodes."""
    points: Float
    """[m] (K, M, 3)"""
    act_seconds: float
    """[s] that the agent takes for an action of one environment, in the batch."""
    knows_truth: bool
    """Whether the agent was shown the truth."""
    files: str
    """`file_digest` of the agent and of the estimator."""

    def save(self, folder: Path) -> None:
        """Write the file of the job, whole or not at all."""
        arrays: dict[str, Any] = {f"score/{name}": value for name, value in self.scores.items()}
        arrays |= {f"curve/{name}": value.astype(np.float32) for name, value in self.curves.items()}
        arrays |= {"time": self.time, "ways": self.ways.astype(np.float32), "points": self.points}
        arrays["job"] = json.dumps(asdict(self.job) | {name: getattr(self, name) for name in ABOUT})
        partial = folder / f".{self.job.file}.{os.getpid()}"
        with partial.open("wb") as file:
            np.savez_compressed(file, **arrays)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(folder / self.job.file)

    @classmethod
    def load(cls, path: Path) -> "Result":
        """Read what `save` wrote."""
        with np.load(path) as data:
            about = json.loads(str(data["job"]))
            about["options"] = tuple(about.get("options", ()))
            rest = {name: about.pop(name) for name in ABOUT}
            none = np.full(len(data[f"score/{next(iter(SCORES))}"]), np.nan)
            return cls(
                job=Job(**about),
                scores={name: data.get(f"score/{name}", none) for name in SCORES},
                time=data["time"],
                curves={name: data[f"curve/{name}"].astype(np.float64) for name in CURVES},
                ways=data["ways"].astype(np.float64),
                points=data["points"],
                **rest,
            )


@dataclass(frozen=True)
class Failure:
    """A job that raised, and what."""

    suite: str
    agent: str
    estimator: str
    error: str

    @classmethod
    def of(cls, job: Job, error: BaseException) -> "Failure":
        """That of a job."""
        words = f"{type(error).__name__}: {error}"
        if isinstance(error, AgentError):
            words = f"{error.reason} ({Path(error.place).name})"
        return cls(job.suite, job.agent, job.estimator, words)

    def __str__(self) -> str:
        return f"{self.suite}: {self.agent} ({self.estimator}): {self.error}"


def done(job: Job, folder: Path) -> bool:
    """Whether the results of a job are in a folder, of the agent and estimator as they are now."""
    path = folder / job.file
    return path.exists() and (not job.files or Result.load(path).files == job.files)


def claim(asked: Asked, out: Path) -> None:
    """Write what is asked for into the folder, or raise where its results cannot stand beside these."""
    data: dict[str, Any] = asdict(asked) | {FAILED: []}
    if (out / ASKED).exists():
        data = _read(out)
        theirs = _asked(data)
        for name in ("env", "episodes", "seeds", "version", "options"):
            if getattr(theirs, name) != getattr(asked, name):
                raise ValueError(
                    f"Argument `out` must be a folder of its own: {out} has results of {name} "
                    f"{getattr(theirs, name)!r}, not {getattr(asked, name)!r}"
                )
        for name in ("suites", "agents", "estimators"):
            data[name] = list(dict.fromkeys([*data[name], *getattr(asked, name)]))
        again = {(job.suite, job.agent, job.estimator) for job in asked.jobs()}
        data[FAILED] = [f for f in data[FAILED] if (f["suite"], f["agent"], f["estimator"]) not in again]
    _write(out, data)


def note_failures(out: Path, failed: Sequence[Failure]) -> None:
    """Write into the folder what failed; who has no result at all is asked for no more."""
    data = _read(out)
    data[FAILED] += [asdict(failure) for failure in failed]
    there = [job for job in _asked(data).jobs() if (out / job.file).exists()]
    for names, name in (("agents", "agent"), ("estimators", "estimator"), ("suites", "suite")):
        gone = {getattr(failure, name) for failure in failed} - {getattr(job, name) for job in there}
        data[names] = [one for one in data[names] if one not in gone]
    _write(out, data)


def load(out: Path) -> tuple[Asked, list[Result]]:
    """What a folder was asked for, and the results that are there.

    Raises:
        ValueError: a folder without results.
    """
    asked = _asked(_read(out))
    return asked, [Result.load(out / job.file) for job in asked.jobs() if (out / job.file).exists()]


def failures(out: Path) -> list[Failure]:
    """What failed in a folder, and was not done since."""
    return [Failure(**data) for data in _read(out)[FAILED]]


def of(results: Sequence[Result], **which: str) -> list[Result]:
    """Those of a suite, an agent or an estimator."""
    return [r for r in results if all(getattr(r.job, name) == value for name, value in which.items())]


def _asked(data: dict[str, Any]) -> Asked:
    stated: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in data.items()}
    stated.pop(FAILED)
    return Asked(**stated)


def _read(out: Path) -> dict[str, Any]:
    path = out / ASKED
    if not path.exists():
        raise ValueError(f"Argument `out` must be a folder of `benchmark`, but {out} has no {ASKED}")
    data: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return {FAILED: []} | data


def _write(out: Path, data: dict[str, Any]) -> None:
    partial = out / f".{ASKED}.{os.getpid()}"
    partial.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    partial.replace(out / ASKED)
