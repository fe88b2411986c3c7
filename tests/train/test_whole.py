"""Files that are put in their places whole."""

from pathlib import Path

import pytest

from train.whole import whole, write_json


def test_what_is_stopped_on_the_way_leaves_the_file_before_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "card.json"
    write_json(path, {"a": 1})

    def stopped() -> None:
        with whole(path) as partial:
            partial.write_text("{", encoding="utf-8")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert path.read_text("utf-8") == '{\n "a": 1\n}\n'
    write_json(path, [])
    assert path.read_text("utf-8") == "[]\n"
    assert list(tmp_path.iterdir()) == [path]
