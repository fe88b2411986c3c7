"""How messages quote what was given: never more than a line or two of it, however large it is."""

import reprlib
from typing import Any

LONGEST = 200
"""Characters of what is quoted."""
_REPR = reprlib.Repr()
_REPR.maxlevel = 4
_REPR.maxtuple = _REPR.maxlist = _REPR.maxdict = _REPR.maxset = _REPR.maxfrozenset = 12
_REPR.maxstring = _REPR.maxlong = _REPR.maxother = LONGEST


def quote(value: Any) -> str:
    """Return the `repr` of anything, with its middle cut out where it is long."""
    try:
        return cut(_REPR.repr(value))
    except Exception:  # noqa: BLE001 - anyone's `__repr__` may raise anything, that of a huge integer does
        return "a number of thousands of digits" if isinstance(value, int) else f"<{type(value).__name__}>"


def word(value: Any) -> str:
    """Return a name as it is, cut where it is long, and anything else as `quote` does."""
    return cut(value) if isinstance(value, str) else quote(value)


def cut(text: str, longest: int = LONGEST) -> str:
    """Return a text with its middle cut out where it is longer."""
    half = (longest - 3) // 2
    return text if len(text) <= longest else f"{text[:half]}...{text[-half:]}"
