"""Configuration: what is refused and how, files, and plain data and back without loss."""

import itertools
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import relloc_env
from relloc_env.config import CameraConfig, ConfigError, EnvConfig, load_config, override, read_file
from relloc_env.estimators.config import PRESETS
from relloc_env.scenarios import SCENARIOS

WRONG: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {
    "negative focal length": ({"camera": {"focal_length": -500.0}}, ("focal_length", "greater than 0", "-500")),
    "both focal length and view": (
        {"camera": {"focal_length": 500.0, "field_of_view": 60.0}},
        ("camera", "focal_length", "field_of_view", "not both"),
    ),
    "view too wide": ({"camera": {"field_of_view": 180.0}}, ("field_of_view", "between 0 and 180", "180.0")),
    "far before near": ({"camera": {"near": 2.0, "far": 1.0}}, ("camera", "far", "greater than", "2.0", "1.0")),
    "camera of a list": ({"camera": ["pi", {"far": -1.0}]}, ("`camera.1.far`", "greater than 0", "-1.0")),
    "first camera of a list": ({"camera": [{"far": -1.0}, "pi"]}, ("`camera.0.far`", "greater than 0", "-1.0")),
    "neither preset nor kind": (
        {"camera": "imag"}, ("`camera` must be a preset (pi, kinect", "kind (analytic, image)", "'imag'"),
    ),
    "lens of four": (
        {"camera": {"image": {"distortion": [0.1, 0, 0, 0]}}},
        ("`camera.image.distortion` must be five numbers k1, k2, p1, p2, k3", "[0.1, 0, 0, 0]"),
    ),
    "detector that is a number": (
        {"camera": {"image": {"detector": 5}}}, ("`camera.image.detector` must be one of colour, apriltag", "but is 5"),
    ),
    "unknown preset": ({"camera": "fisheye"}, ("camera", "preset", "'fisheye'", "kinect")),
    "frames faster than samples": ({"camera": {"frame_rate": 30.0}}, ("frame_rate", "20", "30")),
    "no image": ({"camera": {"width": 0, "focal_length": 5.0}}, ("camera", "width", "greater than 0", "0")),
    "chance above one": ({"camera": {"miss_probability": 1.5}}, ("miss_probability", "less than or equal to 1", "1.5")),
    "robot in a wall": ({"poses": [(4.9, 0, 0), (0, 0, 0)]}, ("robots", "walls", "robot 0", "4.9")),
    "robot in a disc": (
        {"poses": [(1, 0, 0), (0, 0, 0)], "obstacles": [{"shape": "disc", "position": (1.2, 0), "radius": 0.3}]},
        ("clear of obstacles", "robot 0"),
    ),
    "robot in a turned box": (
        {"poses": [(0, 0, 0), (1, 1, 0)],
         "obstacles": [{"shape": "box", "position": (1, 1.6), "size": (2, 0.2), "angle": math.pi / 2}]},
        ("clear of obstacles", "robot 1"),
    ),
    "robots in each other": ({"poses": [(0, 0, 0), (0.3, 0, 0)]}, ("apart", "robots 0 and 1", "0.3")),
    "poses of one robot for two": ({"poses": [(0, 0, 0)]}, ("2 entries", "poses", "has 1")),
    "three robots": ({"robots": 3}, ("robots", "less than or equal to 2", "3")),
    "no robots": ({"robots": 0}, ("robots", "greater than or equal to 1", "0")),
    "robots of three kinds": ({"robot": [{}, {}, {}]}, ("robot", "1 or 2 entries", "has 3")),
    "no targets": ({"targets": 0}, ("targets", "greater than or equal to 1", "0")),
    "no points": ({"points": []}, ("points", "at least one", "none")),
    "points and another count": ({"points": [(1, 2, 3)], "targets": 2}, ("2 entries", "points", "has 1")),
    "points that are a number": ({"points": 5}, ("points", "tuple", "5")),
    "point without height": ({"points": [(1.0, 2.0)]}, ("points.0", "2")),
    "point at infinity": ({"points": [(1.0, math.inf, 0.0)]}, ("points.0.1", "finite", "inf")),
    "pose that is no number": ({"poses": [(0, 0, math.nan), (1, 1, 0)]}, ("poses.0.2", "finite", "nan")),
    "negative radius": ({"robot": {"radius": -0.1}}, ("`robot.radius`", "greater than 0", "-0.1")),
    "negative noise": ({"robot": {"odometry_noise": (-1, 0)}}, ("odometry_noise", "greater than or equal to 0", "-1")),
    "speed of zero": ({"robot": {"max_speed": 0}}, ("max_speed", "greater than 0", "0")),
    "no floor": ({"arena": (0, 5)}, ("arena.0", "greater than 0", "0")),
    "obstacle of no shape": ({"obstacles": [{"position": (0, 0), "radius": 1}]}, ("obstacles", "shape")),
    "unknown shape": ({"obstacles": [{"shape": "ring", "position": (0, 0)}]}, ("obstacles", "ring", "disc", "box")),
    "disc of no size": ({"obstacles": [{"shape": "disc", "position": (0, 0)}]}, ("obstacles.0.radius", "missing")),
    "negative latency": ({"network": {"latency": -0.1}}, ("network.latency", "greater than or equal to 0", "-0.1")),
    "latency beyond the window": ({"network": {"latency": 4.0}}, ("latency", "64 samples")),
    "loss above one": ({"network": {"loss": 2}}, ("network.loss", "less than or equal to 1", "2")),
    "range below zero": ({"start": {"target_distance": (-3, 2)}}, ("start.target_distance.0", "or equal to 0", "-3")),
    "estimator without a kind": ({"estimator": {"h": 3.0}}, ("`estimator.kind`", "must be given", "is missing")),
    "unknown kind": (
        {"estimator": {"kind": "casc"}},
        ("`estimator.kind`", "'cascade', 'inverse-depth', 'map-alignment'", "'casc'"),
    ),
    "reversed range": ({"start": {"target_distance": (5, 2)}}, ("target_distance", "(least, greatest)", "(5, 2)")),
    "unknown reward": ({"reward": {"excitaton": 1.0}}, ("reward", "excitaton", "did you mean `excitation`")),
    "infinite weight": ({"reward": {"effort": math.inf}}, ("reward.effort", "finite", "inf")),
    "no cycles": ({"max_cycles": 0}, ("max_cycles", "greater than or equal to 1", "0")),
    "half a sample": ({"samples_per_action": 2.5}, ("samples_per_action", "integer", "2.5")),
    "no time": ({"sample_rate": 0}, ("sample_rate", "greater than 0", "0")),
    "unknown estimator": ({"estimator": "kalman"}, ("estimator", "kalman", "cascade")),
    "misspelt estimator": ({"estimator": "cascade-critcal"}, ("estimator", "cascade-critical")),
    "estimator that is a number": ({"estimator": 5}, ("estimator", "5")),
    "estimator without kind": ({"estimator": {"h": 3.0}}, ("estimator", "kind")),
    "negative gain": ({"estimator": {"kind": "cascade", "h": -1.0}}, ("estimator.h", "-1.0")),
    "success in no time": ({"success": (0.0, 1.0)}, ("success.0", "greater than 0", "0")),
    "unknown form": ({"observation": "tensor"}, ("observation", "'flat'", "'dict'", "'tensor'")),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_message_names_the_option_what_it_must_be_and_what_it_was(name: str) -> None:
    options, parts = WRONG[name]
    with pytest.raises(ConfigError) as caught:
        load_config(options)
    message = str(caught.value)
    for part in parts:
        assert part in message, message
    assert "pydantic" not in message
    assert "Input should" not in message
    with pytest.raises(ConfigError):
        load_config(**options)


@pytest.mark.parametrize(
    ("options", "wrong", "right"),
    [
        ({"robts": 1}, "robts", "robots"),
        ({"samples_per_acton": 1}, "samples_per_acton", "samples_per_action"),
        ({"robot": {"max_sped": 1.0}}, "`robot.max_sped`", "max_speed"),
        ({"camera": {"focal_lenght": 500.0}}, "`camera.focal_lenght`", "focal_length"),
        ({"camera": {"fieldofview": 60.0}}, "`camera.fieldofview`", "field_of_view"),
        ({"network": {"latncy": 0.1}}, "network.latncy", "latency"),
        ({"shield": {"targt": 0.1}}, "shield.targt", "target"),
        ({"start": {"heading_eror": 1.0}}, "start.heading_eror", "heading_error"),
        ({"guess": {"depht": 1.0}}, "guess.depht", "depth"),
        ({"obstacles": [{"shape": "disc", "position": (1, 1), "raduis": 1}]}, "obstacles.0.raduis", "radius"),
        ({"estimator": {"kind": "cascade", "alpha_lamda": 1}}, "alpha_lamda", "alpha_lambda"),
        ({"scenario": "paper-dept"}, "paper-dept", "paper-depth"),
    ],
)
def test_misspelt_option_gets_a_suggestion(options: dict[str, Any], wrong: str, right: str) -> None:
    with pytest.raises(ConfigError, match="Unknown") as caught:
        load_config(options)
    assert wrong in str(caught.value)
    assert right in str(caught.value)


def test_doors_raise_the_same() -> None:
    """Every door refuses a wrong option when it is made."""
    doors: list[Callable[..., Any]] = [
        relloc_env.parallel_env,
        relloc_env.env,
        lambda **options: gym.make("relloc_env/RelativePose-v0", **options),
    ]
    for door in doors[:2]:  # Gymnasium warns of it by itself
        with pytest.raises(ConfigError, match="'human' or 'rgb_array', but is 'ascii'"):
            door(render_mode="ascii")
    for door in doors:
        with pytest.raises(ConfigError, match="did you mean `max_cycles`"):
            door(max_cycle=5)
        with pytest.raises(ConfigError, match="greater than 0, but is -1"):
            door(camera={"focal_length": -1.0})
        with pytest.raises(ConfigError, match="estimator"):
            door(estimator=3.5)


def test_several_faults_are_named_at_once() -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(robots=7, targets=-1, network={"loss": 3})
    assert len(str(caught.value).splitlines()) == 3


def test_configuration_is_frozen() -> None:
    config = load_config()
    with pytest.raises(ValueError, match="frozen"):
        config.robots = 1  # type: ignore[misc]
    with pytest.raises(ValueError, match="frozen"):
        config.network.loss = 0.5  # type: ignore[misc]


VARIANTS: list[dict[str, Any]] = [
    {},
    {"robots": 1, "estimator": None, "arena": None, "shield": None},
    {"camera": ["kinect", {"focal_length": 700.0, "principal_point": (300, 200)}], "robot": [{"mass": 1}, {"mass": 2}]},
    {"estimator": "map-alignment", "network": {"latency": 0.1, "rate": 10}},
    {"estimator": {"kind": "cascade", "h": [2.0, 3.0], "damping": "critical"}},
    {"obstacles": [{"shape": "disc", "position": (1, 2), "radius": 0.2},
                   {"shape": "box", "position": (3, 3), "size": (1, 2)}]},
    {"poses": [(0, 0, 0), (1, 1, 1)], "points": [(3, 0, 1), (3, 1, 1), (2, 2, 1)]},
    {"reward": {"visibility": 1.0, "effort": -0.1}, "observation": "dict"},
]  # fmt: skip


@pytest.mark.parametrize("options", [{"scenario": name} for name in SCENARIOS] + VARIANTS, ids=str)
def test_plain_data_and_back_without_loss(options: dict[str, Any], tmp_path: Path) -> None:
    """Through `to_dict`, JSON text, a JSON file and a YAML file; and from a configuration itself."""
    config = load_config(options)
    plain = config.to_dict()
    assert load_config(plain) == config
    assert load_config(json.loads(json.dumps(plain))) == config
    (tmp_path / "config.json").write_text(json.dumps(plain), encoding="utf-8")
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(plain), encoding="utf-8")
    for name in ("config.json", "config.yaml"):
        assert load_config(tmp_path / name) == config
        assert load_config(str(tmp_path / name)) == config
    again = load_config(config)
    assert again == config
    if config.estimator is not None and again.estimator is not None:
        assert again.estimator.model_fields_set | {"kind"} == config.estimator.model_fields_set | {"kind"}
    assert load_config(plain).to_dict() == plain


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_plain_data_gives_the_same_estimates(name: str) -> None:
    """A camera with other noise than the estimators' default: the noise they are told survives the way through data."""
    options: dict[str, Any] = {"estimator": name, "camera": {"preset": "pi", "pixel_noise": 8.0}, "max_cycles": 20}
    first = relloc_env.parallel_env(**options)
    second = relloc_env.parallel_env(first.config.to_dict())
    third = relloc_env.parallel_env(first.config)
    seen = [env.reset(seed=4)[0] for env in (first, second, third)]
    for _ in range(10):
        for agent in first.agents:
            np.testing.assert_array_equal(seen[0][agent], seen[1][agent])
            np.testing.assert_array_equal(seen[0][agent], seen[2][agent])
        actions = {agent: np.array([0.5, 0.3], np.float32) for agent in first.agents}
        seen = [env.step(actions)[0] for env in (first, second, third)]


