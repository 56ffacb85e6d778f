"""artefact.toml: what stands on the table, and what is known of it.

::

    name = "ball plate 7"
    [spheres.low]          radius_mm = 10.0015, radius_sd_mm = 0.0005
    [planes.plate]
    [cylinders.gauge]      radius_mm = 20.0
    [frustums.block]       base_mm = 60.0, top_mm = 30.0, height_mm = 20.0
    [spacings.far]         one = "low", other = "high", distance_mm = 62.103, held_out = true

Names are the user's. What a key leaves out is solved for, where that can be. Lengths are those at
the temperature of the scan.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np

from acquisition.arrays import FloatArray
from acquisition.settings import Key, parse_toml, read_table

_LARGEST_MM = 10_000.0
_MOST = 12  # elements: their names are found by trying
_SURE_MM = 0.05
Element = TypeVar("Element")


@dataclass(frozen=True, slots=True, kw_only=True)
class SphereOf:
    """A sphere."""

    radius_mm: Annotated[
        float | None, Key("certified; absent: solved for", at_least=0.1, at_most=_LARGEST_MM)
    ] = None
    radius_sd_mm: Annotated[
        float, Key("its standard uncertainty; 0: exact", at_least=0.0, at_most=1.0)
    ] = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaneOf:
    """A flat plate; nothing of it need be known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CylinderOf:
    """A cylinder that stands, more or less."""

    radius_mm: Annotated[
        float | None, Key("certified; absent: solved for", at_least=0.1, at_most=_LARGEST_MM)
    ] = None
    radius_sd_mm: Annotated[
        float, Key("its standard uncertainty; 0: exact", at_least=0.0, at_most=1.0)
    ] = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FrustumOf:
    """A square pyramid without its tip; all of it known."""

    base_mm: Annotated[float, Key("side of its foot", at_least=0.1, at_most=_LARGEST_MM)]
    top_mm: Annotated[float, Key("side of its top", at_least=0.1, at_most=_LARGEST_MM)]
    height_mm: Annotated[float, Key("from foot to top", at_least=0.1, at_most=_LARGEST_MM)]

    def __post_init__(self) -> None:
        if self.top_mm >= self.base_mm:
            raise ValueError(
                f"top_mm: {self.top_mm} is not below base_mm {self.base_mm}; a block without a"
                " slope fixes nothing along itself"
            )

    def faces(self) -> FloatArray:
        """Outward normals and distances (5, 4) from the middle of the foot: four sides, the top."""
        run, rise = (self.base_mm - self.top_mm) / 2.0, self.height_mm
        slant = math.hypot(run, rise)
        out, up = rise / slant, run / slant
        distance = self.base_mm / 2.0 * out
        ways = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
        sides = [(x * out, y * out, up, distance) for x, y in ways]
        return np.array([*sides, (0.0, 0.0, 1.0, rise)])


@dataclass(frozen=True, slots=True, kw_only=True)
class SpacingOf:
    """A certified distance between the middles of two spheres."""

    one: Annotated[str, Key("name of a sphere")]
    other: Annotated[str, Key("name of another")]
    distance_mm: Annotated[float, Key("between their middles", above=0.0, at_most=_LARGEST_MM)]
    sd_mm: Annotated[float, Key("its standard uncertainty", at_least=1e-5, at_most=1.0)] = 0.001
    held_out: Annotated[bool, Key("true: not solved with, but checked afterwards")] = False


@dataclass(frozen=True, slots=True)
class Artefact:
    """Everything artefact.toml says."""

    name: str
    certificate: str
    spheres: Mapping[str, SphereOf]
    planes: Mapping[str, PlaneOf]
    cylinders: Mapping[str, CylinderOf]
    frustums: Mapping[str, FrustumOf]
    spacings: Mapping[str, SpacingOf]
    sha256: str

    def words(self) -> str:
        """What it is made of."""
        kinds = {"sphere": self.spheres, "plane": self.planes, "cylinder": self.cylinders,
                 "frustum": self.frustums}  # fmt: skip
        counts = [f"{len(v)} {k}{'s' if len(v) > 1 else ''}" for k, v in kinds.items() if v]
        return f"{self.name} ({', '.join(counts)})"


_KINDS: Mapping[str, type[Any]] = {
    "spheres": SphereOf,
    "planes": PlaneOf,
    "cylinders": CylinderOf,
    "frustums": FrustumOf,
    "spacings": SpacingOf,
}


