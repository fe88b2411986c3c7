"""YAML, of which JSON is a part, within limits: a short text must not stand for a huge configuration."""

from typing import Any

import yaml

LONGEST, MOST, DEEPEST = 1_000_000, 20_000, 50
"""Characters of a text, values in it where aliases stand for what they repeat, and levels of them."""


def parse(text: str) -> Any:
    """Return the plain data of a YAML or JSON text.

    Raises:
        yaml.YAMLError, ValueError, RecursionError: a text of another form, or beyond the limits.
    """
    if len(text) > LONGEST:
        raise ValueError(f"it has {len(text)} characters, which are more than {LONGEST}")
    loader = yaml.SafeLoader(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return None
        _measure(node, {}, ())
        return loader.construct_document(node)
    finally:
        loader.dispose()


def _measure(node: yaml.Node, known: dict[yaml.Node, tuple[int, int]], above: tuple[yaml.Node, ...]) -> tuple[int, int]:
    """Count values and levels of a node, each node looked at once; raise ValueError where there are too many."""
    if node in above:
        raise ValueError("an alias stands within what it repeats")
    if node not in known:
        inside: list[Any] = node.value if isinstance(node, yaml.CollectionNode) else []
        parts = [part for each in inside for part in (each if isinstance(each, tuple) else (each,))]
        measured = [_measure(part, known, (*above, node)) for part in parts]
        known[node] = 1 + sum(size for size, _ in measured), 1 + max((depth for _, depth in measured), default=0)
    size, depth = known[node]
    if size > MOST or depth > DEEPEST or len(above) > DEEPEST:
        raise ValueError(f"it has more than {MOST} values, or more than {DEEPEST} levels of them")
    return size, depth
