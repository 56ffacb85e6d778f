"""A Hokuyo scanner that speaks SCIP 2.0 on a serial line or USB."""

from sim.hokuyo.scanner import HokuyoScanner, ScannerSettings

__all__ = ["HokuyoScanner", "ScannerSettings"]
