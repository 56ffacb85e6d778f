"""Two views of one part, such as before and after it was turned over, laid onto each other.

::

    patches      where the points are a surface: sites, quadrics in raw points, normals
    searching    every way to lay one on the other, roughly; the few that fit
    settling     patch against patch until nothing moves; covariance
    determinacy  which motions the shape does not hold
    registering  all of it; refused where it is not determined, or more than one way fits
"""

from reconstruction.registration.determinacy import Freedom
from reconstruction.registration.patches import View
from reconstruction.registration.registering import Registration, register_views

__all__ = ["Freedom", "Registration", "View", "register_views"]
