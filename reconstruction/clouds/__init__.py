"""Point clouds as they come: files of six formats and arrays, read in chunks of bounded size."""

from __future__ import annotations

from reconstruction.clouds.cloud import EXTENSIONS, Chunk, Cloud, array_cloud, open_cloud

__all__ = ["EXTENSIONS", "Chunk", "Cloud", "array_cloud", "open_cloud"]
