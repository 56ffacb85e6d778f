"""Tables of settings: a frozen dataclass says what a file may hold, and is what it becomes.

A field's name is the key, units included; its type, default, bounds and meaning stand beside it, so
that reading, refusing, and writing a commented file are said once::

    station.toml        [stage]                     @dataclass class LeadshineStage:
                        family = "leadshine"            family: ClassVar[str] = "leadshine"
                        screw_lead_mm = 5.0             screw_lead_mm: Annotated[float, Key("...")]

A table that comes in families is a union; the dataclass whose ``family`` (the selector) the file
names is the one that is read. Every refusal is one line that names the file, table.key and the fix.
"""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, dataclass, fields
from difflib import get_close_matches
from enum import Enum
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

Table = Mapping[str, Any]
Value = TypeVar("Value")


@dataclass(frozen=True, slots=True)
class Key:
    """What stands beside a field: its meaning, and the bounds of its value."""

    meaning: str
    at_least: float = -math.inf
    above: float = -math.inf
    at_most: float = math.inf
    starts: tuple[str, ...] = ()  # what a text may begin with; empty: anything
    parse: Callable[[str], object] | None = None  # refuses a text by ValueError

    @property
    def bounds(self) -> str:
        """The bounds in words."""
        said = [
            f"{words} {bound:g}"
            for words, bound in (
                ("above", self.above),
                ("at least", self.at_least),
                ("at most", self.at_most),
            )
            if math.isfinite(bound)
        ]
        return "a number " + " and ".join(said) if said else "a finite number"

    def admits(self, value: float) -> bool:
        """Whether a number is finite and within the bounds."""
        finite = math.isfinite(value)
        return finite and value > self.above and self.at_least <= value <= self.at_most


def parse_toml(text: str, name: str) -> Table:
    """Tables of a TOML text; `name` is the file's, for the refusal."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as bad:
        raise ValueError(f"{name}: not valid TOML: {bad}") from bad


def read_table(kind: type[Value], table: Table, name: str, path: str = "") -> Value:
    """Make a `kind` of a table; `name` is the file's, `path` the table's inside it.

    Raises
    ------
    ValueError
        Unknown, missing or ill-typed key, a value out of bounds; one line, with the remedy.
    """
    known = {each.name: each for each in fields(kind)}  # type: ignore[arg-type]
    for key in table:
        if key not in known and key != selector(kind):
            raise ValueError(f"{name}: {_joined(path, key)}: {_unknown(key, known, table, path)}")
    values = {
        key: _read(_declared(kind, key), key, table, name, _joined(path, key))
        for key, one in known.items()
        if key in table or one.default is MISSING
    }
    try:
        return kind(**values)
    except ValueError as bad:
        raise ValueError(f"{name}: {_joined(path, '')}{bad}") from bad


def parse_settings(kind: type[Value], text: str, name: str) -> Value:
    """Make a `kind` of a TOML text; `name` is the file's, for refusals.

    Raises
    ------
    ValueError
        One line: the file, table.key, what is wrong and the fix.
    """
    return read_table(kind, parse_toml(text, name), name)


def read_settings(kind: type[Value], path: Path) -> Value:
    """Read a file and make a `kind` of it.

    Raises
    ------
    ValueError
        As `parse_settings`, or the text is not UTF-8.
    OSError
        The file cannot be read.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as bad:
        raise ValueError(f"{path}: not UTF-8 text: {bad}; save it as UTF-8") from bad
    return parse_settings(kind, text, str(path))


def as_table(settings: object) -> dict[str, Any]:
    """Give back the table that `read_table` would read as an equal value."""
    kind = type(settings)
    chosen = {selector(kind): getattr(settings, selector(kind))} if selector(kind) else {}
    return chosen | {
        one.name: _plain(getattr(settings, one.name))
        for one in fields(settings)  # type: ignore[arg-type]
        if getattr(settings, one.name) is not None
    }


def commented_toml(settings: object, head: str) -> str:
    """Write settings as a TOML text that explains each key and reads back to an equal value."""
    lines = [f"# {each}".rstrip() for each in head.splitlines()]
    return "\n".join([*lines, "", *_lines(settings, "")]) + "\n"


def selector(kind: type) -> str:
    """Name the key that chooses this table among its rivals; empty when it has none."""
    return str(getattr(kind, "SELECTOR", ""))


def rivals(kind: object) -> tuple[type, ...]:
    """Give the dataclasses of a table's type; none when it is no table."""
    found = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    return tuple(each for each in found if hasattr(each, "__dataclass_fields__"))


def _declared(kind: type, name: str) -> tuple[Any, Key]:
    """Type and key of one field, out of its ``Annotated[type, Key(...)]``."""
    declared = _hints(kind)[name]
    key: Key = declared.__metadata__[0]
    return declared.__origin__, key


