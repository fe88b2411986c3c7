"""Tables of the site as Markdown, each read off the code that it describes."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import yaml
from pydantic import BaseModel

import relloc_env
from docs._extensions.options import default, describe, meaning, models
from relloc_env.config import CAMERAS, EnvConfig, load_config
from relloc_env.envs.observation import fields
from relloc_env.envs.spaces import joint_slices, joint_space
from relloc_env.estimators import PRESETS
from relloc_env.rewards import TERMS
from relloc_env.scenarios import SCENARIOS

ROOT = Path(__file__).resolve().parents[2]
ROBOTS = {"relloc_env/ActiveDepth-v0": 1, "relloc_env/RelativePose-v0": 2}


def table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines)


def _config(name: str, *, bare: bool = False) -> EnvConfig:
    return load_config({"robots": ROBOTS[name], **({"estimator": None} if bare else {})})


def summary(name: str) -> str:
    """What stands at the top of an id's page."""
    config = _config(name)
    size = 2 * config.robots
    return table(
        ["", ""],
        [
            ["action space", f"`Box(-1.0, 1.0, ({size},), float32)`"],
            ["observation space", f"`Box({joint_space(config).shape}, float32)`"],
            ["make", f'`gymnasium.make("{name}")`'],
            ["make many", f'`gymnasium.make_vec("{name}", num_envs=1024)`'],
        ],
    )


def actions(name: str) -> str:
    """Entries of the action, one a line."""
    config, rows = _config(name), []
    for r in range(config.robots):
        robot, who = config.robot_of(r), f"of robot {'AB'[r]}" if config.robots > 1 else ""
        rows.append([2 * r, f"forward speed {who}", "−1", "1", f"{robot.max_speed:g} m/s"])
        rows.append([2 * r + 1, f"yaw rate {who}, to the left", "−1", "1", f"{robot.max_yaw_rate:g} rad/s"])
    return table(["index", "entry", "min", "max", "1 stands for"], rows)


def observation(name: str, kind: str = "") -> str:
    """Fields of the observation with their places; `bare` for the environment without an estimator."""
    config = _config(name, bare=kind == "bare")
    where, rows = joint_slices(config), []
    for field in fields(config):
        keys = [field.name] if config.robots == 1 else [f"robot_{end}/{field.name}" for end in "ab"]
        places = [_entries(where[key]) for key in keys]
        shape = "\u00a0×\u00a0".join(map(str, field.shape))
        rows.append(
            [f"`{field.name}`", *places, shape, f"{field.low:g}".replace("-", "−"), f"{field.high:g}", field.meaning]
        )
    heads = ["entries"] if config.robots == 1 else ["entries of A", "of B"]
    return table(["field", *heads, "shape", "min", "max", "holds"], rows)


def _entries(place: slice) -> str:
    first, last = place.start, place.stop - 1
    joiner = "\u2060"  # no break at the dash
    return f"{first}" if first == last else f"{first}{joiner}–{joiner}{last}"


def rewards(name: str) -> str:
    """Terms with their default weights."""
    weights = _config(name).reward_weights
    rows = ([f"`{term}`", f"{weights[term]:g}" if term in weights else "", text] for term, text in TERMS.items())
    return table(["term", "weight", "holds"], rows)


def arguments() -> str:
    """Options of an environment; how many robots there are, the id says."""
    return _options(EnvConfig, leave_out=("robots",))


def configuration() -> str:
    """Every part of an environment's configuration, one section each."""
    text = []
    for model in models(EnvConfig)[1:]:
        doc = (model.__doc__ or "").split("\n\n")[0].replace("\n", " ")
        text += [f"## {model.__name__}", doc, _options(model)]
    return "\n\n".join(text)


def _options(model: type[BaseModel], leave_out: Sequence[str] = ()) -> str:
    rows = (
        [f"`{name}`", describe(field.annotation, field.metadata), default(field), meaning(model, name)]
        for name, field in model.model_fields.items()
        if name not in leave_out
    )
    return table(["option", "type", "default", "meaning"], rows)


def scenarios() -> str:
    """Named scenarios and what each changes."""
    rows = ([f"`{name}`", ", ".join(f"`{key}`" for key in changed) or "nothing"] for name, changed in SCENARIOS.items())
    return table(["scenario", "changes"], rows)


def cameras() -> str:
    """Presets of cameras."""
    rows = ([f"`{name}`", ", ".join(f"{k} {v}" for k, v in preset.items())] for name, preset in CAMERAS.items())
    return table(["preset", "values"], rows)


def estimators() -> str:
    """Presets of estimators: the configuration that each stands for."""
    rows = []
    for name, preset in PRESETS.items():
        stated = preset.model_dump(exclude_unset=True, exclude={"kind"})
        rows.append([f"`{name}`", f"`{type(preset).__name__}`", ", ".join(f"{k} = {v}" for k, v in stated.items())])
    return table(["name", "configuration", "stated in it"], rows)


def citation() -> str:
    """CITATION.cff as BibTeX."""
    data = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    software = {"title": data["title"], "author": _authors(data), "version": relloc_env.__version__}
    entries = [_bibtex("software", "relloc_env", software)]
    for work in data["references"]:
        fields_ = {"title": work["title"], "author": _authors(work), "booktitle": work["collection-title"]}
        key = f"{work['authors'][0]['family-names'].split()[-1].lower()}{work['year']}"
        entries.append(_bibtex("inproceedings", key, fields_ | {"year": str(work["year"])}))
    return "```bibtex\n" + "\n\n".join(entries) + "\n```"


def _authors(work: Mapping[str, list[dict[str, str]]]) -> str:
    return " and ".join(
        f"{a['family-names']}, {a['given-names']}" if "family-names" in a else "{" + a["name"] + "}"
        for a in work["authors"]
    )


def _bibtex(kind: str, key: str, values: Mapping[str, str]) -> str:
    inside = ",\n".join(f"  {name} = {{{value}}}" for name, value in values.items())
    return f"@{kind}{{{key},\n{inside}\n}}"


TABLES: Mapping[str, Callable[..., str]] = {
    function.__name__: function
    for function in (
        summary, actions, observation, rewards, arguments, configuration, scenarios, cameras, estimators, citation,
    )
}  # fmt: skip
