"""How tables write numbers."""

import math
from collections.abc import Mapping

WHOLE = 100.0
"""From here on numbers are written without decimals."""
LARGE = 1e4
"""From here on numbers are written with a power of ten."""
FAR: Mapping[str, float] = {"m": 10.0, "%": 100.0}
"""By unit (percent: of a range): errors beyond say only that an estimate has nothing to do with the truth."""


def number(value: float | None, digits: int, *, sign: bool = False, error: str = "") -> str:
    """A number as tables show it.

    Args:
        value: the number; infinity is `never`, NaN and None a dash.
        digits: behind the point; none from 100 on.
        sign: whether to write a plus.
        error: the unit, where it is the size of an error: beyond `FAR` it is written as `> 10 m`.
    """
    if value is None or math.isnan(value):
        return "–"
    if value > FAR.get(error, math.inf):
        return f"> {FAR[error]:.0f} {error}"
    if math.isinf(value):
        return "never"
    if abs(value) >= LARGE:
        return f"{value:.0e}".replace("e+0", "e").replace("e+", "e")
    return f"{value:{'+' if sign else ''}.{0 if abs(value) >= WHOLE else digits}f}".replace("-", "−")
