"""What every estimator offers, whoever feeds it: the simulator, a rendered image or a recorded log."""

from typing import Any, Protocol

from numpy.typing import NDArray

from relloc_env.samples import Estimate, Prior, Rows, Samples


class Estimator(Protocol):
    """Estimates of points and relative poses for N environments, from what the robots see and are told.

    A call works on the environments `rows`; the others stay as they are. Arguments are full-sized (N first), whatever
    the rows. A reset is followed by a first sample of period 0, given to `update` like any other.
    """

    def reset(self, prior: Prior, rows: Rows) -> None:
        """Forget everything about the environments `rows` and start from `prior`."""

    def update(self, samples: Samples, rows: Rows) -> None:
        """Take the K samples in, in order."""

    @property
    def estimate(self) -> Estimate:
        """What is believed after the last sample: live arrays, refreshed in place by `reset` and `update`."""

    def get_state(self, rows: Rows) -> dict[str, NDArray[Any]]:
        """Copies of all that the estimator remembers of `rows`; every array has the rows as its first axis."""

    def set_state(self, state: dict[str, NDArray[Any]], rows: Rows) -> None:
        """Put back what `get_state` gave for as many rows, bit for bit."""