def test_options_go_over_what_is_there() -> None:
    """Entry by entry, on a scenario, a mapping, a configuration, and on lists of robots and cameras."""
    over = load_config("paper-simulation", guess={"heading": 30.0}, max_cycles=10)
    assert over.guess.heading == 30.0
    assert over.guess.kind == "positive"
    assert over.max_cycles == 10
    assert over.camera_of(0).preset == "unlimited"
    assert load_config({"scenario": "paper-depth", "robots": 1}).robots == 1
    base = load_config(robot=[{"mass": 1.0}, {"mass": 2.0}], camera={"preset": "kinect", "far": 5.0})
    changed = load_config(base, robot={"max_speed": 1.0}, camera={"miss_probability": 0.2})
    assert [(robot.mass, robot.max_speed) for robot in changed.robot] == [(1.0, 1.0), (2.0, 1.0)]
    assert (changed.camera_of(0).far, changed.camera_of(0).miss_probability) == (5.0, 0.2)
    assert load_config(base, camera={"preset": "pi"}).camera_of(0) == CameraConfig.model_validate("pi")
    wide = load_config(base, camera={"field_of_view": 100.0}).camera_of(0)
    assert math.isclose(math.degrees(2 * wide.half_view), 100.0)
    assert wide.far == 5.0
    assert load_config(base, points=[(1, 1, 1)] * 3).targets == 3
    assert load_config(load_config(points=[(1, 1, 1)]), points=[(1, 1, 1)] * 3).targets == 3
    estimator = load_config(load_config(estimator="map-alignment"), estimator={"kind": "cascade", "h": 3.0}).estimator
    assert estimator is not None
    assert estimator.kind == "cascade"
    gains = load_config({"estimator": {"kind": "cascade", "h": 3.0}}, estimator={"alpha_lambda": 60.0}).estimator
    assert gains is not None
    assert gains.model_dump(include={"h", "alpha_lambda"}) == {"h": 3.0, "alpha_lambda": 60.0}


