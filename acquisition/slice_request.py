"""What reconstruction asks of a scan under way: a small file beside its folder.

::

    vase.scan/                  the scan writes, reconstruction reads
    vase.next.json              reconstruction writes, the scan reads   (docs/adaptive.md)

A request says of which slices it was made. It is an answer only to a scan that has just those.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from acquisition.durable import storage, write_whole

_FORMAT = "loftscan.next"
_VERSION = 1


@dataclass(frozen=True, slots=True)
class SliceRequest:
    """One more slice, or none."""

    seen: tuple[int, ...]  # the slices that it was made of, increasing
    index: int | None  # of the slice that is worth most; None: enough
    why: str
    expected_mm: float | None  # how far the surface is foretold to be off at the worst; if known


def request_file(scan: Path) -> Path:
    """Where the request for a .scan folder stands."""
    return scan.with_name(f"{scan.stem}.next.json")


def write_request(scan: Path, request: SliceRequest) -> None:
    """Put a request where the scan looks for it: whole, or not at all.

    Raises
    ------
    StorageFailed
    """
    file = request_file(scan)
    with storage(file.parent, f"writing {file.name}"):
        write_whole(file, encode_request(request, scan.name))


def encode_request(request: SliceRequest, scan: str) -> bytes:
    """Give the bytes of a request."""
    document = {
        "format": _FORMAT,
        "version": _VERSION,
        "unit": "mm",
        "scan": scan,
        "seen": list(request.seen),
        "index": request.index,
        "why": request.why,
        "expected_mm": request.expected_mm,
    }
    return (json.dumps(document, ensure_ascii=False) + "\n").encode()


def decode_request(data: bytes) -> SliceRequest:
    """Give back a request.

    Raises
    ------
    ValueError
        It is none; one line that says what is wrong.
    """
    try:
        document = json.loads(data)
    except (ValueError, RecursionError) as bad:
        raise ValueError(f"no JSON: {bad}") from bad
    if not isinstance(document, Mapping) or document.get("format") != _FORMAT:
        raise ValueError(f'format is not "{_FORMAT}"')
    if (document.get("version"), document.get("unit")) != (_VERSION, "mm"):
        raise ValueError(f"version {document.get('version')!r} in {document.get('unit')!r}")
    seen, index = document.get("seen"), document.get("index")
    why, expected = document.get("why"), document.get("expected_mm")
    if not isinstance(seen, list) or not all(_is_index(each) for each in seen):
        raise ValueError("seen is no list of slices")
    if index is not None and not _is_index(index):
        raise ValueError(f"index {index!r} is no slice")
    if type(why) is not str or not (expected is None or _is_length(expected)):
        raise ValueError(f"why {why!r} is no text, or expected_mm {expected!r} no length")
    return SliceRequest(tuple(seen), index, why, expected)


def _is_index(value: object) -> bool:
    return type(value) is int and value >= 0


def _is_length(value: object) -> bool:
    return type(value) in (int, float) and 0.0 <= value < math.inf  # type: ignore[operator]
