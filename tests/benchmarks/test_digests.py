"""The record of what must not change: the same twice, and every change is named with its size."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks import digests
from benchmarks.__main__ import app

FEW = ("two/contacts/cascade", "one/open-field/None")


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two configurations of ten actions, and nothing else."""
    known = digests.configurations()
    chosen = {name: (known[name][0], {**known[name][1], "max_cycles": 10}) for name in FEW}
    monkeypatch.setattr(digests, "configurations", lambda: chosen)
    for name in ("replays", "paper", "policies"):
        monkeypatch.setattr(digests, name, dict)


def test_there_are_forty_configurations_of_every_kind() -> None:
    found = digests.configurations()
    assert len(found) >= 40
    estimators = {str(options.get("estimator")) for _, options in found.values()}
    assert {"None", "cascade", "cascade-critical", "inverse-depth", "map-alignment"} <= estimators


def test_a_record_is_the_same_twice_and_what_differs_is_named(few: None, tmp_path: Path) -> None:
    one, two = tmp_path / "one.npz", tmp_path / "two.npz"
    assert digests.record(one) == digests.record(two)
    assert digests.digest(one) == digests.digest(two)
    assert digests.compare(one, two) == []
    with np.load(one) as file:
        arrays: dict[str, Any] = dict(file)
    reward = arrays["two/contacts/cascade/reward"]
    assert reward.shape == (10, digests.EPISODES)
    assert np.ptp(reward) > 0.0
    changed = reward.copy()
    changed[3, 4] += 2e-7
    arrays["two/contacts/cascade/reward"] = changed
    gone = arrays.pop("one/open-field/None/terminated")
    arrays["added"] = gone
    np.savez(two, **arrays)
    found = {name: (what, difference) for name, what, difference in digests.compare(one, two)}
    assert found.keys() == {"added", "one/open-field/None/terminated", "two/contacts/cascade/reward"}
    what, difference = found["two/contacts/cascade/reward"]
    assert what == "numbers"
    assert difference == pytest.approx(2e-7, rel=1e-6)
    assert digests.digest(one) != digests.digest(two)


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        ([1.0, np.nan], [1.0, np.nan], 0.0),
        ([1.0], [np.nan], np.inf),
        ([np.inf], [np.inf], 0.0),
        ([200.0], [201.0], 1 / 200),
    ],
)
def test_differences_are_relative_to_numbers_above_one(a: list[float], b: list[float], expected: float) -> None:
    assert digests.difference(np.array(a), np.array(b)) == pytest.approx(expected)


def test_the_command_fails_where_a_number_has_changed(few: None, tmp_path: Path) -> None:
    before, after = str(tmp_path / "before.npz"), str(tmp_path / "after.npz")
    assert CliRunner().invoke(app, ["digests", "--out", before]).exit_code == 0
    same = CliRunner().invoke(app, ["digests", "--out", after, "--against", before])
    assert same.exit_code == 0
    assert "The same to the bit" in same.output
    with np.load(before) as file:
        arrays: dict[str, Any] = dict(file)
    arrays["two/contacts/cascade/reward"] = arrays["two/contacts/cascade/reward"] + 1e-6
    np.savez(before, **arrays)
    other = CliRunner().invoke(app, ["digests", "--out", after, "--against", before])
    assert other.exit_code == 1
    assert "two/contacts/cascade/reward" in other.output
