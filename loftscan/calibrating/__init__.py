"""Where the laser stands: an artefact's scans to kinematics with a covariance and a verdict.

::

    artefact.toml, .scan folders --finding--> points of each sphere, plate, cylinder, frustum
                                 --solving--> kinematics, covariance, residuals
                                 --verdict--> what is observable, in words --> calibration.toml

It stands here and not in `acquisition`, because it needs scipy and the process that owns the laser
stays small; what a scan reads of it is `acquisition.calibration`. Equations: docs/calibration.md.
"""
