"""Where a result came from: input, settings, versions. No path, no user, no host."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from loftscan.inputs import Input, hash_file

_LIBRARIES = ("numpy", "scipy", "numba", "pymeshlab", "cadquery-ocp-novtk", "rhino3dm")


def record(origin: Mapping[str, object], settings: Mapping[str, object]) -> dict[str, object]:
    """Describe a reconstruction for provenance.json and for the headers of its files.

    `origin` is `describe` of a cloud, or what the source of a scan's slices says of itself.
    """
    return {
        "program": "loftscan",
        "version": installed("loftscan"),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "unit": "mm",
        "input": dict(origin),
        "settings": dict(settings),
        "python": platform.python_version(),
        "libraries": {name: installed(name) for name in _LIBRARIES},
    }


def describe(source: Input) -> dict[str, object]:
    """Name, format, unit and hash of an input."""
    path: Path | None = source.cloud.path
    return {
        "name": source.name,
        "format": source.cloud.format,
        "unit": source.unit.value,
        "bytes": path.stat().st_size if path else None,
        "sha256": hash_file(path) if path else None,
    }


def installed(name: str) -> str | None:
    """Version of an installed distribution, None if it is absent."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None
