"""Where a file came from, in the two forms that file formats have room for: values and lines.

Names of people and folders stay at home: a `Path` becomes its last part. What the caller writes as
text is his own word and kept.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePath

import numpy as np


def plain(value: object) -> object:
    """`value` as JSON knows it: paths by their last part, arrays and tuples as lists."""
    if isinstance(value, PurePath):
        return value.name
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [plain(entry) for entry in value]
    return value


def lines(provenance: Mapping[str, object]) -> tuple[str, ...]:
    """One line ``key: value`` an entry; nested keys joined by dots, line breaks made spaces."""
    return tuple(" ".join(line.split()) for line in _lines(provenance, ""))


def _lines(provenance: Mapping[str, object], prefix: str) -> Iterator[str]:
    for key, value in provenance.items():
        if isinstance(value, Mapping):
            yield from _lines(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}: {plain(value)}"