SETS: dict[str, tuple[list[str], dict[str, Any]]] = {
    "kind": (["camera=image", "camera.image.exposure=0.5"], {"camera": {"kind": "image", "image": {"exposure": 0.5}}}),
    "preset": (["camera=kinect", "camera.far=5.0"], {"camera": {"preset": "kinect", "far": 5.0}}),
    "kind and preset": (
        ["camera=image", "camera=kinect", "camera.image.noise=1.0"],
        {"camera": {"kind": "image", "preset": "kinect", "image": {"noise": 1.0}}},
    ),
    "estimator": (["estimator=cascade", "estimator.h=3.0"], {"estimator": {"kind": "cascade", "h": 3.0}}),
    "preset of an estimator": (
        ["estimator=cascade-critical", "estimator.h_floor=2.0"],
        {"estimator": {"kind": "cascade", "damping": "critical", "measurement": "depth", "process": "odometry",
                       "h_floor": 2.0}},
    ),
    "deeper": (["network.loss=0.1", "network.rate=5.0"], {"network": {"loss": 0.1, "rate": 5.0}}),
}  # fmt: skip


@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("place", ["", "environment.options."])
def test_overrides_go_into_what_a_name_stands_for_in_any_order(name: str, place: str) -> None:
    texts, expected = SETS[name]
    for order in itertools.permutations(texts):
        data: dict[str, Any] = {}
        for text in order:
            override(data, place + text)
        assert load_config(data["environment"]["options"] if place else data) == load_config(expected), order


