"""Where the next slice is worth most, told by the sections so far (docs/adaptive.md)."""

from reconstruction.adaptive.choosing import Choice, Span, choose, spans_between
from reconstruction.adaptive.foretelling import Kind, Level, level_of

__all__ = ["Choice", "Kind", "Level", "Span", "choose", "level_of", "spans_between"]
