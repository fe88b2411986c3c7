"""The benchmark of motions: agents on suites, with one or several estimators; resumable, on all cores.

A folder of results holds `benchmark.json`, what was asked for, and one `.npz` file for each suite, agent and estimator.
A file is put in its place whole, once its episodes are over: what was stopped is done again, what is there is not.
"""

import hashlib
import json
import os
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import asdict, dataclass, field
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import relloc_env
from agents.learned import PREFIX, files
from agents.playing import CURVES, SCORES, play, quartiles
from agents.policy import Task
from agents.registry import agent, short
from relloc_env.config import EnvConfig, load_config
from relloc_env.samples import Float
from relloc_env.scenarios import seeds, suite

IDS = {"relloc_env/ActiveDepth-v0": 1, "relloc_env/RelativePose-v0": 2}
"""Number of robots of each id."""
ASKED = "benchmark.json"
ALIGN_EVERY = 20
"""[samples] between two alignments of `map-alignment` in the benchmark: one a second."""
BATCH = 500
"""Most episodes side by side."""
ABOUT = ("act_seconds", "knows_truth", "files")
"""Fields of a result that are kept beside its job."""

Tell = Callable[[str, float], None]
"""Called with what is being done, and the part of all the work that is done."""


@cache
def code_digest() -> str:
    """Digest of the sources that results depend on: the package's and the agents'."""
    roots = (Path(relloc_env.__file__).parent, Path(__file__).parent)
    files = sorted(path for root in roots for path in root.rglob("*.py") if "report" not in path.parts)
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:12]


def file_digest(name: str) -> str:
    """Digest of the files that an agent or estimator with a path is read from; nothing for one of the project's."""
    own = name.rpartition(":")[0]
    sources = files(name.removeprefix(PREFIX)) if name.startswith(PREFIX) else [Path(own)] if own else []
    found = [each.read_bytes() for each in sources if each.is_file()]
    return hashlib.sha256(b"".join(found)).hexdigest()[:12] if found else ""


@dataclass(frozen=True)
class Asked:
    """What a folder of results holds."""

    env: str
    suites: tuple[str, ...]
    agents: tuple[str, ...]
    estimators: tuple[str, ...]
    episodes: int
    seeds: str
    version: str = field(default_factory=lambda: f"{relloc_env.__version__}+{code_digest()}")
    """Of the code that made the results."""

    def check(self) -> None:
        """Raise ValueError for a name that is none."""
        if self.env not in IDS:
            raise ValueError(f"Argument `env` must be one of {', '.join(IDS)}, but is {self.env!r}")
        for name in self.suites:
            suite(name)
        seeds(self.seeds, self.episodes)
        configurations = [load_config(None, robots=IDS[self.env], estimator=name) for name in self.estimators]
        for name in self.agents:
            build = agent(name)
            try:
                build(Task.of(configurations[0]))
            except TypeError as error:
                raise ValueError(
                    f"Argument `agents` must lead to a class that takes a task, but {name!r}: {error}"
                ) from error

    def jobs(self) -> Iterator["Job"]:
        """Everything there is to do."""
        for name in self.suites:
            for estimator in self.estimators:
                for each in self.agents:
                    yield Job(self.env, name, each, estimator, self.episodes, self.seeds)


@dataclass(frozen=True)
class Job:
    """One agent on one suite with one estimator."""

    env: str
    suite: str
    agent: str
    estimator: str
    episodes: int
    seeds: str

    @property
    def files(self) -> str:
        """Digest of the files that its agent and estimator are read from; nothing where these are the project's."""
        return file_digest(self.agent) + file_digest(self.estimator)

    def done(self, folder: Path) -> bool:
        """Whether its results are in a folder, of the agent and estimator as they are now."""
        path = folder / self.file
        return path.exists() and (not self.files or Result.load(path).files == self.files)

    @property
    def file(self) -> str:
        """Name of its file of results."""
        return f"{self.suite}--{_slug(self.agent)}--{_slug(self.estimator)}.npz"

    def configurations(self) -> list[tuple[EnvConfig, list[int]]]:
        """The configuration of each variant of the suite, and its seeds."""
        dealt = suite(self.suite).deal(seeds(self.seeds, self.episodes))
        return [(configure(dict(options), IDS[self.env], self.estimator), each) for options, each in dealt]


def configure(options: dict[str, Any], robots: int, estimator: str) -> EnvConfig:
    """The configuration of a suite's options for an id, with an estimator; map alignment aligns once a second."""
    config = load_config(options, robots=robots, estimator=estimator)
    inside = config.estimator
    if inside is not None and inside.kind == "map-alignment":
        stated = {**inside.model_dump(exclude_unset=True), "align_every": ALIGN_EVERY, "kind": inside.kind}
        config = load_config(options, robots=robots, estimator=stated)
    return config


@dataclass(frozen=True)
class Result:
    """What became of the episodes of one job, in the order of the seeds."""

    job: Job
    scores: dict[str, Float]
    """(N,) of each of `playing.SCORES`."""
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
            rest = {name: about.pop(name) for name in ABOUT}
            return cls(
                job=Job(**about),
                scores={name: data[f"score/{name}"] for name in SCORES},
                time=data["time"],
                curves={name: data[f"curve/{name}"].astype(np.float64) for name in CURVES},
                ways=data["ways"].astype(np.float64),
                points=data["points"],
                **rest,
            )


