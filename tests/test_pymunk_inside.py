"""Contacts come out the same, to the last bit, where pymunk's inside is not what the compiled loop goes by."""

import importlib.util
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pymunk._chipmunk_cffi import ffi, lib

import relloc_env.world
from relloc_env.config import load_config
from tests.worlds import CLUTTER, random_driving, world


class _Changed:
    """What it is given, with some names replaced."""

    def __init__(self, given: Any, **changed: Any) -> None:
        self.__dict__.update(changed)
        self._given = given

    def __getattr__(self, name: str) -> Any:
        return getattr(self._given, name)


FIELDS = ffi.typeof("pmBatchedData").fields
INSIDES = {
    "none": SimpleNamespace(),
    "another order": SimpleNamespace(ffi=_Changed(ffi, typeof=lambda _: SimpleNamespace(fields=FIELDS[::-1])), lib=lib),
    "other numbers": SimpleNamespace(ffi=ffi, lib=_Changed(lib, ANGLE=lib.VELOCITY)),
    "a function less": SimpleNamespace(ffi=ffi, lib=_Changed(lib, pmSpaceBodyGetIteratorFuncBatched=None)),
}


def loaded_with(inside: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The module of the contact solver, loaded once more where pymunk has another inside."""
    monkeypatch.setitem(sys.modules, "pymunk._chipmunk_cffi", inside)
    spec = importlib.util.spec_from_file_location("world_again", relloc_env.world.__file__)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_inside_is_known_here() -> None:
    assert relloc_env.world.COMPILED


@pytest.mark.parametrize("inside", INSIDES)
def test_contacts_are_the_same_on_the_plain_calls(inside: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """300 samples of eight environments, in a narrow room."""
    plain = loaded_with(INSIDES[inside], monkeypatch)
    assert not plain.COMPILED
    one, two = world(8, **CLUTTER), world(8, **CLUTTER)
    two._solvers[0] = plain.ContactSolver(two.config)
    rng, rows, collided = np.random.default_rng(5), np.arange(8), 0
    for _ in range(300):
        action = random_driving(rng, 8)
        one.step(action, rows)
        two.step(action, rows)
        np.testing.assert_array_equal(one.world.pose, two.world.pose)
        np.testing.assert_array_equal(one.world.collided, two.world.collided)
        collided += int(one.world.collided.sum())
    assert collided > 100


def test_a_plain_solver_can_be_copied(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = loaded_with(INSIDES["none"], monkeypatch)
    solver = plain.ContactSolver(load_config({"estimator": None}))
    make, arguments = solver.__reduce__()
    assert isinstance(make(*arguments), plain.ContactSolver)
