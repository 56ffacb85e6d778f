"""Pictures as PNG bytes, with no time stamp in them: the same picture gives the same bytes."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

from loftscan.rendering.scene import ByteArray


def encode_png(image: ByteArray) -> bytes:
    """Encode RGB bytes (h, w, 3).

    Raises
    ------
    ValueError
        If the image is not (h, w, 3) bytes.
    """
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        raise ValueError(f"png: bytes of shape (h, w, 3) expected, got {image.dtype} {image.shape}")
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, "png", compress_level=4)
    return stream.getvalue()


def decode_png(data: bytes) -> ByteArray:
    """Decode PNG bytes to RGB bytes (h, w, 3)."""
    with Image.open(io.BytesIO(data)) as picture:
        return np.asarray(picture.convert("RGB"))
