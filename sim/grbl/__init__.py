"""A turntable on a Grbl 1.1h board, at the far end of its serial line."""

from sim.grbl.board import GrblBoard
from sim.grbl.settings import GrblSettings

__all__ = ["GrblBoard", "GrblSettings"]
