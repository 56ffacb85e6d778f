"""One slice's raw points to curves at the statistical floor: the method ``fit``, in the plane.

points -> cells -> Chain: what belongs together, in which order -> FittedCurve
          topology                                                 penalised fit of raw points
"""
