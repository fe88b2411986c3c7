"""A folder of results: `benchmark.json`, what was asked for and what failed, and a `.npz` file for each job.

Files are put in their place whole: what was stopped is done again, what is there is not, unless its checksum does not
hold. One process at a time works on a folder.
"""

import hashlib
import io
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from agents.errors import AgentError
from agents.jobs import Asked, Job, robots_of
from agents.playing import CURVES, SCORES
from relloc_env.config import validate
from relloc_env.files import read_json, whole, write_json
from relloc_env.samples import Float

ASKED = "benchmark.json"
FAILED = "failed"
"""Entry of `benchmark.json`: jobs that raised."""
CHECKSUM = "checksum"
"""Entry of a `.npz` file: that of all others."""
ABOUT = ("act_seconds", "knows_truth", "files")
"""Fields of a result that are kept beside its job."""


class DamagedError(ValueError):
    """A file of results that is not what was written."""


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
        arrays["job"] = np.array(json.dumps(asdict(self.job) | {name: getattr(self, name) for name in ABOUT}))
        arrays[CHECKSUM] = np.array(_checksum(arrays))
        with whole(folder / self.job.file) as partial, partial.open("wb") as file:
            np.savez_compressed(file, **arrays)

    @classmethod
    def load(cls, path: Path) -> "Result":
        """Read what `save` wrote.

        Raises:
            DamagedError: a file that is not what was written.
        """
        try:
            with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
                data = dict(file)
            if str(data.pop(CHECKSUM)) != _checksum(data):
                raise ValueError("its checksum does not hold")  # noqa: TRY301 - as all else that can be wrong with it
            return cls._of(data)
        except Exception as error:  # damage raises anything: of zip, zlib, numpy, JSON, or for what is missing
            raise DamagedError(f"{path} is damaged ({type(error).__name__}: {error})") from error

    @classmethod
    def _of(cls, data: Mapping[str, Any]) -> "Result":
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


def _checksum(arrays: Mapping[str, Any]) -> str:
    """SHA-256 of arrays with their names, types and shapes."""
    found = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        found.update(repr((name, array.dtype.str, array.shape)).encode())
        found.update(array.tobytes())
    return found.hexdigest()


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
    """Whether the results of a job are in a folder, whole, and of the agent and estimator as they are now."""
    path = folder / job.file
    try:
        found = Result.load(path) if path.exists() else None
    except DamagedError:
        return False
    return found is not None and found.job == job and (not job.files or found.files == job.files)


def claim(asked: Asked, out: Path) -> None:
    """Write what is asked for into the folder, or raise where its results cannot stand beside these."""
    data: dict[str, Any] = asdict(asked) | {FAILED: ()}
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
            data[name] = tuple(dict.fromkeys([*data[name], *getattr(asked, name)]))
        again = {(job.suite, job.agent, job.estimator) for job in asked.jobs()}
        data[FAILED] = [f for f in data[FAILED] if (f["suite"], f["agent"], f["estimator"]) not in again]
    write_json(out / ASKED, data)


def note_failures(out: Path, failed: Sequence[Failure]) -> None:
    """Write into the folder what failed; who has no result at all is asked for no more."""
    data = _read(out)
    data[FAILED] = [*data[FAILED], *map(asdict, failed)]
    there = [job for job in _asked(data).jobs() if (out / job.file).exists()]
    for names, name in (("agents", "agent"), ("estimators", "estimator"), ("suites", "suite")):
        gone = {getattr(failure, name) for failure in failed} - {getattr(job, name) for job in there}
        data[names] = [one for one in data[names] if one not in gone]
    write_json(out / ASKED, data)


def load(out: Path, warn: Callable[[str], None] | None = None) -> tuple[Asked, list[Result]]:
    """What a folder was asked for, and the results that are there.

    Args:
        out: the folder.
        warn: called with which are damaged; these are left out then.

    Raises:
        ValueError: a folder without results, or one that is damaged.
    """
    asked, found = _asked(_read(out)), []
    for job in asked.jobs():
        try:
            if (out / job.file).exists():
                found.append(Result.load(out / job.file))
        except DamagedError as error:
            message = f"{error}: the command that made the results makes it again"
            if warn is None:
                raise DamagedError(message) from error
            warn(message)
    return asked, found


def failures(out: Path) -> list[Failure]:
    """What failed in a folder, and was not done since."""
    return [Failure(**data) for data in _read(out)[FAILED]]


def of(results: Sequence[Result], **which: str) -> list[Result]:
    """Those of a suite, an agent or an estimator."""
    return [r for r in results if all(getattr(r.job, name) == value for name, value in which.items())]


class _Folder(BaseModel):
    """Form of `benchmark.json`."""

    env: str
    suites: tuple[str, ...]
    agents: tuple[str, ...]
    estimators: tuple[str, ...]
    episodes: int
    seeds: str
    version: str
    options: tuple[str, ...] = ()
    failed: tuple[Failure, ...] = ()


def _asked(data: dict[str, Any]) -> Asked:
    return Asked(**{name: value for name, value in data.items() if name != FAILED})


def _read(out: Path) -> dict[str, Any]:
    path = out / ASKED
    if not path.exists():
        raise ValueError(f"Argument `out` must be a folder of `benchmark`, but {out} has no {ASKED}")
    try:
        data = validate(_Folder, read_json(path)).model_dump()
        robots_of(data["env"])
    except ValueError as error:
        raise DamagedError(f"{path} is not as `benchmark` writes it: {error}") from None
    return data
