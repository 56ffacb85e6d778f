"""From lit pixels to the picture: soft occlusion, a fine outline, the backdrop, the mean of pixels.

The occlusion compares each pixel's nearness with pairs of opposite neighbours, as Bavoil and
Sainz (ShaderX7, 2009, Multi-layer dual-resolution SSAO) and eye-dome lighting (Boucheny 2009) do
with single ones: on a plane a pair's differences cancel, in a hollow both are positive. It is what
lets a bare cloud of a million points be read as a shape.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from loftscan.rendering.camera import Camera, View
from loftscan.rendering.lighting import LightArray, studio_light
from loftscan.rendering.rasterising import NOTHING, DepthArray, IdArray, draw_triangles
from loftscan.rendering.scene import ByteArray, MeshLayer

SUBPIXELS = 2  # a side; the kernels below are written for this
_PAIRS = 8
_WEAKEST = 0.42  # of the light that is left in a pixel that can see hardly anything
_SHALLOW = 0.06  # rise over run of a hollow that hides nothing, such as between two facets
_SHADOW_SHRINK = 4
_SLOPE_REACH_PX = 5
_OUTLINE = 0.55  # of the light that is left on an outline


def occlusion(near: DepthArray, *, scale_px_mm: float, reach_px: float) -> LightArray:
    """Light that reaches each pixel, (h, w) in [0, 1], from each pixel's nearness (h, w)."""
    noisy = _occlusion(near, 1.0 / scale_px_mm, reach_px)
    return np.asarray(_smoothed(noisy, near, reach_px / scale_px_mm))


@njit(cache=True)
def nearest(nearness: DepthArray) -> DepthArray:
    """Nearness of each pixel (h, w): that of its nearest subpixel (2h, 2w)."""
    height, width = nearness.shape[0] // 2, nearness.shape[1] // 2
    near = np.empty((height, width), np.float32)
    for i in range(height):
        for j in range(width):
            near[i, j] = max(
                max(nearness[2 * i, 2 * j], nearness[2 * i, 2 * j + 1]),
                max(nearness[2 * i + 1, 2 * j], nearness[2 * i + 1, 2 * j + 1]),
            )
    return near


@njit(cache=True)
def light_clouds(
    light: LightArray, near: DepthArray, ids: IdArray, first: int, last: int, mm_px: float
) -> None:
    """Light points as the surface that they seem to lie on; `light` (h, w) is changed in place.

    The slope is a least-squares plane through the depth of the pixels around; pixels over a step in
    depth have no say.
    """
    for i in range(light.shape[0]):
        for j in range(light.shape[1]):
            if near[i, j] == -np.inf:
                continue
            seen = max(
                max(ids[2 * i, 2 * j], ids[2 * i, 2 * j + 1]),
                max(ids[2 * i + 1, 2 * j], ids[2 * i + 1, 2 * j + 1]),
            )
            if first <= seen < last:
                x, y, z = _seeming_normal(near, i, j, mm_px)
                light[i, j] *= 0.25 + 0.85 * studio_light(x, y, z)[0]


def compose(
    lit: LightArray,
    ids: IdArray,
    nearness: DepthArray,
    open_light: LightArray,
    backdrop: LightArray,
    *,
    step_mm: float,
    outlined: int,
) -> ByteArray:
    """Mean of the subpixels as sRGB bytes, (h, w, 3).

    Parameters
    ----------
    lit, ids, nearness
        Subpixels (2h, 2w, 3) and (2h, 2w).
    open_light
        Factor of the light in each pixel, (h, w).
    backdrop
        Linear light (h, w, 3) where nothing stands.
    step_mm
        A step in depth over this draws a fine dark line along the nearer side,
    outlined
        of what has a number under this one: triangles, not points or lines.
    """
    return np.asarray(
        _composed(lit, ids, nearness, open_light, backdrop, step_mm, outlined, _ENCODED)
    )


def paper(size_px: tuple[int, int]) -> LightArray:
    """Plain white."""
    return np.ones((size_px[1], size_px[0], 3), np.float32)


def studio(
    size_px: tuple[int, int], view: View, camera: Camera, meshes: tuple[MeshLayer, ...]
) -> LightArray:
    """Return a neutral grey, lighter behind the part, with the meshes' shadow on the floor."""
    width, height = size_px
    x = np.linspace(-1, 1, width, dtype=np.float32)[None, :]
    y = np.linspace(-1, 1, height, dtype=np.float32)[:, None]
    glow = np.exp(-(np.float32(0.55) * x * x + np.float32(0.8) * (y + np.float32(0.15)) ** 2))
    grey = np.float32(0.60) + np.float32(0.30) * glow
    if meshes and camera.elevation_rad > 0:
        grey = grey * (1 - _shadow(size_px, view, camera, meshes))
    return np.asarray(grey[:, :, None] * np.array([0.985, 0.995, 1.0], np.float32))