def test_overrides_of_what_is_chosen_anew() -> None:
    """Another estimator or preset voids what was said of the one before, a kind of camera does not."""
    data: dict[str, Any] = {"estimator": {"kind": "cascade", "h": 3.0}, "camera": {"preset": "kinect", "far": 5.0}}
    given = json.dumps(data)
    for text in ("estimator=map-alignment", "camera=image"):
        override(data, text)
    assert load_config(data) == load_config(
        estimator="map-alignment", camera={"preset": "kinect", "far": 5.0, "kind": "image"}
    )
    override(data, "camera=pi")
    assert load_config(data).camera_of(0) == CameraConfig.model_validate("pi")
    inside: dict[str, Any] = {"options": json.loads(given)}
    override(copy := dict(inside), "options.camera.far=6.0")
    assert (json.dumps(inside["options"]), copy["options"]["camera"]["far"]) == (given, 6.0)


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["max_cycles=5", "max_cycles.more=1"], r"`max_cycles` must be a mapping for `max_cycles.more` .* but is 5"),
        (["shield=null", "shield.target=1"], "`shield` must be a mapping for `shield.target` to be set, but is None"),
        (["camera=[pi, pi]", "camera.far=5"], r"`camera` must be a mapping for .*, but is \['pi', 'pi'\]"),
        (["robot.lag.0=1", "robot.lag.0.x=1"], r"`robot.lag.0` must be a mapping"),
        (["estimator=casc", "estimator.h=3"], "`estimator` must be the name of an estimator, but is 'casc'"),
        (["estimator.h=3", "estimator=casc"], "`estimator` must be the name of an estimator, but is 'casc'"),
    ],
)
def test_overrides_within_what_is_no_mapping_are_refused(texts: list[str], message: str) -> None:
    data: dict[str, Any] = {}
    override(data, texts[0])
    with pytest.raises(ConfigError, match=message):
        override(data, texts[1])


