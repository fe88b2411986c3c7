"""The benchmark of motions: agents on suites, with one or several estimators; resumable, on all cores."""

import os
import time
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from agents.alone import alone
from agents.errors import code_of
from agents.jobs import Asked, Job
from agents.playing import CURVES, SCORES, play, quartiles
from agents.registry import agent
from agents.results import Failure, Result, claim, done, note_failures
from agents.workers import pool
from relloc_env.folders import open_folder
from relloc_env.samples import Float

BATCH = 500
"""Most episodes side by side."""

Over = Generator[tuple[Job, BaseException | None], None, None]
"""Jobs that are over, with what they raised."""
Tell = Callable[[str, float], None]
"""Called with what is being done, and the part of all the work that is done."""


def benchmark(asked: Asked, out: Path, *, cores: int | None = None, tell: Tell = lambda *_: None) -> list[Path]:
    """Do whatever is asked for and not there yet; return the files of all results.

    Raises:
        ValueError: names that are none, a folder that holds the results of something else or that another process
            works on, or, once all else is done, jobs that failed.
    """
    asked.check()
    out = open_folder(out)
    with alone(out):
        return _benchmark(asked, out, cores, tell)


def _benchmark(asked: Asked, out: Path, cores: int | None, tell: Tell) -> list[Path]:
    """As `benchmark`, in a folder that nobody else works on."""
    claim(asked, out)
    unfit = asked.unfit()
    jobs = [job for job in asked.jobs() if job.suite not in unfit.get(job.agent, ())]
    ahead = [job for job in jobs if not done(job, out)]
    count = len(jobs) - len(ahead)
    tell("", count / len(jobs))
    workers = max(1, min(cores or os.cpu_count() or 1, len(ahead)))
    failed = []
    with closing(_one_by_one(ahead, out, cores) if workers == 1 else _side_by_side(ahead, out, workers)) as over:
        for job, error in over:
            if error is not None:
                failed.append(Failure.of(job, error))
            count += 1
            tell(job.title, count / len(jobs))
    if failed:
        note_failures(out, failed)
        raise ValueError("Not all was played; what was is kept. " + "; ".join(map(str, failed)))
    return [out / job.file for job in jobs]


def _one_by_one(jobs: Sequence[Job], out: Path, cores: int | None) -> Over:
    """Do jobs here."""
    for job in jobs:
        try:
            run(job, cores).save(out)
        except Exception as error:  # noqa: BLE001 - anyone's agent may raise anything; the others are played
            yield job, error
        else:
            yield job, None


def _side_by_side(jobs: Sequence[Job], out: Path, workers: int) -> Over:
    """Do jobs in processes of their own."""
    with pool(workers) as executor:
        # The first of each estimator compiles what is not there yet; the others find it.
        waiting: dict[Future[None], Job] = {executor.submit(_work, job, out): job for job in jobs}
        while waiting:
            over, _ = wait(waiting, return_when=FIRST_COMPLETED)
            for future in over:
                yield waiting.pop(future), future.exception()


def _work(job: Job, out: Path) -> None:
    run(job).save(out)


def run(job: Job, threads: int | None = 1) -> Result:
    """Play all episodes of a job."""
    build, clocks = agent(job.agent), []

    def timed(task: Any) -> _Clock:
        with code_of(job.agent, build):
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


class _Clock:
    """A policy that notes how long another takes."""

    def __init__(self, policy: Any) -> None:
        self._policy, self.seconds, self.actions = policy, 0.0, 0
        self.what = type(policy).__name__
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
