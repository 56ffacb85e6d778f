"""Where the next slice is worth most, told by the sections so far (docs/adaptive.md)."""

from reconstruction.adaptive.choosing import Choice, Span, choose, expected_mm, spans_between
from reconstruction.adaptive.foretelling import Kind, Level, level_of

__all__ = ["Choice", "Kind", "Level", "Span", "choose", "expected_mm", "level_of", "spans_between"]