def test_options_go_into_what_a_name_stands_for() -> None:
    assert load_config({"camera": "kinect"}, camera={"near": 0.5}) == load_config(
        camera={"preset": "kinect", "near": 0.5}
    )
    assert load_config({"camera": "kinect"}, camera="image") == load_config(
        camera={"preset": "kinect", "kind": "image"}
    )
    assert load_config({"estimator": "cascade"}, estimator={"h": 3.0}) == load_config(
        estimator={"kind": "cascade", "h": 3.0}
    )
    told = load_config({"estimator": "map-alignment-mocap"}, estimator={"kind": "map-alignment", "iterations": 5})
    assert told == load_config(estimator={"kind": "map-alignment", "iterations": 5})


def test_scenarios_are_left_as_they_are() -> None:
    """Building on a scenario changes nothing for the next one."""
    before = json.dumps(SCENARIOS, sort_keys=True)
    for name in SCENARIOS:
        load_config(name, robot={"max_speed": 9.0}, camera={"far": 3.0}, start={"margin": 1.0})
    assert json.dumps(SCENARIOS, sort_keys=True) == before


FILES = {
    "missing.yaml": (None, ("missing.yaml", "readable", "No such file")),
    "folder.yaml": ("folder", ("folder.yaml", "readable", "directory")),
    "config.toml": (b"robots = 1", ("config.toml", ".yaml", ".json")),
    "broken.json": (b'{"robots": 1,, }', ("broken.json", "YAML or JSON", "line 1")),
    "broken.yaml": (b"robots: [1\ntargets: 2\n", ("broken.yaml", "YAML or JSON", "line 2")),
    "binary.yaml": (b"\xff\xfe\x00robots", ("binary.yaml", "YAML or JSON")),
    "nul.yaml": (b"robots: \x00", ("nul.yaml", "YAML or JSON")),
    "date.yaml": (b"robots: 2001-99-99", ("date.yaml", "YAML or JSON")),
    "object.yaml": (b"robots: !!python/object:os.system 1", ("object.yaml", "YAML or JSON")),
    "deep.json": (b"[" * 800, ("deep.json", "YAML or JSON")),
    "list.yaml": (b"- robots\n- 1\n", ("list.yaml", "mapping", "list")),
    "empty.yaml": (b"", ("empty.yaml", "mapping", "NoneType")),
    "wrong.yaml": (b"robots: 5\n", ("robots", "less than or equal to 2", "5")),
    "typo.json": (b'{"netwrk": {}}', ("netwrk", "did you mean `network`")),
    "number.json": (b'{"scenario": 5}', ("scenario", "5", "paper-depth")),
    "keys.yaml": (b"1: 2\n", ("1",)),
}


