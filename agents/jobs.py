"""What a benchmark of motions is asked for, and the jobs that this makes: one agent, one suite, one estimator each."""

import hashlib
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import relloc_env
from agents.errors import place_of
from agents.learned import PREFIX, files
from agents.policy import Task
from agents.registry import agent, needs, short
from relloc_env.config import TASKS, ConfigError, EnvConfig, load_config, merge, override
from relloc_env.quoting import quote
from relloc_env.scenarios import SEEDS, seeds, suite

ALIGN_EVERY = 20
"""[samples] between two alignments of `map-alignment` in the benchmark: one a second."""


def robots_of(env: str) -> int:
    """Number of robots of an id.

    Raises:
        ValueError: an id that is none.
    """
    if env not in TASKS:
        raise ValueError(f"Argument `env` must be one of {', '.join(TASKS)}, but is {quote(env)}")
    return TASKS[env]


def shown_in(env: str, which: str, name: str, estimator: str, options: Sequence[str] = ()) -> EnvConfig:
    """The configuration of a suite's first variant for an agent, its estimator as it is; `options` as of `Asked`."""
    over = {**_overriding(options), **needs(name)}
    return load_config(merge(suite(which).variants[0], over), robots=robots_of(env), estimator=estimator)


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
    options: tuple[str, ...] = ()
    """Of the environment, over those of every suite: `path.to.option=value` each."""

    def check(self) -> None:
        """Raise ValueError for a name that is none, or an agent or estimator that cannot be built."""
        robots = robots_of(self.env)
        for argument in ("suites", "agents", "estimators"):
            if not getattr(self, argument):
                raise ValueError(f"Argument `{argument}` must name at least one, but names none")
        for name in self.suites:
            suite(name)
        _overriding(self.options)
        most = len(SEEDS.get(self.seeds, ()))
        if most and not 1 <= self.episodes <= most:
            raise ValueError(
                f"Argument `episodes` must be from 1 to {most} for the seeds `{self.seeds}`, but is {self.episodes}"
            )
        seeds(self.seeds, self.episodes)
        for name in self.estimators:
            load_config(None, robots=robots, estimator=name)
        for name in self.agents:
            agent(name)
            refusals = self._refusals(name) if name.startswith(PREFIX) else {}
            if len(refusals) == len(self.suites):
                raise next(iter(refusals.values()))
            fitting = next(each for each in self.suites if each not in refusals)
            try:
                self._build(fitting, name)
            except Exception as error:  # anyone's agent may raise anything
                place = place_of(error, agent(name))
                if place is None:
                    raise
                raise ValueError(
                    f"Argument `agents` must lead to a class that takes a task, but {name!r} fails in {place}: "
                    f"{type(error).__name__}: {error}"
                ) from error

    def _build(self, which: str, name: str) -> None:
        """Build an agent for each variant of a suite."""
        job = Job(self.env, which, name, self.estimators[0], self.episodes, self.seeds, self.options)
        for config, _ in job.configurations():
            agent(name)(Task.of(config))

    def _refusals(self, name: str) -> dict[str, ValueError]:
        """Suites that a learned policy was not made for, and what it says of each."""
        found = {}
        for which in self.suites:
            try:
                self._build(which, name)
            except ValueError as error:
                found[which] = error
        return found

    def unfit(self) -> dict[str, tuple[str, ...]]:
        """Learned policies that were not made for some of the suites, and these suites: they are left out."""
        found = {name: tuple(self._refusals(name)) for name in self.agents if name.startswith(PREFIX)}
        return {name: which for name, which in found.items() if which}

    def jobs(self) -> Iterator["Job"]:
        """Every agent on every suite with every estimator."""
        for name in self.suites:
            for estimator in self.estimators:
                for each in self.agents:
                    yield Job(self.env, name, each, estimator, self.episodes, self.seeds, self.options)


@dataclass(frozen=True)
class Job:
    """One agent on one suite with one estimator."""

    env: str
    suite: str
    agent: str
    estimator: str
    episodes: int
    seeds: str
    options: tuple[str, ...] = ()

    @property
    def files(self) -> str:
        """Digest of the files that its agent and estimator are read from; nothing where these are the project's."""
        return file_digest(self.agent) + file_digest(self.estimator)

    @property
    def title(self) -> str:
        """What it is, in words."""
        return f"{self.suite}: {self.agent} ({self.estimator})"

    @property
    def file(self) -> str:
        """Name of its file of results."""
        return f"{self.suite}--{_slug(self.agent)}--{_slug(self.estimator)}.npz"

    def configurations(self) -> list[tuple[EnvConfig, list[int]]]:
        """The configuration of each variant of the suite, and its seeds."""
        dealt = suite(self.suite).deal(seeds(self.seeds, self.episodes))
        over = {**_overriding(self.options), **needs(self.agent)}
        return [(configure(merge(options, over), TASKS[self.env], self.estimator), each) for options, each in dealt]


def configure(options: dict[str, Any], robots: int, estimator: str) -> EnvConfig:
    """The configuration of a suite's options for an id, with an estimator; map alignment aligns once a second."""
    config = load_config(options, robots=robots, estimator=estimator)
    inside = config.estimator
    if inside is not None and inside.kind == "map-alignment":
        stated = {**inside.model_dump(exclude_unset=True), "align_every": ALIGN_EVERY, "kind": inside.kind}
        config = load_config(options, robots=robots, estimator=stated)
    return config


def _overriding(options: Sequence[str]) -> dict[str, Any]:
    """Options of the environment that were given as texts.

    Raises:
        ConfigError: a text of another form, or an option that is asked for elsewhere.
    """
    found: dict[str, Any] = {}
    for text in options:
        override(found, text)
    for name, elsewhere in (("robots", "env"), ("estimator", "estimators")):
        if name in found:
            raise ConfigError(f"Argument `options` must not have `{name}`, which `{elsewhere}` says")
    if "observation" in found:
        raise ConfigError("Argument `options` must not have `observation`: each agent says what it observes")
    return found


def _slug(name: str) -> str:
    """A name as part of a file's name: of one with a path, its short name and a mark of the whole."""
    return f"{short(name)}-{zlib.crc32(name.encode()):08x}" if ":" in name else name
