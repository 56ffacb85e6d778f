"""An AZ drive of Oriental Motor on RS-485, commanded by direct data operations."""

from sim.oriental.drive import AzDrive, AzSettings

__all__ = ["AzDrive", "AzSettings"]
