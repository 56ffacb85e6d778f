"""The report: whole in one file, safe to open, complete."""

from __future__ import annotations

import base64
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from loftscan.rendering import encode_png
from loftscan.report import (
    Fact,
    Finding,
    MetricGroup,
    Picture,
    Report,
    Severity,
    report_html,
    write_report,
)

EVIL = "<script>alert('part')</script>"
VOID = {"meta", "img"}


class Page(HTMLParser):
    """Tags, attributes and text of a page; a tag that is closed wrongly is an error."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.words: list[str] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


def pixels(level: int) -> bytes:
    return encode_png(np.full((4, 6, 3), level, np.uint8))


def full_report(name: str = "Cup") -> Report:
    return Report(
        title=name,
        subtitle=f"{name}, paper method",
        headline=(Fact("Points", 52_782), Fact("Residual, rms", 0.02314, "mm")),
        findings=tuple(Finding(severity, f"{name}: {severity.name}") for severity in Severity),
        pictures=tuple(Picture(pixels(k), f"{name} {k}", f"what {name} shows") for k in range(5)),
        left_out=(f"The handle of {name} is a second contour.",),
        metrics=(MetricGroup(f"Input {name}", (Fact(f"in {name}", name, name),)),),
        provenance=((f"file {name}", f"{name}.pcd"),),
    )


def test_a_report_holds_every_picture_with_number_size_and_words_for_it() -> None:
    page = Page(report_html(full_report()))
    images = page.all("img")
    data = [base64.b64decode(str(image["src"]).split(",", 1)[1]) for image in images]
    assert data == [pixels(k) for k in range(5)]
    assert [image["alt"] for image in images] == [f"Cup {k}" for k in range(5)]
    assert all((image["width"], image["height"]) == ("6", "4") for image in images)
    text = "".join(page.words)
    assert re.findall(r"Figure (\d)\. Cup", text) == ["1", "2", "3", "4", "5"]


def test_a_report_asks_nothing_of_a_network_and_runs_no_script() -> None:
    text = report_html(full_report())
    assert not re.search(r"https?://|//[a-z]|url\(|@import", re.sub(r"base64,[^\"]+", "", text))
    page = Page(text)
    assert not page.all("script")
    assert not page.all("link")
    assert all(str(image["src"]).startswith("data:image/png;base64,") for image in page.all("img"))


def test_text_of_others_stays_text_in_every_place() -> None:
    page = Page(report_html(full_report(EVIL)))
    assert not page.all("script")
    # title, h1, subtitle, findings, figures (twice each), left out, group, fact (3), provenance (2)
    assert "".join(page.words).count(EVIL) == 3 + len(Severity) + 10 + 1 + 4 + 2
    assert page.all("img")[0]["alt"] == f"{EVIL} 0"


def test_every_finding_says_its_severity_in_words() -> None:
    text = "".join(Page(report_html(full_report())).words)
    for severity in Severity:
        assert f"{severity.value.capitalize()} Cup: {severity.name}" in text


@pytest.mark.parametrize(
    ("value", "written"),
    [
        (52_782, "52\u202f782"),
        (0.0231441, "0.02314"),
        (-0.5, "\u22120.5"),
        (182_345.2, "182\u202f345"),
        (True, "yes"),
        (float("nan"), "undefined"),
        ("paper", "paper"),
    ],
)
def test_numbers_are_written_as_people_read_them(value: str | float, written: str) -> None:
    page = Page(report_html(Report("part", headline=(Fact("quantity", value),))))
    assert written in page.words


def test_a_report_of_nothing_but_a_title_is_a_whole_page() -> None:
    page = Page(report_html(Report("part")))
    assert {"html", "head", "title", "main", "header", "h1"} <= {tag for tag, _ in page.tags}
    assert not {"table", "figure", "dl", "ul", "h2"} & {tag for tag, _ in page.tags}


def test_a_report_follows_the_readers_light_and_prints_on_a4() -> None:
    text = report_html(Report("part"))
    assert "prefers-color-scheme: dark" in text
    assert "@media print" in text
    assert "size: A4" in text


def test_a_written_report_is_utf8_and_replaces_an_older_one(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text("old")
    write_report(path, full_report("Käse ± 0.1 mm"))
    assert path.read_bytes().decode("utf-8") == report_html(full_report("Käse ± 0.1 mm"))


def test_what_is_no_png_is_refused() -> None:
    with pytest.raises(ValueError, match="not a PNG"):
        Picture(b"GIF89a", "animation", "")
