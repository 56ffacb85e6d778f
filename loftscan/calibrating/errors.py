"""What a calibration can refuse."""

from __future__ import annotations

from acquisition.errors import AcquisitionError


class CalibrationRefused(AcquisitionError):  # noqa: N818 (the house names errors after the fact)
    """No calibration comes of these scans; says why and what would make one."""


class Drifted(AcquisitionError):  # noqa: N818
    """The station no longer stands as it was calibrated."""
