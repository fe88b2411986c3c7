"""Small files that stand for huge configurations, and messages about what is huge: quick, and short."""

import time
from pathlib import Path
from typing import Any

import pytest

from relloc_env.config import ConfigError, EnvConfig, load_config, override
from relloc_env.quoting import LONGEST, quote

BOMB = "\n".join(
    ["a0: &a0 [x,x,x,x,x,x,x,x,x]", *(f"a{k}: &a{k} [{','.join(9 * [f'*a{k - 1}'])}]" for k in range(1, 9))]
)
TEXTS = {
    "aliases": BOMB,
    "aliases in an option": BOMB + "\nmax_cycles: *a8",
    "aliases as keys": BOMB + "\n<<: {b: *a7}",
    "an alias within itself": "robots: &a [*a]",
    "deep": "robots: " + "[" * 100_000,
    "deep and closed": "robots: " + "[" * 60 + "]" * 60,
    "deep JSON": '{"robots": ' * 5_000 + "1" + "}" * 5_000,
    "long": "robots: " + "x" * 2_000_000,
    "many": "robots: [" + "1," * 30_000 + "]",
    "a long number": "robots: " + "1" * 10_000,
    "a long number in hexadecimal": "robots: 0x" + "f" * 10_000,
    "a long word": "robots: " + "x" * 100_000,
    "a long name": "x" * 1_000 + ": 1",
    "many names": "\n".join(f"maxcycles{k}: 1" for k in range(1_000)),
    "no YAML": "robots: [" + "{" * 1_000,
}


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
@pytest.mark.parametrize("suffix", [".yaml", ".json"])
def test_a_file_is_refused_in_few_words_and_at_once(text: str, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"odd{suffix}"
    path.write_text(text, encoding="utf-8")
    load_config()
    start = time.process_time()
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert time.process_time() - start < (3.0 if len(text) > 9_000 else 1.0)  # long texts take their time to read
    assert len(str(caught.value)) < 2_000


@pytest.mark.parametrize("name", [name for name, text in TEXTS.items() if "\n" not in text])
def test_a_value_is_refused_in_few_words(name: str) -> None:
    text = TEXTS[name]

    def given() -> None:
        data: dict[str, Any] = {}
        override(data, f"robots={text.removeprefix('robots: ')}")
        load_config(data)

    with pytest.raises(ConfigError) as caught:
        given()
    assert len(str(caught.value)) < 2_000


def test_aliases_within_limits_are_read(tmp_path: Path) -> None:
    path = tmp_path / "two.yaml"
    path.write_text("robot: [&a {lag: [0.1, 0.1]}, *a]\n", encoding="utf-8")
    assert load_config(path) == load_config(robot=2 * [{"lag": (0.1, 0.1)}])


DEEP: list[Any] = []
for _ in range(500):
    DEEP = [DEEP]
HUGE: dict[str, Any] = {
    "text": "x" * 1_000_000,
    "list": [0] * 100_000,
    "mapping": dict.fromkeys(map(str, range(100_000)), 0),
    "key": {"k" * 100_000: 0},
    "deep": DEEP,
    "number": 10**5_000,
}


@pytest.mark.parametrize("kind", HUGE)
@pytest.mark.parametrize("option", [*EnvConfig.model_fields, "scenario", "nothing"])
def test_every_option_says_in_few_words_what_is_wrong(option: str, kind: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(**{option: HUGE[kind]})
    assert len(str(caught.value)) < 2_000


class Odd:
    def __repr__(self) -> str:
        raise RuntimeError


@pytest.mark.parametrize("value", [*HUGE.values(), Odd()], ids=[*HUGE, "odd"])
def test_what_is_quoted_is_cut(value: object) -> None:
    assert 0 < len(quote(value)) <= LONGEST


@pytest.mark.parametrize("value", [1, 2.5, "x", None, [1, 2], (1.0,), {"a": [1, {"b": 2}]}, ["x"] * 12])
def test_what_is_short_is_quoted_as_it_is(value: object) -> None:
    assert quote(value) == repr(value)
