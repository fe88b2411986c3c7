"""Handles: what a kernel is given at every call, put together once.

A call that hands over thirty arrays spends 2 µs on them, and several times that where they are of records; a handle
takes half a microsecond whatever it holds. A handle has a class and a type, both in the module that uses them, since
numba's cache finds them by name:

    @structref.register
    class CascadeType(HandleType): ...

    class Cascade(Handle): ...

    define(Cascade, CascadeType, "state", "ring")

A kernel makes it (`Cascade(state, ring)`, of arrays, numbers and NamedTuples of those), and kernels read its fields.
"""

from typing import Any

from numba import types
from numba.experimental import structref


class HandleType(types.StructRef):
    """numba's type of a handle."""

    def preprocess_fields(self, fields: Any) -> tuple[tuple[str, Any], ...]:
        """Types of the fields; numbers that are known are as any others."""
        return tuple((name, types.unliteral(kind)) for name, kind in fields)


class Handle(structref.StructRefProxy):
    """A handle, as Python has it."""

    def __reduce__(self) -> tuple[type[None], tuple[()]]:
        """A copy or a pickle has None in its place: who owns the arrays makes it anew (`samples.Sharing`)."""
        return type(None), ()


def define(handle: type[Handle], kind: type[HandleType], *fields: str) -> None:
    """Tell numba how to make a handle from its fields, and how to read them."""
    structref.define_constructor(handle, kind, list(fields))
    structref.define_attributes(kind)
    structref.define_boxing(kind, handle)
