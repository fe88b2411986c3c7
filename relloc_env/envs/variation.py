"""Which configurations a policy is trained on: stages of a curriculum, and options drawn at random. Plain data."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from relloc_env.config import ConfigError, EnvConfig, load_config, validate
from relloc_env.config.base import Model
from relloc_env.envs.onboard import informed
from relloc_env.quoting import quote
from relloc_env.scenarios import suite

Number = int | float
Numbers = Number | tuple[Number, ...]


class Choice(Model):
    """One of several values, each as likely."""

    choices: Annotated[tuple[Any, ...], Field(min_length=1)]


class Span(Model):
    """A number between two, uniformly; whole where the option and both ends are.

    Ends of several numbers, as `odometry_noise` has them, are gone between together.
    """

    least: Numbers
    greatest: Numbers

    @model_validator(mode="after")
    def _alike(self) -> Self:
        least, greatest = np.atleast_1d(self.least), np.atleast_1d(self.greatest)
        if least.shape != greatest.shape or not (np.isfinite(least) & np.isfinite(greatest)).all():
            raise ValueError(
                f"must go from finite numbers to as many, but goes from {quote(self.least)} to {quote(self.greatest)}"
            )
        return self


class Stage(Model):
    """A part of a curriculum: on which configurations, and until when."""

    until: Annotated[int, Field(ge=1)] | None = None
    """timesteps, as Stable-Baselines3 counts them (rows times steps), after which the next stage begins; None for the
    last one."""
    suite: str | None = None
    """name of a suite of `relloc_env.scenarios`; its variants are dealt out among the groups in turn."""
    options: dict[str, Any] = Field(default_factory=dict)
    """over the suite's."""
    vary: dict[str, Span | Choice] = Field(default_factory=dict)
    """what is drawn for each option, by its place: `{"camera.pixel_noise": [0.8, 3.2]}`. A pair is a `Span`."""

    @field_validator("vary", mode="before")
    @classmethod
    def _pairs(cls, value: Any) -> Any:
        if not isinstance(value, Mapping):
            return value
        pairs = {
            name: {"least": each[0], "greatest": each[1]}
            for name, each in value.items()
            if isinstance(each, list | tuple) and len(each) == 2
        }
        return {**value, **pairs}


class Curriculum(Model):
    """Stages, one after the other."""

    stages: Annotated[tuple[Stage, ...], Field(min_length=1)] = (Stage(),)

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        ends = [stage.until for stage in self.stages]
        known = [end for end in ends[:-1] if end is not None]
        if len(known) < len(ends) - 1 or ends[-1] is not None or known != sorted(set(known)):
            raise ValueError(f"must have `until` in all stages but the last, in order, but has {ends}")
        return self

    def at(self, timesteps: int) -> int:
        """Index of the stage that is on after so many timesteps."""
        return sum(stage.until is not None and timesteps >= stage.until for stage in self.stages)


class Variation:
    """Configurations of a curriculum, drawn for groups of environments.

    An estimator believes of the sensors what the configuration says without what is drawn.

    Args:
        config: what all have in common.
        stages: as for `Curriculum`.

    Raises:
        ConfigError: a stage that cannot be, at either end of what is drawn.
    """

    def __init__(self, config: EnvConfig, stages: Sequence[Stage | Mapping[str, Any]]) -> None:
        self.curriculum = validate(Curriculum, {"stages": tuple(stages)})
        self._nominal = [self._variants(config, stage) for stage in self.curriculum.stages]
        everything = [
            each
            for stage, variants in zip(self.curriculum.stages, self._nominal, strict=True)
            for nominal in variants
            for each in (nominal, *_ends(nominal, stage.vary))
        ]
        for name in ("robots", "observation", "action", "samples_per_action"):
            found = {getattr(each, name) for each in everything}
            if len(found) > 1:
                raise ConfigError(f"Argument `stages` must have one `{name}` in all stages, but has {sorted(found)}")
        targets = max(each.targets for each in everything)
        self.layout = everything[0].model_copy(update={"targets": targets, "points": None})
        """A configuration with as many targets as any: observations and actions are laid out for it."""

    @staticmethod
    def _variants(config: EnvConfig, stage: Stage) -> list[EnvConfig]:
        """The configurations of a stage before anything is drawn; what the estimator believes is stated."""
        found = []
        for variant in suite(stage.suite).variants if stage.suite else ({},):
            nominal = load_config(load_config(config, **variant), **stage.options)
            if nominal.estimator is not None:
                nominal = load_config(nominal, estimator=informed(nominal))
            found.append(nominal)
        return found

    def draw(self, stage: int, group: int, rng: np.random.Generator) -> EnvConfig:
        """Draw the configuration of a group of environments in a stage."""
        variants = self._nominal[stage]
        nominal = variants[group % len(variants)]
        vary = self.curriculum.stages[stage].vary
        return _over(nominal, {name: _draw(nominal, name, each, rng) for name, each in vary.items()})


def _over(nominal: EnvConfig, values: Mapping[str, Any]) -> EnvConfig:
    """Put values over a configuration, by their places."""
    for name, value in values.items():
        *above, last = name.split(".")
        options = {last: value}
        for key in reversed(above):
            options = {key: options}
        nominal = load_config(nominal, **options)
    return nominal


def _ends(nominal: EnvConfig, vary: Mapping[str, Span | Choice]) -> list[EnvConfig]:
    """Configurations with each option at an end of what is drawn for it, or at one of its choices."""
    found = []
    for name, each in vary.items():
        values = each.choices if isinstance(each, Choice) else (each.least, each.greatest)
        found += [_over(nominal, {name: value}) for value in values]
    return found


def _draw(nominal: EnvConfig, name: str, each: Span | Choice, rng: np.random.Generator) -> Any:
    """Draw one option."""
    if isinstance(each, Choice):
        return each.choices[int(rng.integers(len(each.choices)))]
    if _is_whole(nominal, name) and isinstance(each.least, int) and isinstance(each.greatest, int):
        return int(rng.integers(each.least, each.greatest, endpoint=True))
    share = rng.random()
    drawn: Any = np.asarray(each.least) + share * (np.asarray(each.greatest) - np.asarray(each.least))
    return drawn.tolist()


def _is_whole(nominal: EnvConfig, name: str) -> bool:
    """Whether an option is a whole number."""
    found: Any = nominal.to_dict()
    for key in name.split("."):
        found = found[0] if isinstance(found, list) else found
        found = found.get(key) if isinstance(found, dict) else None
    return isinstance(found, int) and not isinstance(found, bool)
