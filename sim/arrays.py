"""The array vocabulary of this package, in one place."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

FloatArray = NDArray[np.float64]
SingleArray = NDArray[np.float32]
FaceArray = NDArray[np.int32]
ReasonArray = NDArray[np.uint8]
SegmentArray = NDArray[np.int32]


def frozen(values: ArrayLike, dtype: DTypeLike) -> NDArray[Any]:
    """Return a read-only, contiguous array of `dtype`; copies unless `values` already is one."""
    array = np.asarray(values, dtype=dtype)
    if array.flags.writeable or not array.flags.c_contiguous:
        array = np.array(array, dtype=dtype, order="C")
        array.flags.writeable = False
    return array