@cache  # resolving annotations is slow, and a follower reads scan.json twenty times a second
def _hints(kind: type) -> Mapping[str, Any]:
    return get_type_hints(kind, include_extras=True)


def _joined(path: str, key: str) -> str:
    return f"{path}.{key}" if path else key


def _plain(value: object) -> object:
    if isinstance(value, Enum):
        return value.value
    return as_table(value) if rivals(type(value)) else value


def _lines(settings: object, path: str) -> Iterator[str]:
    kind = type(settings)
    if selector(kind):
        yield f"{selector(kind)} = {_quoted(getattr(settings, selector(kind)))}"
    values = {one.name: getattr(settings, one.name) for one in fields(settings)}  # type: ignore[arg-type]
    for name, value in values.items():
        if value is None and rivals(_declared(kind, name)[0]):
            yield f"# [{_joined(path, name)}]  # {_declared(kind, name)[1].meaning}"
        elif not rivals(type(value)):
            text = f"# {name} =" if value is None else f"{name} = {_toml(_plain(value))}"
            yield f"{text}  # {_declared(kind, name)[1].meaning}"
    for name, value in values.items():
        if rivals(type(value)):
            meaning = _declared(kind, name)[1].meaning
            yield from ("", f"# {meaning}", f"[{_joined(path, name)}]")
            yield from _lines(value, _joined(path, name))


def _toml(value: object) -> str:
    return _quoted(value) if isinstance(value, str) else repr(value).lower()


def _quoted(text: str) -> str:
    # JSON's escapes are TOML's, except that TOML also wants DEL escaped.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _unknown(key: str, known: Mapping[str, object], table: Table, path: str) -> str:
    with_unit = [name for name in known if name.startswith(f"{key}_") and name not in table]
    if len(with_unit) == 1:
        return f"the unit is missing; write {_joined(path, with_unit[0])}"
    close = get_close_matches(key, known, n=1)
    if close:
        return f"unknown key; did you mean {_joined(path, close[0])}?"
    return f"unknown key; remove it (known here: {', '.join(known)})"


def _read(declared: tuple[Any, Key], field: str, table: Table, name: str, path: str) -> object:
    kind, key = declared
    tables = rivals(kind)
    if field not in table:
        what = f"add a [{path}] table" if tables else f"add {field} = ..."
        raise ValueError(f"{name}: {path} is missing; {what} ({key.meaning})")
    value = table[field]
    if tables:
        if not isinstance(value, Mapping):
            raise ValueError(
                f"{name}: {path}: {value!r} is no table; write [{path}] above its keys"
            )
        return read_table(_chosen(tables, value, name, path), value, name, path)
    return _checked(_typed(kind, value, name, path), key, name, path)


def _chosen(tables: tuple[type, ...], value: Table, name: str, path: str) -> type:
    key = selector(tables[0])
    if not key:
        return tables[0]
    names = {getattr(each, key): each for each in tables}
    choice = " or ".join(f'"{each}"' for each in names)
    if key not in value:
        raise ValueError(f"{name}: {path}.{key} is missing; write {key} = {choice}")
    if value[key] not in names:
        raise ValueError(f"{name}: {path}.{key}: {value[key]!r} is not known; write {choice}")
    return names[value[key]]


def _typed(kind: Any, value: object, name: str, path: str) -> object:  # noqa: ANN401
    wanted = next((each for each in get_args(kind) if each is not NoneType), kind)
    if isinstance(wanted, type) and issubclass(wanted, Enum):
        choices = [each.value for each in wanted]
        if value not in choices:
            listed = " or ".join(f'"{each}"' for each in choices)
            raise ValueError(f"{name}: {path}: {value!r} is not known; write {listed}")
        return wanted(value)
    if wanted is float and type(value) is int:
        return float(value)
    if type(value) is not wanted:
        example = {float: "a number such as 1.5", int: "a whole number such as 1"}
        remedy = example.get(wanted, 'a text in quotes such as "..."')
        raise ValueError(f"{name}: {path}: {value!r} is of the wrong type; write {remedy}")
    return value


def _checked(value: object, key: Key, name: str, path: str) -> object:
    if isinstance(value, str) and key.starts and not value.startswith(key.starts):
        starts = ", ".join(key.starts)
        raise ValueError(f"{name}: {path}: {value!r} is no address; begin it with one of {starts}")
    if isinstance(value, str) and key.parse is not None:
        try:
            key.parse(value)
        except ValueError as bad:
            raise ValueError(f"{name}: {path}: {bad}") from bad
    if isinstance(value, int | float) and not key.admits(value):
        raise ValueError(f"{name}: {path}: {value} is out of bounds; write {key.bounds}")
    return value