@pytest.mark.parametrize("name", FILES)
def test_files_that_cannot_be_read(name: str, tmp_path: Path) -> None:
    content, parts = FILES[name]
    path = tmp_path / name
    if content == "folder":
        path.mkdir()
    elif isinstance(content, bytes):
        path.write_bytes(content)
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    for part in parts:
        assert part in str(caught.value), str(caught.value)


def test_what_is_no_configuration() -> None:
    for value in (5, ["robots"], 3.5, b"robots"):
        with pytest.raises(ConfigError, match=f"config.*{type(value).__name__}"):
            load_config(value)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="Unknown scenario `nowhere`"):
        load_config("nowhere")


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=5,
)
NAMES = st.sampled_from([*EnvConfig.model_fields, "scenario"])


def assert_refused_or_whole(data: dict[str, Any]) -> None:
    """Anything but a `ConfigError` would come through."""
    try:
        config = load_config(data)
    except ConfigError:
        return
    assert load_config(config.to_dict()) == config


@settings(max_examples=300, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(st.dictionaries(NAMES | st.text(max_size=6), JUNK, max_size=3))
def test_junk_is_refused_or_makes_a_whole_configuration(data: dict[str, Any]) -> None:
    """300 mappings of real names and any values: a `ConfigError`, or a configuration that survives plain data."""
    assert_refused_or_whole(data)


@settings(max_examples=150, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(["robot", "camera", "network", "shield", "start", "guess", "estimator"]), st.data())
def test_junk_within_is_refused_or_makes_a_whole_configuration(name: str, data: st.DataObject) -> None:
    """150 wrong values for the options of one part."""
    part = {
        "robot": ["radius", "mass", "lag", "reverse", "max_speed"],
        "camera": [
            "preset",
            "width",
            "height",
            "focal_length",
            "field_of_view",
            "principal_point",
            "far",
            "frame_rate",
        ],
        "network": ["latency", "jitter", "loss", "rate"],
        "shield": ["target", "robot", "wall"],
        "start": ["target_distance", "target_height", "heading_error", "in_view"],
        "guess": ["kind", "depth", "depth_sd"],
        "estimator": ["kind", "h", "image_noise"],
    }[name]
    options = data.draw(st.dictionaries(st.sampled_from(part), JUNK, max_size=3))
    assert_refused_or_whole({name: options})


SIZES = st.floats(0.01, 50.0)


@settings(max_examples=200, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.integers(1, 5000), st.integers(1, 5000), st.floats(1.0, 179.0), SIZES, st.floats(0.0, 20.0), st.floats(0.0, 20.0)
)
def test_any_possible_camera_is_taken(
    width: int, height: int, view: float, far: float, noise: float, step: float
) -> None:
    """200 cameras: the field of view comes back, the axis is in the middle, plain data gives the same again."""
    spec = {"width": width, "height": height, "field_of_view": view, "near": 0.0, "far": far, "pixel_noise": noise}
    config = load_config(camera={**spec, "quantisation": step})
    camera = config.camera_of(1)
    assert math.isclose(math.degrees(2.0 * camera.half_view), view)
    assert camera.principal_point == (0.5 * width, 0.5 * height)
    assert math.isclose((camera.image_noise * camera.focal_length) ** 2, noise**2 + step**2 / 12.0, abs_tol=1e-12)
    assert load_config(config.to_dict()) == config


@settings(max_examples=300, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(st.tuples(st.floats(-6, 6), st.floats(-6, 6)), st.tuples(st.floats(-6, 6), st.floats(-6, 6)), st.floats(-4, 4))
def test_poses_are_refused_where_bodies_would_overlap(
    a: tuple[float, float], b: tuple[float, float], angle: float
) -> None:
    """300 pairs of poses in a 10 m arena with a turned box: refused exactly where geometry says so."""
    box = {"shape": "box", "position": (1.0, -1.0), "size": (3.0, 1.0), "angle": angle}
    free = math.hypot(a[0] - b[0], a[1] - b[1]) >= 0.36
    for x, y in (a, b):
        z = complex(x - 1.0, y + 1.0) * complex(math.cos(angle), -math.sin(angle))
        nearest = complex(min(max(z.real, -1.5), 1.5), min(max(z.imag, -0.5), 0.5))
        free = free and abs(z - nearest) >= 0.18 and abs(x) <= 4.82 and abs(y) <= 4.82
    poses = [(*a, 0.0), (*b, 0.0)]
    if free:
        assert load_config(poses=poses, obstacles=[box]).poses is not None
    else:
        with pytest.raises(ConfigError, match="must have robots"):
            load_config(poses=poses, obstacles=[box])


def test_reading_a_file_gives_its_mapping(tmp_path: Path) -> None:
    (tmp_path / "task.yml").write_text("scenario: paper-simulation\nrobot:\n  max_speed: 1e-1\n", encoding="utf-8")
    assert read_file(tmp_path / "task.yml")["scenario"] == "paper-simulation"
    config = load_config(tmp_path / "task.yml", targets=2)
    assert config.robot_of(0).max_speed == 0.1
    assert config.robot_of(0).max_yaw_rate == 0.5


def test_a_margin_that_leaves_no_room_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"`start.margin` below half the arena .* but it is 20"):
        load_config(start={"margin": 20.0})


def test_colours_of_up_to_eight_targets_stay_and_more_are_all_different() -> None:
    first = [load_config().look.colour_of(m) for m in range(8)]
    assert first[:3] == [(214, 40, 40), (30, 90, 214), (40, 170, 60)]
    for count in range(1, 33):
        config = load_config(targets=count, camera="image")
        colours = [config.look.colour_of(m) for m in range(count)]
        if count <= 8:
            assert colours == first[:count]
        assert len(set(colours)) == min(count, 24)
        stated = load_config(config, marker={"colours": [(200, 10, 10)]})
        assert {stated.look.colour_of(m) for m in range(count)} == {(200, 10, 10)}
        assert load_config(config.to_dict(), targets=32) == load_config(targets=32, camera="image")


class Found:
    """Stands for a detector of one's own."""

    class Inner:
        """Inside another."""

    def __init__(self, view: Any) -> None: ...


def test_a_detector_of_ones_own_as_plain_data() -> None:
    for own, place in ((Found, f"{__name__}:Found"), (Found.Inner, f"{__name__}:Found.Inner"), ("a.py:B", "a.py:B")):
        config = load_config({"camera": {"kind": "image", "image": {"detector": own}}})
        plain = config.to_dict()
        assert plain["camera"][0]["image"]["detector"] == place
        assert load_config(json.loads(json.dumps(plain))).to_dict() == plain
        assert load_config(config, targets=3).detector_of(1) is own
    nameless = lambda _: None  # noqa: E731
    config = load_config(camera=["pi", {"kind": "image", "image": {"detector": nameless}}])
    assert load_config(config, targets=3).detector_of(1) is nameless
    with pytest.raises(
        ConfigError, match=r"^Argument `camera.image.detector` must be a class or function that its mod"
    ):
        config.to_dict()
    config = load_config(estimator=lambda *_, **__: None)
    with pytest.raises(ConfigError, match=r"^Argument `estimator.factory` must be a class or function that its module"):
        config.to_dict()
