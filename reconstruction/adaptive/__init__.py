"""Where the next slice is worth most, told by the sections so far."""

from reconstruction.adaptive.choosing import Choice, Span, choose, spans_between
from reconstruction.adaptive.foretelling import Level, Kind, level_of

__all__ = ["Choice", "Kind", "Level", "Span", "choose", "level_of", "spans_between"]