def parse_artefact(text: str, name: str = "artefact.toml") -> Artefact:
    """Make an artefact of the text of its file.

    Raises
    ------
    ValueError
        One line: the file, table.key, what is wrong and the fix.
    """
    table = parse_toml(text, name)
    known = ("name", "certificate", *_KINDS)
    if strange := [key for key in table if key not in known]:
        raise ValueError(f"{name}: {strange[0]}: unknown key; known here: {', '.join(known)}")
    for key in ("name", "certificate"):
        if not isinstance(table.get(key, ""), str):
            wrong = f"{name}: {key}: {table[key]!r} is no text; write it in quotes"
            raise ValueError(wrong)  # noqa: TRY004 (of a file, not of a caller)
    found = {kind: _elements(kind, table.get(kind, {}), name) for kind in _KINDS}
    made = Artefact(
        name=str(table.get("name", "artefact")),
        certificate=str(table.get("certificate", "")),
        sha256=hashlib.sha256(text.encode()).hexdigest(),
        **found,
    )
    _check(made, name)
    return made


def read_artefact(path: Path) -> Artefact:
    """Read and parse an artefact.toml; raises OSError as well."""
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as bad:
        raise ValueError(f"{path}: not UTF-8 text: {bad}; save it as UTF-8") from bad
    return parse_artefact(text, str(path))


def _elements(kind: str, tables: object, name: str) -> dict[str, Any]:
    if not isinstance(tables, Mapping):
        raise ValueError(f"{name}: {kind}: no table; write [{kind}.NAME]")  # noqa: TRY004
    found = {}
    for each, table in tables.items():
        if not isinstance(table, Mapping):
            wrong = f"{name}: {kind}.{each}: no table; write [{kind}.{each}] above it"
            raise ValueError(wrong)  # noqa: TRY004 (of a file, not of a caller)
        found[each] = read_table(_KINDS[kind], table, name, f"{kind}.{each}")
    return found


def _check(artefact: Artefact, name: str) -> None:
    elements = [
        *artefact.spheres, *artefact.planes, *artefact.cylinders, *artefact.frustums
    ]  # fmt: skip
    if not elements:
        raise ValueError(f"{name}: nothing on it; add [spheres.NAME], [planes.NAME] or another")
    if len(elements) > _MOST:
        raise ValueError(f"{name}: {len(elements)} elements; at most {_MOST} can be told apart")
    if twice := [each for each in elements if elements.count(each) > 1]:
        raise ValueError(f"{name}: {twice[0]}: names two elements; rename one")
    pairs: dict[frozenset[str], str] = {}
    for key, spacing in artefact.spacings.items():
        path = f"{name}: spacings.{key}"
        for end in (spacing.one, spacing.other):
            if end not in artefact.spheres:
                raise ValueError(
                    f"{path}: {end!r} is no sphere of this file; write [spheres.{end}]"
                )
        if spacing.one == spacing.other:
            raise ValueError(f"{path}: from {spacing.one} to itself; name two spheres")
        pair = frozenset((spacing.one, spacing.other))
        if pair in pairs:
            raise ValueError(f"{path}: the same two spheres as spacings.{pairs[pair]}; remove one")
        pairs[pair] = key
        _must_fit(artefact, spacing, path)
    _must_close(artefact, name)


def _must_fit(artefact: Artefact, spacing: SpacingOf, path: str) -> None:
    radii = [artefact.spheres[end].radius_mm or 0.0 for end in (spacing.one, spacing.other)]
    if spacing.distance_mm < sum(radii) - _SURE_MM:
        raise ValueError(
            f"{path}.distance_mm: {spacing.distance_mm} is less than both radii, {sum(radii):g}:"
            " the spheres would stand in each other; it is from middle to middle"
        )


def _must_close(artefact: Artefact, name: str) -> None:
    """Three distances of three spheres must make a triangle."""
    length = {frozenset((s.one, s.other)): s.distance_mm for s in artefact.spacings.values()}
    names = list(artefact.spheres)
    for i, a in enumerate(names):
        for j, b in enumerate(names[i + 1 :], i + 1):
            for c in names[j + 1 :]:
                sides = [length.get(frozenset(pair)) for pair in ((a, b), (b, c), (a, c))]
                known = [each for each in sides if each is not None]
                if len(known) == 3 and 2.0 * max(known) > sum(known) + _SURE_MM:
                    raise ValueError(
                        f"{name}: spacings of {a}, {b} and {c}: {known[0]:g}, {known[1]:g} and"
                        f" {known[2]:g} mm make no triangle; correct them"
                    )
