"""The text of a recorded file: UTF-8 with or without a byte order mark, plain or compressed by gzip."""

import gzip
import json
import math
import zlib
from io import BytesIO
from pathlib import Path
from typing import Any

from relloc_env.logs.errors import LogError

MAGIC = b"\x1f\x8b"
"""First bytes of a file that gzip made."""
LARGEST = 2**29
"""[bytes] greatest size of a compressed file's content: a small file may hold very much of one character."""
DIGITS = 300
"""Longest whole number in JSON that a float can hold."""


def stored(path: Path) -> Path:
    """Return the file that holds `path`: itself, or where it is missing, the one with `.gz` behind its name."""
    packed = path.with_name(path.name + ".gz")
    return packed if not path.exists() and packed.exists() else path


def read_text(path: Path) -> str:
    """Return the text of a file, or raise `LogError` where it is missing, unreadable, not text, or empty."""
    path = stored(path)
    try:
        data = path.read_bytes()
        if data.startswith(MAGIC):
            data = _unpack(path, data)
        text = data.decode("utf-8-sig")
    except FileNotFoundError:
        raise LogError(path, "file not found") from None
    except UnicodeDecodeError:
        raise LogError(path, "is not a text file in UTF-8") from None
    except (EOFError, gzip.BadGzipFile, zlib.error):
        raise LogError(path, "cannot be unpacked: truncated?") from None
    except OSError as error:
        raise LogError(path, f"cannot be read ({error.strerror})") from None
    except ValueError as error:
        raise LogError(path, f"cannot be read ({error})") from None
    if not text.strip():
        raise LogError(path, "is empty")
    return text


def _unpack(path: Path, packed: bytes) -> bytes:
    """Return what gzip packed, piece by piece: a small file may hold very much."""
    data = bytearray()
    with gzip.open(BytesIO(packed)) as file:
        while piece := file.read(2**20):
            data += piece
            if len(data) > LARGEST:
                raise LogError(path, f"must hold at most {LARGEST} bytes, but holds more")
    return bytes(data)


def read_json(path: Path) -> Any:
    """Return the content of a JSON file, in which every number is finite and fits a float."""
    text = read_text(path)
    try:
        return json.loads(text, parse_constant=_refuse, parse_float=_real, parse_int=_whole)
    except json.JSONDecodeError as error:
        raise LogError(stored(path), f"is not JSON ({error.msg})", error.lineno) from None
    except RecursionError:
        raise LogError(stored(path), "is nested too deeply") from None
    except ValueError as error:
        raise LogError(stored(path), str(error)) from None


def _refuse(word: str) -> Any:
    raise ValueError(f"numbers must be finite, but one is {word}")


def _real(word: str) -> float:
    value = float(word)
    return value if math.isfinite(value) else _refuse(word[:40])


def _whole(word: str) -> int:
    return int(word) if len(word) <= DIGITS else _refuse(f"{word[:40]}… ({len(word)} digits)")
