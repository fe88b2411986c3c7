"""Optional packages: where one is missing, its error says what to install."""

from collections.abc import Iterator
from contextlib import contextmanager

_OWN = {"agents", "benchmarks", "relloc_env", "train"}


class MissingExtraError(ModuleNotFoundError):
    """A package that an extra of this one brings is not installed."""


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Say which extra brings the packages that are imported inside.

    Args:
        name: of the extra that brings them.

    Raises:
        MissingExtraError: one of them is missing.
    """
    try:
        yield
    except MissingExtraError:
        raise
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package in _OWN:
            raise
        raise MissingExtraError(
            f"The package `{package}` is missing: pip install 'relloc-env[{name}]', or in a checkout "
            f"pip install -e '.[{name}]'",
            name=error.name,
        ) from None
