"""One device: bytes on one side, counts, millimetres and radians on the other.

Nothing here knows a part, a plan or a calibration. A driver is a protocol's codec (pure functions
in both directions), a link (`drivers.links`), and one of three small Protocols (`axis`, `profiler`,
`laser`).
"""
