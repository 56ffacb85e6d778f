"""The parts that the simulated station knows by name.

The vase is a superformula (Gielis 2003, doi:10.3732/ajb.90.3.333) with a twist; the badly acquired
cylinder is the one of the paper's Fig. 7: a sound solid with many patches that return no light; the
blade's sections are NACA four-digit thickness (NACA report 460) on a parabolic camber line.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from sim.arrays import FloatArray
from sim.artefacts import ARTEFACTS
from sim.solids import Part, radial_solid, read_mesh, stack_rings

_DARK = 0.0


def cylinder(
    radius_mm: float = 40.0, height_mm: float = 80.0, *, around: int = 2048, levels: int = 9
) -> Part:
    """A right cylinder; 2048 corners stay within 0.05 um of the circle of 40 mm."""

    def law(angle_rad: FloatArray, height_mm: FloatArray) -> FloatArray:
        return np.full(np.broadcast_shapes(angle_rad.shape, height_mm.shape), radius_mm)

    return radial_solid("cylinder", law, np.linspace(0.0, height_mm, levels), around)


def cone(
    radius_mm: float = 40.0, height_mm: float = 80.0, *, around: int = 2048, levels: int = 17
) -> Part:
    """A right cone that ends in its apex."""

    def law(angle_rad: FloatArray, at_mm: FloatArray) -> FloatArray:
        return radius_mm * (1.0 - at_mm / height_mm) + 0.0 * angle_rad

    return radial_solid("cone", law, np.linspace(0.0, height_mm, levels), around)


def vase(
    radius_mm: float = 30.0,
    height_mm: float = 100.0,
    *,
    twist_rad: float = 0.8,
    around: int = 400,
    levels: int = 126,
) -> Part:
    """A five-lobed superformula section, bellied over its height and twisted; 100 000 faces."""

    def law(angle_rad: FloatArray, at_mm: FloatArray) -> FloatArray:
        share = at_mm / height_mm
        belly = 1.0 + 0.25 * np.sin(1.5 * np.pi * share) - 0.15 * share
        return radius_mm * belly * superformula(angle_rad - twist_rad * share)

    return radial_solid("vase", law, np.linspace(0.0, height_mm, levels), around)


def superformula(
    angle_rad: FloatArray, *, lobes: int = 5, n1: float = 6.0, n2: float = 5.0, n3: float = 5.0
) -> FloatArray:
    """Gielis's radius with a = b = 1: at most 1.2 and at least 1 for these exponents."""
    cosine = np.abs(np.cos(lobes * angle_rad / 4.0)) ** n2
    sine = np.abs(np.sin(lobes * angle_rad / 4.0)) ** n3
    return np.asarray((cosine + sine) ** (-1.0 / n1))


def badly_acquired(
    radius_mm: float = 50.0, height_mm: float = 100.0, *, patches: int = 60, seed: int = 7
) -> Part:
    """The paper's cylinder: sound as a solid, black in many patches, so that slices have gaps."""
    sound = cylinder(radius_mm, height_mm, around=1024, levels=51)
    middle = sound.vertices_mm[sound.faces].mean(axis=1)
    angle_rad = np.arctan2(middle[:, 1], middle[:, 0])
    rng = np.random.default_rng(seed)
    reflectance = np.ones(len(sound.faces), np.float32)
    for at_rad, at_mm, wide_rad, high_mm in zip(
        rng.uniform(-np.pi, np.pi, patches),
        rng.uniform(0.0, height_mm, patches),
        rng.uniform(0.08, 0.35, patches),
        rng.uniform(0.03, 0.12, patches) * height_mm,
        strict=True,
    ):
        across = np.abs((angle_rad - at_rad + np.pi) % math.tau - np.pi) / wide_rad
        reflectance[across**2 + ((middle[:, 2] - at_mm) / high_mm) ** 2 < 1.0] = _DARK
    return replace(sound, name="badly-acquired", reflectance=reflectance)


def blade(
    chord_mm: float = 44.0,
    height_mm: float = 90.0,
    *,
    twist_rad: float = 0.7,
    taper: float = 0.35,
    levels: int = 91,
) -> Part:
    """A stylised turbine blade: a twisted, tapered aerofoil on a round hub of 20 mm height."""
    hub_mm, hub_radius_mm = 20.0, 0.7 * chord_mm
    section = _aerofoil() * chord_mm
    share = np.linspace(0.0, 1.0, levels)
    turn = np.exp(1j * twist_rad * share) * (1.0 - taper * share)
    outline = (section[:, 0] + 1j * section[:, 1]) * turn[:, None]
    heights = np.broadcast_to(hub_mm + share[:, None] * (height_mm - hub_mm), outline.shape)
    aerofoils = np.stack([outline.real, outline.imag, heights], axis=-1)
    # The hub's corners stand at the root section's angles: the shoulder's strips are then radial.
    rim = hub_radius_mm * outline[0] / np.abs(outline[0])
    hub = [
        np.column_stack([rim.real, rim.imag, np.full(len(rim), at_mm)]) for at_mm in (0.0, hub_mm)
    ]
    vertices_mm, faces = stack_rings(np.concatenate([hub, aerofoils]))
    return Part("blade", vertices_mm, faces)


def _aerofoil(
    half: int = 120, thickness: float = 0.18, camber: float = 0.02, blunt: float = 0.012
) -> FloatArray:
    """Outline (2 half, 2) of chord 1, counter-clockwise, star-shaped around the origin.

    The trailing edge is blunt: a knife edge would be no solid for the chord's bend.
    """
    turn = np.arange(2 * half) * (np.pi / half)
    x = 0.5 * (1.0 + np.cos(turn))
    naca = 0.2969 * np.sqrt(x) - 0.1260 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4
    half_thickness = (
        5.0 * thickness * naca + blunt * np.sqrt(x * (1.0 - x)) + blunt * x * (turn > 0)
    )
    line = 4.0 * camber * x * (1.0 - x)
    y = line + np.where(turn <= np.pi, half_thickness, -half_thickness)
    return np.column_stack([x - 0.4, y - 4.0 * camber * 0.4 * 0.6])


PARTS: Mapping[str, Callable[[], Part]] = MappingProxyType(
    {
        "cylinder": cylinder,
        "cone": cone,
        "vase": vase,
        "badly-acquired": badly_acquired,
        "blade": blade,
    }
)


def find_part(name_or_file: str) -> Part:
    """Make the part of that name, or read the mesh file.

    Raises
    ------
    ValueError
        Neither a name nor a mesh; lists the names.
    OSError
        The file cannot be read.
    """
    known = {**PARTS, **ARTEFACTS}
    if name_or_file in known:
        return known[name_or_file]()
    path = Path(name_or_file)
    if not path.is_file():
        raise ValueError(
            f"part {name_or_file!r}: no such file; built-in parts are {', '.join(known)}"
        )
    return read_mesh(path)