class _Clock:
    """A policy that notes how long another takes."""

    def __init__(self, policy: Any) -> None:
        self._policy, self.seconds, self.actions = policy, 0.0, 0
        self.knows_truth = getattr(policy, "knows_truth", False)

    def reset(self, n: int, seed: int) -> None:
        """As the other."""
        self._policy.reset(n, seed)

    def see(self, poses: Any, points: Any) -> None:
        """As the other."""
        start = time.perf_counter()
        self._policy.see(poses, points)
        self.seconds += time.perf_counter() - start

    def act(self, observations: Any) -> Any:
        """As the other."""
        start = time.perf_counter()
        actions = self._policy.act(observations)
        self.seconds += time.perf_counter() - start
        self.actions += len(observations)
        return actions


def run(job: Job, threads: int | None = 1) -> Result:
    """Play all episodes of a job."""
    build, clocks = agent(job.agent), []

    def timed(task: Any) -> _Clock:
        clocks.append(_Clock(build(task)))
        return clocks[-1]

    order: list[int] = []
    scores: dict[str, list[Float]] = {name: [] for name in SCORES}
    curves: dict[str, list[Float]] = {}
    kept: tuple[Float, Float] | None = None
    for config, dealt in job.configurations():
        for first in range(0, len(dealt), BATCH):
            part = dealt[first : first + BATCH]
            found, over = play(config, timed, part, threads=threads)
            order += part
            for name, value in found.items():
                scores[name].append(value)
            for name in CURVES:
                curves.setdefault(name, []).append(over[name])
            when = over["time"]
            if kept is None:
                kept = over["ways"], over["points"]
    assert kept is not None
    at = np.argsort(order)
    spent, actions = sum(clock.seconds for clock in clocks), sum(clock.actions for clock in clocks)
    return Result(
        job=job,
        scores={name: np.concatenate(value)[at] for name, value in scores.items()},
        time=when,
        curves={name: quartiles(np.concatenate(value)) for name, value in curves.items()},
        ways=kept[0],
        points=kept[1],
        act_seconds=spent / max(1, actions),
        knows_truth=any(clock.knows_truth for clock in clocks),
        files=job.files,
    )


def benchmark(asked: Asked, out: Path, *, cores: int | None = None, tell: Tell = lambda *_: None) -> list[Path]:
    """Do whatever is asked for and not there yet; return the files of all results.

    Raises:
        ValueError: names that are none, or a folder that holds the results of something else.
    """
    asked.check()
    out.mkdir(parents=True, exist_ok=True)
    _claim(asked, out)
    jobs = list(asked.jobs())
    ahead = [job for job in jobs if not job.done(out)]
    done = len(jobs) - len(ahead)
    tell("", done / len(jobs))
    workers = max(1, min(cores or os.cpu_count() or 1, len(ahead)))
    if workers == 1:
        for job in ahead:
            run(job, cores).save(out)
            done += 1
            tell(_title(job), done / len(jobs))
    else:
        with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
            # The first of each estimator compiles what is not there yet; the others find it.
            failed: list[str] = []
            waiting: dict[Future[None], Job] = {pool.submit(_work, job, out): job for job in ahead}
            try:
                while waiting:
                    over, _ = wait(waiting, return_when=FIRST_COMPLETED)
                    for future in over:
                        job = waiting.pop(future)
                        error = future.exception()
                        if error is not None:
                            failed.append(f"{_title(job)}: {type(error).__name__}: {error}")
                        done += 1
                        tell(_title(job), done / len(jobs))
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
        if failed:
            raise ValueError("Not all was played; what was is kept. " + "; ".join(failed))
    return [out / job.file for job in jobs]


def _work(job: Job, out: Path) -> None:
    run(job).save(out)


def _claim(asked: Asked, out: Path) -> None:
    """Write what is asked for into the folder, or raise where its results cannot stand beside these."""
    path = out / ASKED
    if path.exists():
        before = json.loads(path.read_text(encoding="utf-8"))
        for name in ("env", "episodes", "seeds", "version"):
            if before[name] != getattr(asked, name):
                raise ValueError(
                    f"Argument `out` must be a folder of its own: {out} has results of {name} {before[name]!r}, "
                    f"not {getattr(asked, name)!r}"
                )
        for name in ("suites", "agents", "estimators"):
            before[name] = list(dict.fromkeys([*before[name], *getattr(asked, name)]))
    else:
        before = asdict(asked)
    partial = out / f".{ASKED}.{os.getpid()}"
    partial.write_text(json.dumps(before, indent=1) + "\n", encoding="utf-8")
    partial.replace(path)


def load(out: Path) -> tuple[Asked, list[Result]]:
    """What a folder was asked for, and the results that are there.

    Raises:
        ValueError: a folder without results.
    """
    path = out / ASKED
    if not path.exists():
        raise ValueError(f"Argument `out` must be a folder of `benchmark`, but {out} has no {ASKED}")
    data: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    stated: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in data.items()}
    asked = Asked(**stated)
    return asked, [Result.load(out / job.file) for job in asked.jobs() if (out / job.file).exists()]


def of(results: Sequence[Result], **which: str) -> list[Result]:
    """Those of a suite, an agent or an estimator."""
    return [r for r in results if all(getattr(r.job, name) == value for name, value in which.items())]


def _title(job: Job) -> str:
    return f"{job.suite}: {job.agent} ({job.estimator})"


def _slug(name: str) -> str:
    """A name as part of a file's name: of one with a path, its short name and a mark of the whole."""
    return f"{short(name)}-{zlib.crc32(name.encode()):08x}" if ":" in name else name
