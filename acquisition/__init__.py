"""The station: what moves when, where the sensor stands, and what is kept.

Imports the drivers' values and numpy, nothing of reconstruction and no scipy: the process that
owns the laser stays small. `acquisition.scan.scan` yields slices; `acquisition.scanfile.ScanWriter`
keeps them in a .scan folder, which others follow.
"""
