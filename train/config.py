"""What a training run is told: a file, overrides on top, checked as a whole; plain data and back without loss."""

import inspect
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, field_validator, model_validator

from agents.playing import SCORES
from agents.policy import Task
from agents.registry import AGENTS, agent, refuse_agents, runs_code
from relloc_env.config import ConfigError, EnvConfig, hint, load_config, override, read_file, validate
from relloc_env.config.base import Model
from relloc_env.envs.variation import Choice, Stage, Variation
from relloc_env.extras import extra
from relloc_env.places import refuse_code
from relloc_env.quoting import quote, word
from relloc_env.scenarios import suite

CONFIGS = Path(__file__).parent / "configs"
"""Folder of the published configurations."""

Count = Annotated[int, Field(ge=1)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
ALGORITHMS = ("PPO", "RecurrentPPO", "SAC", "TD3")
_OURS = ("self", "policy", "env", "seed", "device", "verbose", "tensorboard_log", "policy_kwargs", "_init_setup_model")
"""Arguments of Stable-Baselines3's algorithms that are set from elsewhere."""

PAIR = (
    "time_pose", "position_error_end", "heading_error_end", "position_error_area", "heading_bound_end", "over_bound",
    "nees",
)  # fmt: skip
"""Of `agents.playing.SCORES` those that one robot alone has not."""


def algorithm_class(name: str) -> Any:
    """The class of one of `ALGORITHMS`."""
    with extra("train"):
        import sb3_contrib
        import stable_baselines3

    return getattr(sb3_contrib if name == "RecurrentPPO" else stable_baselines3, name)


def _number(value: Any) -> Any:
    """YAML reads `3e-4` as text: numbers written so are numbers, at any depth."""
    if isinstance(value, Mapping):
        return {key: _number(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_number(each) for each in value]
    if isinstance(value, str) and re.fullmatch(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+", value):
        return float(value)
    return value


class EnvironmentConfig(Model):
    """The worlds to train in."""

    robots: Literal[1, 2] = 2
    decentralised: bool = False
    """whether each robot acts on its own observation, by one policy with shared parameters."""
    options: dict[str, Any] = {}  # noqa: RUF012 - frozen by pydantic's copy
    """of `relloc_env.config.EnvConfig`: reward weights, estimator, sensors."""
    stages: tuple[Stage, ...] = (Stage(),)
    """of a curriculum: suites, options, and what is drawn at random (`relloc_env.envs.variation.Stage`)."""
    groups: Count = 16
    """of environments of one configuration, where stages have several."""
    without: tuple[str, ...] = ()
    """fields of the observation that the policy does not get."""
    nearest_first: bool = False
    """whether the policy gets the points in the order in which a robot believes them to be near."""
    finite: bool = False
    """whether an episode's end is the end of its return, in place of the value of what would have followed."""
    random_phase: bool = True
    """whether the first episodes start at a random time, so that later ones do not all end together."""

    @model_validator(mode="after")
    def _possible(self) -> Self:
        fields = Task.of(self.layout).slices
        if self.decentralised and self.robots == 1:
            raise ValueError("Argument `environment.decentralised` must be false for one robot, but is true")
        if self.pictures and (self.varied or self.without or self.nearest_first):
            raise ValueError(
                "Argument `environment` must have no `stages`, `without` or `nearest_first` with "
                "`observation: image`, but has"
            )
        for name in self.without:
            if name not in fields:
                raise ValueError(
                    f"Argument `environment.without` must be of {', '.join(fields)}, but has {quote(name)}"
                )
        if self.nearest_first and self.layout.gain_names:
            raise ValueError("Argument `environment.nearest_first` must be false where actions set gains, but is true")
        return self

    @cached_property
    def shared(self) -> EnvConfig:
        """What all configurations have in common."""
        return load_config(self.options, robots=self.robots)

    @cached_property
    def varied(self) -> bool:
        """Whether there are several configurations."""
        return self.stages != (Stage(),)

    @cached_property
    def layout(self) -> EnvConfig:
        """The configuration with as many points as any: what the policy is laid out for."""
        return Variation(self.shared, self.stages).layout if self.varied else self.shared

    @property
    def pictures(self) -> bool:
        """Whether a policy sees what the cameras see, in place of numbers."""
        return self.layout.observation == "image"

    @property
    def fewest(self) -> int:
        """The fewest points of any configuration."""
        found: list[Any] = []
        for stage in self.stages:
            drawn = stage.vary.get("targets")
            if drawn is None:
                variants = suite(stage.suite).variants[: self.groups] if stage.suite else ({},)
                nominal = (load_config(load_config(self.shared, **each), **stage.options) for each in variants)
                found += [each.targets for each in nominal]
            else:
                found += drawn.choices if isinstance(drawn, Choice) else [drawn.least]
        return int(min(found))


class AlgorithmConfig(Model):
    """An algorithm of Stable-Baselines3 with its own keyword arguments."""

    model_config = ConfigDict(frozen=True, extra="allow")

    name: Literal["PPO", "RecurrentPPO", "SAC", "TD3"] = "PPO"
    learning_rate: Positive = 3e-4
    schedule: Literal["constant", "linear"] = "constant"
    """of the learning rate: linear falls to 0 at the end."""
    action_noise: Annotated[float, Field(ge=0.0)] = 0.0
    """[-] standard deviation of what SAC and TD3 add to actions to explore."""

    @model_validator(mode="after")
    def _arguments(self) -> Self:
        known = [
            name for name in inspect.signature(algorithm_class(self.name)).parameters
            if name not in (*_OURS, *type(self).model_fields)
        ]  # fmt: skip
        for name in self.model_extra or {}:
            if name not in known:
                raise ValueError(
                    f"Unknown option `algorithm.{name}` of {self.name}{hint(name, tuple(known))}; "
                    f"known: {', '.join(known)}"
                )
        if self.action_noise and self.name not in ("SAC", "TD3"):
            raise ValueError(f"Argument `algorithm.action_noise` must be 0 for {self.name}, but is {self.action_noise}")
        return self


class NetworkConfig(Model):
    """The policy's and the critic's networks."""

    policy: Literal["MlpPolicy", "MlpLstmPolicy", "CnnPolicy"] = "MlpPolicy"
    """with a memory for RecurrentPPO, with convolutions for pictures."""
    hidden: tuple[Count, ...] = (128, 128)
    activation: Literal["tanh", "relu", "elu"] = "tanh"
    log_std: float = -0.5
    """log of the standard deviation of actions at the start of PPO."""
    lstm: Count = 64
    """size of the memory of an MlpLstmPolicy."""


class NormaliseConfig(Model):
    """Running statistics of what comes in."""

    observations: bool = True
    rewards: bool = False
    clip: Positive = 10.0
    """[-] greatest normalised observation."""


class EvaluationConfig(Model):
    """What is played on validation seeds during training."""

    suite: str = "open-field"
    """whose variants the episodes are dealt out to, over the run's options."""
    variants: tuple[dict[str, Any], ...] | None = None
    """options of variants of one's own, in place of a suite's."""

    every: Count = 200_000
    """steps between two evaluations."""
    episodes: Count = 100
    options: dict[str, Any] = {}  # noqa: RUF012 - as above
    """options of the environment for what is evaluated, over the run's: another estimator than in training."""
    score: str = "information_end"
    """entry of `agents.playing.SCORES` by which the best policy is kept: more is better, or with a minus less."""
    test: Annotated[int, Field(ge=0)] = 400
    """episodes on test seeds for the card, at the end."""
    scripts: tuple[str, ...] | None = None
    """agents to compare with; None for all scripted and feedback ones."""
    script_options: dict[str, Any] = {}  # noqa: RUF012 - frozen by pydantic's copy
    """options of the environment for those, on top: another estimator, or actions without gains."""

    @field_validator("score")
    @classmethod
    def _known_score(cls, value: str) -> str:
        if value.removeprefix("-") not in SCORES:
            raise ValueError(f"must be one of {', '.join(SCORES)}{hint(value, tuple(SCORES))}, but is {quote(value)}")
        return value

    @field_validator("scripts")
    @classmethod
    def _known_scripts(cls, value: Iterable[str] | None) -> tuple[str, ...] | None:
        for name in value or ():
            if not runs_code(name):
                agent(name)
        return None if value is None else tuple(value)

    @property
    def agents(self) -> tuple[str, ...]:
        """Names of the agents to compare with."""
        return tuple(AGENTS) if self.scripts is None else self.scripts


class SearchConfig(Model):
    """What `tune` draws for one field: one of some values, or a number between two."""

    choices: tuple[Any, ...] | None = None
    low: float | None = None
    high: float | None = None
    log: bool = False
    """whether orders of magnitude are drawn rather than values."""

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        span = self.low is not None and self.high is not None and self.low < self.high
        if bool(self.choices) == span:
            raise ValueError("must have either `choices`, or `low` below `high`")
        return self

    def draw(self, trial: Any, name: str) -> Any:
        """What Optuna proposes."""
        if self.choices:
            return json.loads(trial.suggest_categorical(name, [json.dumps(each) for each in self.choices]))
        return trial.suggest_float(name, self.low, self.high, log=self.log)


class TrainConfig(Model):
    """A whole training run."""

    name: str
    """of the run, the folder and the policy."""
    about: str = ""
    environment: EnvironmentConfig = EnvironmentConfig()
    algorithm: AlgorithmConfig = AlgorithmConfig()
    network: NetworkConfig = NetworkConfig()
    normalise: NormaliseConfig = NormaliseConfig()
    num_envs: Count = 256
    """environments side by side."""
    steps: Count = 3_000_000
    """actions to train for: of all environments together, decentralised of all robots."""
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 1
    """of the starts, the noise and the networks."""
    threads: Count = 1
    """that torch and the environments run on; what is learned may depend on it in the last bit."""
    evaluation: EvaluationConfig = EvaluationConfig()
    checkpoint: Count = 100_000
    """steps between two checkpoints."""
    search: dict[str, SearchConfig] = {}  # noqa: RUF012 - as above
    """what `python -m train tune` draws, by `path.to.field`."""
    film: Literal["", "gif", "mp4"] = "gif"
    """form of the film of the best policy; "" for none, as it is by default for `observation: image`."""

    @field_validator("film", mode="before")
    @classmethod
    def _empty(cls, value: Any) -> Any:
        return "" if value is None else value  # `film=` on a command line

    @field_validator("name")
    @classmethod
    def _plain(cls, value: str) -> str:
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", value):
            raise ValueError(f"must be of letters, digits, dots, dashes and underscores, but is {quote(value)}")
        return value

    @model_validator(mode="after")
    def _fitting(self) -> Self:
        recurrent = self.network.policy == "MlpLstmPolicy"
        if recurrent != (self.algorithm.name == "RecurrentPPO"):
            raise ValueError("Argument `network.policy` must be MlpLstmPolicy for RecurrentPPO, and for it alone")
        self._check_pictures()
        least, most = self.environment.fewest, self.environment.layout.targets
        for each in self.played:
            if not least <= each.targets <= most:
                raise ValueError(
                    f"Argument `evaluation` must have as many points as in training, {least} to {most}, but has "
                    f"{each.targets}"
                )
        score = self.evaluation.score
        if score.removeprefix("-") in PAIR and any(each.robots == 1 for each in self.played):
            raise ValueError(f"Argument `evaluation.score` must be of what one robot alone has, but is {quote(score)}")
        return self

    def _check_pictures(self) -> None:
        """Raise where what the policy sees and something else do not go together."""
        pictures = self.environment.pictures
        if pictures != (self.network.policy == "CnnPolicy"):
            raise ValueError("Argument `network.policy` must be CnnPolicy for `observation: image`, and for it alone")
        if pictures and self.normalise.observations:
            raise ValueError("Argument `normalise.observations` must be false for `observation: image`, but is true")
        if pictures and "film" not in self.model_fields_set:
            object.__setattr__(self, "film", "")
        if pictures and self.film:
            raise ValueError(f'Argument `film` must be "" for `observation: image`, but is {quote(self.film)}')
        if any((each.observation == "image") != pictures for each in self.played):
            raise ValueError("Argument `evaluation` must have the same `observation` as in training, but has another")

    @cached_property
    def played(self) -> list[EnvConfig]:
        """The configurations of the episodes that are evaluated."""
        given = self.evaluation.variants
        variants: Sequence[Mapping[str, Any]] = suite(self.evaluation.suite).variants if given is None else given
        if not variants:
            raise ValueError("Argument `evaluation.variants` must have at least one entry, but has none")
        shared = load_config(self.environment.shared, **self.evaluation.options)
        return [load_config(shared, **each) for each in variants]

    def to_dict(self) -> dict[str, Any]:
        """Plain data from which `load` makes the same configuration."""
        return self.model_dump(mode="json")


def _refuse_code(data: dict[str, Any], source: str | Path) -> None:
    """Raise where a file's data name code; `learned:NAME` is none, unless it leads to what is pickled."""
    evaluation = data.get("evaluation")
    scripts = evaluation.get("scripts") if isinstance(evaluation, Mapping) else None
    if isinstance(evaluation, Mapping) and isinstance(scripts, list):
        refuse_agents([name for name in scripts if isinstance(name, str)], source)
        data = {**data, "evaluation": {**evaluation, "scripts": None}}
    refuse_code(data, source)


def load(source: str | Path | Mapping[str, Any], overrides: Sequence[str] = (), *, trust: bool = False) -> TrainConfig:
    """Build the configuration of a run.

    Args:
        source: a name among the published ones, a YAML or JSON file, or a mapping.
        overrides: `path.to.field=value` each, the value as YAML.
        trust: whether a file may name code that would run: estimators, detectors and agents of its own. Loading
            itself runs none.

    Raises:
        ConfigError: no such file or name, an unknown field, or a value that cannot be.
        UntrustedError: a file that names code, without `trust`.
    """
    if isinstance(source, Mapping):
        data = dict(source)
    elif str(source).endswith((".yaml", ".yml", ".json")):
        data = {"name": Path(source).stem, **read_file(source, trust=True)}
        if not trust:
            _refuse_code(data, source)
    else:
        known = tuple(sorted(path.stem for path in CONFIGS.glob("*.yaml")))
        if str(source) not in known:
            raise ConfigError(
                f"Unknown configuration `{word(source)}`{hint(word(source), known)}; known: "
                f"{', '.join(known)}, or a file"
            )
        data = {"name": str(source)} | read_file(CONFIGS / f"{source}.yaml")
    for text in overrides:
        override(data, text)
    return validate(TrainConfig, _number(data))
