"""What commands print: no letter ends one."""

import sys


def lenient() -> None:
    """Print a question mark for what the terminal, or the file behind it, has no letter for."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