def linear_light(colours: ByteArray) -> LightArray:
    """SRGB bytes to linear light (IEC 61966-2-1)."""
    return np.asarray(_LINEAR[colours], np.float32)


def _decoded(code: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


def _encoded(light: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


_LINEAR = _decoded(np.arange(256) / 255)
_ENCODED = np.rint(255 * _encoded(np.arange(1 << 14) / ((1 << 14) - 1))).astype(np.uint8)


def _shadow(
    size_px: tuple[int, int], view: View, camera: Camera, meshes: tuple[MeshLayer, ...]
) -> NDArray[np.float32]:
    """Share of the light that the floor misses, (h, w): a wide shadow, and a dark one at the foot.

    Drawn at a quarter of the size and blurred, shortened as the floor is.
    """
    width, height = size_px
    up = camera.up_index
    floor = float(camera.bounds_mm[0, up])
    tall = float(camera.bounds_mm[1, up]) - floor or 1.0
    wide, foot = (np.zeros((-(-height // 4), -(-width // 4))) for _ in range(2))
    for layer in meshes:
        fallen = np.array(layer.mesh.vertices_mm)
        rise = (fallen[layer.mesh.faces, up] - floor).min(axis=1, initial=np.inf) / tall
        fallen[:, up] = floor
        screen = view.project(fallen) * [1 / _SHADOW_SHRINK, 1 / _SHADOW_SHRINK, 1]
        np.maximum(wide, _covered(screen, layer.mesh.faces, wide.shape), out=wide)
        np.maximum(foot, _covered(screen, layer.mesh.faces[rise < 0.1], foot.shape), out=foot)
    reach = view.scale_px_mm * camera.radius_mm / _SHADOW_SHRINK
    shorten = np.sin(camera.elevation_rad)
    dark = 0.30 * _blurred(wide, 0.14 * reach, shorten) + 0.38 * _blurred(
        foot, 0.03 * reach, shorten
    )
    return _enlarged(_enlarged(dark, height).T, width).T


def _enlarged(image: NDArray[np.floating], rows: int) -> NDArray[np.float32]:
    """Linear interpolation down the columns, to `rows` pixels."""
    place = np.clip((np.arange(rows) + 0.5) / _SHADOW_SHRINK - 0.5, 0, len(image) - 1)
    low = np.minimum(place.astype(int), max(len(image) - 2, 0))
    share = (place - low)[:, None].astype(np.float32)
    image = np.asarray(np.concatenate([image, image[-1:]]), np.float32)
    return np.asarray(image[low] * (1 - share) + image[low + 1] * share)


def _covered(
    screen: NDArray[np.float64], faces: NDArray[np.int64], shape: tuple[int, ...]
) -> NDArray[np.float64]:
    nearness = np.full(shape, -np.inf, np.float32)
    ids = np.full(shape, NOTHING, np.int32)
    draw_triangles(screen, faces.astype(np.int32), 0, nearness, ids)
    return np.asarray(ids != NOTHING, np.float64)


def _blurred(mask: NDArray[np.float64], sigma: float, shorten: float) -> NDArray[np.float64]:
    sigmas = (sigma * shorten, sigma)
    return np.asarray(ndimage.gaussian_filter(mask, sigmas, mode="nearest", truncate=3))


@njit(cache=True)
def _composed(
    lit: LightArray,  # (2h, 2w, 3)
    ids: IdArray,  # (2h, 2w)
    nearness: DepthArray,  # (2h, 2w)
    open_light: LightArray,  # (h, w)
    backdrop: LightArray,  # (h, w, 3)
    step_mm: float,
    outlined: int,
    encoded: ByteArray,
) -> ByteArray:
    height, width = backdrop.shape[0], backdrop.shape[1]
    picture = np.empty(backdrop.shape, np.uint8)
    sums = np.empty(3, np.float32)
    for row in range(height):
        for column in range(width):
            sums[:] = 0.0
            for sub in range(4):
                i, j = 2 * row + sub // 2, 2 * column + sub % 2
                tone = open_light[row, column]
                if NOTHING < ids[i, j] < outlined and _before_a_step(nearness, i, j, step_mm):
                    tone *= _OUTLINE
                for channel in range(3):
                    if ids[i, j] == NOTHING:
                        sums[channel] += backdrop[row, column, channel]
                    else:
                        sums[channel] += tone * lit[i, j, channel]
            _encode(encoded, sums, picture[row, column])
    return picture


@njit(cache=True)
def _encode(encoded: ByteArray, sums: LightArray, bytes_of_pixel: ByteArray) -> None:
    """Look up the bytes of sums over four subpixels; what is brighter than white is white."""
    last = encoded.shape[0] - 1
    for channel in range(3):
        light = min(max(0.25 * sums[channel], 0.0), 1.0)
        bytes_of_pixel[channel] = encoded[int(light * last + 0.5)]


@njit(cache=True)
def _seeming_normal(near: DepthArray, i: int, j: int, mm_px: float) -> tuple[float, float, float]:
    sxx, sxy, syy, sxn, syn = 1e-9, 0.0, 1e-9, 0.0, 0.0
    limit = 4.0 * _SLOPE_REACH_PX * mm_px
    for di in range(-_SLOPE_REACH_PX, _SLOPE_REACH_PX + 1, 2):
        for dj in range(-_SLOPE_REACH_PX, _SLOPE_REACH_PX + 1, 2):
            k, m = i + di, j + dj
            if k < 0 or m < 0 or k >= near.shape[0] or m >= near.shape[1]:
                continue
            rise = near[k, m] - near[i, j]
            if abs(rise) < limit:
                x, y = dj * mm_px, -di * mm_px
                sxx, sxy, syy = sxx + x * x, sxy + x * y, syy + y * y
                sxn, syn = sxn + x * rise, syn + y * rise
    determinant = sxx * syy - sxy * sxy
    slope_x = (sxn * syy - syn * sxy) / determinant
    slope_y = (syn * sxx - sxn * sxy) / determinant
    length = np.sqrt(slope_x**2 + slope_y**2 + 1.0)
    return -slope_x / length, -slope_y / length, 1.0 / length


@njit(cache=True)
def _occlusion(near: DepthArray, mm_px: float, reach_px: float) -> LightArray:
    """Per-pixel openness; the pattern of pairs turns with the place in a 4 x 4 tile."""
    height, width = near.shape
    light = np.ones((height, width), np.float32)
    offsets = _pair_offsets(reach_px)
    for i in range(height):
        for j in range(width):
            here = near[i, j]
            if here == -np.inf:
                continue
            turn = 4 * (i % 4) + (5 * (i % 4) + j) % 4
            hidden = 0.0
            for pair in range(_PAIRS):
                di, dj = offsets[turn, pair, 0], offsets[turn, pair, 1]
                limit = np.sqrt(di * di + dj * dj) * mm_px
                first = _rise(near, i + di, j + dj, here, limit)
                second = _rise(near, i - di, j - dj, here, limit)
                hidden += max(0.0, (first + second) / (2.0 * limit) - _SHALLOW)
            light[i, j] = 1.0 - (1.0 - _WEAKEST) * min(1.0, 1.9 * hidden / _PAIRS)
    return light


@njit(cache=True)
def _pair_offsets(reach_px: float) -> NDArray[np.int64]:
    """(16, pairs, 2) offsets in pixels: a spiral, turned 16 times within half a turn."""
    offsets = np.empty((16, _PAIRS, 2), np.int64)
    for turn in range(16):
        for pair in range(_PAIRS):
            angle = np.pi * (((turn * 7) % 16) / 16.0 + pair * 0.618034)
            radius = max(2.5, reach_px * ((pair + 0.5 + turn / 32.0) / _PAIRS) ** 1.5)
            offsets[turn, pair, 0] = round(radius * np.sin(angle))
            offsets[turn, pair, 1] = round(radius * np.cos(angle))
    return offsets


@njit(cache=True)
def _rise(near: DepthArray, i: int, j: int, here: float, limit: float) -> float:
    if i < 0 or j < 0 or i >= near.shape[0] or j >= near.shape[1]:
        return -limit
    rise: float = min(max(near[i, j] - here, -limit), limit)
    return rise


@njit(cache=True)
def _smoothed(light: LightArray, near: DepthArray, step_mm: float) -> LightArray:
    """Mean over the 4 x 4 tile around each pixel, not over steps in depth."""
    height, width = light.shape
    smooth = np.ones((height, width), np.float32)
    for i in range(height):
        for j in range(width):
            here = near[i, j]
            if here == -np.inf:
                continue
            total, count = 0.0, 0
            for k in range(max(0, i - 2), min(height, i + 2)):
                for m in range(max(0, j - 2), min(width, j + 2)):
                    if abs(near[k, m] - here) < step_mm:
                        total += light[k, m]
                        count += 1
            smooth[i, j] = total / count
    return smooth


@njit(cache=True)
def _before_a_step(nearness: DepthArray, i: int, j: int, step_mm: float) -> bool:
    height, width = nearness.shape
    floor = nearness[i, j] - step_mm
    stepped: bool = (
        (i > 0 and nearness[i - 1, j] < floor)
        or (j > 0 and nearness[i, j - 1] < floor)
        or (i + 1 < height and nearness[i + 1, j] < floor)
        or (j + 1 < width and nearness[i, j + 1] < floor)
    )
    return stepped
