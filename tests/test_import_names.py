"""Our import names are generic: no other distribution may ship them (decision 0001)."""

from __future__ import annotations

import importlib.util
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

OURS = "loftscan"
NAMES = ("reconstruction", "loftscan", "drivers", "acquisition", "sim")
TREE = Path(__file__).parents[1]


def rivals() -> dict[str, set[str]]:
    """Which other distributions ship one of our import names."""
    shipped = packages_distributions()
    others = {name: set(shipped.get(name, ())) - {OURS} for name in NAMES}
    return {name: of for name, of in others.items() if of}


def test_no_other_distribution_ships_our_import_names() -> None:
    assert rivals() == {}


@pytest.mark.parametrize("name", NAMES)
def test_a_rival_would_be_noticed(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    records = tmp_path / "rival-1.0.dist-info"
    records.mkdir()
    (records / "METADATA").write_text("Metadata-Version: 2.1\nName: rival\nVersion: 1.0\n")
    (records / "RECORD").write_text(f"{name}/__init__.py,,\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert rivals() == {name: {"rival"}}


@pytest.mark.parametrize("name", NAMES)
def test_the_names_lead_to_this_tree_or_nowhere(name: str) -> None:
    found = importlib.util.find_spec(name)
    if (TREE / name / "__init__.py").exists():
        assert found is not None
        assert found.origin is not None
        assert Path(found.origin).is_relative_to(TREE)
    else:
        assert found is None
