"""Code of the user's own that is named by its place."""

from pathlib import Path

import pytest

from relloc_env.places import load


@pytest.mark.parametrize(
    ("text", "cause", "said"),
    [
        ("raise RuntimeError('no camera')", RuntimeError, "RuntimeError: no camera"),
        ("class Mine(:", SyntaxError, "SyntaxError: invalid syntax"),
        ("import nothing_of_this_name", ImportError, "No module named 'nothing_of_this_name'"),
        ("Other = 3", AttributeError, "has no attribute 'Mine'"),
    ],
)
def test_code_of_the_users_own_that_fails_is_named(
    text: str, cause: type[Exception], said: str, tmp_path: Path
) -> None:
    path = tmp_path / "mine.py"
    path.write_text(text + "\n", encoding="utf-8")
    with pytest.raises(ValueError, match=f"`detector` must lead to .*mine.py:Mine' does not: .*{said}") as caught:
        load(f"{path}:Mine", "detector")
    assert isinstance(caught.value.__cause__, cause)
