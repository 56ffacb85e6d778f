"""The report: one HTML file that opens anywhere, with nothing beside it.

Pictures are in the file as base64, the style is inline, nothing is asked of a network and no
script runs: it can be mailed, archived and printed, and says the same in ten years.
"""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass
from enum import Enum
from html import escape
from pathlib import Path

_Value = str | int | float


class Severity(Enum):
    """How much a sentence of the verdict matters; the value is its mark in the report."""

    GOOD = "good"
    NOTE = "note"
    WARNING = "warning"
    FAILURE = "failure"


@dataclass(frozen=True, slots=True)
class Fact:
    """One number (or word) with its name and unit."""

    label: str
    value: _Value
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Finding:
    """One sentence on the result."""

    severity: Severity
    sentence: str


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A figure of the report; `alt` says in words what is seen, for who cannot see it."""

    png: bytes
    title: str
    caption: str
    alt: str = ""  # the title, where empty

    def __post_init__(self) -> None:
        if not self.png.startswith(b"\x89PNG\r\n\x1a\n"):
            raise ValueError(f"picture {self.title!r}: its bytes are not a PNG")


@dataclass(frozen=True, slots=True)
class MetricGroup:
    """Numbers that belong together, under one heading."""

    title: str
    facts: tuple[Fact, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Report:
    """Everything that a report says, in its order; the first picture leads."""

    title: str
    subtitle: str = ""
    headline: tuple[Fact, ...] = ()
    findings: tuple[Finding, ...] = ()
    pictures: tuple[Picture, ...] = ()
    left_out: tuple[str, ...] = ()  # paragraphs: what the method could not do, and where
    metrics: tuple[MetricGroup, ...] = ()
    provenance: tuple[tuple[str, str], ...] = ()


def write_report(path: Path, report: Report) -> None:
    """Write the report as one HTML file, UTF-8; an older file at `path` is replaced.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    path.write_text(report_html(report), encoding="utf-8")


def report_html(report: Report) -> str:
    """Return the whole page as text."""
    body = [_header(report), _pictures(report.pictures[:1], first=1)]
    body += [_left_out(report.left_out), _pictures(report.pictures[1:], first=2)]
    body += [_metrics(report.metrics), _provenance(report.provenance)]
    return _PAGE.format(
        title=escape(report.title), style=_STYLE, body="\n".join(part for part in body if part)
    )


def _header(report: Report) -> str:
    parts = ['<header><p class="kind">loftscan report</p>', f"<h1>{escape(report.title)}</h1>"]
    if report.subtitle:
        parts.append(f'<p class="subtitle">{escape(report.subtitle)}</p>')
    parts.append("</header>")
    if report.findings:
        items = "\n".join(_finding(finding) for finding in report.findings)
        parts.append(
            f'<section aria-label="Verdict"><ul class="findings">\n{items}\n</ul></section>'
        )
    if report.headline:
        facts = "\n".join(_headline(fact) for fact in report.headline)
        parts.append(
            f'<section aria-label="Key numbers"><dl class="facts">\n{facts}\n</dl></section>'
        )
    return "\n".join(parts)


def _finding(finding: Finding) -> str:
    mark, sentence = finding.severity.value, escape(finding.sentence)
    return f'<li class="{mark}"><b>{mark.capitalize()}</b> <span>{sentence}</span></li>'


def _headline(fact: Fact) -> str:
    return f"<div><dt>{escape(fact.label)}</dt><dd>{_quantity(fact)}</dd></div>"


def _quantity(fact: Fact) -> str:
    unit = f' <span class="unit">{escape(fact.unit)}</span>' if fact.unit else ""
    return f"{escape(_written(fact.value))}{unit}"


def _written(value: _Value) -> str:
    """Whole numbers in groups of three, others with four digits that count."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str):
        return value
    if isinstance(value, int):
        return f"{value:,}".replace(",", "\N{NARROW NO-BREAK SPACE}")
    if not math.isfinite(value):
        return "undefined"
    if abs(value) >= 10_000:
        return _written(round(value))
    return f"{value:.4g}".replace("-", "\N{MINUS SIGN}")


def _pictures(pictures: tuple[Picture, ...], *, first: int) -> str:
    return "\n".join(_figure(picture, number) for number, picture in enumerate(pictures, first))


def _figure(picture: Picture, number: int) -> str:
    data = base64.b64encode(picture.png).decode("ascii")
    alt = escape(picture.alt or picture.title)
    width, height = _png_size(picture.png)
    return (
        f'<figure id="figure-{number}">\n'
        f'<img src="data:image/png;base64,{data}" width="{width}" height="{height}" alt="{alt}">\n'
        f"<figcaption><b>Figure {number}. {escape(picture.title)}.</b> "
        f"{escape(picture.caption)}</figcaption>\n</figure>"
    )


def _png_size(png: bytes) -> tuple[int, int]:
    """Width and height from the header chunk (PNG specification, 11.2.2)."""
    return int.from_bytes(png[16:20], "big"), int.from_bytes(png[20:24], "big")


def _left_out(paragraphs: tuple[str, ...]) -> str:
    if not paragraphs:
        return ""
    text = "\n".join(f"<p>{escape(paragraph)}</p>" for paragraph in paragraphs)
    return f'<section class="left-out"><h2>What was left out</h2>\n{text}\n</section>'


def _metrics(groups: tuple[MetricGroup, ...]) -> str:
    if not groups:
        return ""
    rows = "\n".join(_metric_group(group) for group in groups)
    return f'<section><h2>Numbers</h2>\n<table class="metrics">\n{rows}\n</table></section>'


def _metric_group(group: MetricGroup) -> str:
    heading = f'<tr><th colspan="3" scope="rowgroup">{escape(group.title)}</th></tr>'
    rows = (
        f'<tr><th scope="row">{escape(fact.label)}</th><td class="number">'
        f"{escape(_written(fact.value))}</td><td>{escape(fact.unit)}</td></tr>"
        for fact in group.facts
    )
    return "<tbody>\n" + "\n".join([heading, *rows]) + "\n</tbody>"


def _provenance(entries: tuple[tuple[str, str], ...]) -> str:
    if not entries:
        return ""
    rows = "\n".join(
        f'<tr><th scope="row">{escape(name)}</th><td>{escape(text)}</td></tr>'
        for name, text in entries
    )
    return (
        "<section><h2>Where this comes from</h2>\n"
        f'<table class="provenance"><tbody>\n{rows}\n</tbody></table></section>'
    )


_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta name="generator" content="loftscan">
<title>{title}</title>
<style>
{style}
</style>
</head>
<body>
<main>
{body}
</main>
</body>
</html>
"""

_STYLE = """
:root {
  --paper: #fbfbfa; --card: #ffffff; --ink: #1d242b; --muted: #66707a; --rule: #e1e5e8;
  --good: #1a7f5a; --note: #2f6da3; --warning: #9a6200; --failure: #b3372b;
}
@media (prefers-color-scheme: dark) {
  :root {
    --paper: #14181c; --card: #1c2126; --ink: #e6e9ec; --muted: #98a2ab; --rule: #2d343b;
    --good: #57c39a; --note: #7fb4e0; --warning: #e0ad55; --failure: #ee8378;
  }
}
* { box-sizing: border-box; }
body {
  margin: 0; background: var(--paper); color: var(--ink);
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", "Noto Sans", "DejaVu Sans", sans-serif;
}
main { max-width: 60rem; margin: 0 auto; padding: 3.5rem 1.5rem 5rem; }
.kind {
  margin: 0 0 .4rem; color: var(--muted); font-size: .78rem; letter-spacing: .12em;
  text-transform: uppercase;
}
h1 { margin: 0; font-size: 2.1rem; font-weight: 600; line-height: 1.2; overflow-wrap: anywhere; }
h2 { margin: 3.2rem 0 1rem; font-size: 1.2rem; font-weight: 600; }
.subtitle { margin: .5rem 0 0; color: var(--muted); max-width: 44rem; }
.findings { list-style: none; margin: 2rem 0 0; padding: 0; }
.findings li {
  display: flex; gap: .9rem; padding: .5rem .9rem; margin: 0 0 .4rem;
  border-left: 3px solid var(--mark); background: var(--card);
}
.findings b { color: var(--mark); min-width: 5.2rem; font-weight: 600; }
.good { --mark: var(--good); } .note { --mark: var(--note); }
.warning { --mark: var(--warning); } .failure { --mark: var(--failure); }
.facts {
  display: grid; grid-template-columns: repeat(auto-fit, minmax(9.5rem, 1fr)); gap: 1.4rem 1.6rem;
  margin: 2rem 0 0; padding: 1.4rem 0; border: solid var(--rule); border-width: 1px 0;
}
.facts dt { color: var(--muted); font-size: .82rem; }
.facts dd {
  margin: .1rem 0 0; font-size: 1.5rem; line-height: 1.25; font-variant-numeric: tabular-nums;
}
.unit { color: var(--muted); font-size: .62em; }
figure { margin: 2.4rem 0 0; }
figure img {
  display: block; width: 100%; height: auto; background: #fff;
  border: 1px solid var(--rule); border-radius: 4px;
}
figcaption { margin: .7rem 0 0; color: var(--muted); font-size: .9rem; max-width: 46rem; }
figcaption b { color: var(--ink); font-weight: 600; }
.left-out p { max-width: 46rem; margin: 0 0 .8rem; }
table { width: 100%; border-collapse: collapse; font-size: .92rem; }
th { font-weight: 400; text-align: left; }
th, td {
  padding: .38rem .8rem .38rem 0; border-bottom: 1px solid var(--rule); vertical-align: top;
}
th[scope=rowgroup] { padding-top: 1.4rem; font-weight: 600; border-bottom-color: var(--muted); }
tbody:first-child th[scope=rowgroup] { padding-top: 0; }
.metrics th[scope=row] { width: 55%; }
.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
.metrics td:last-child { color: var(--muted); width: 22%; }
.provenance th { color: var(--muted); width: 30%; }
.provenance td {
  overflow-wrap: anywhere; font-family: ui-monospace, "DejaVu Sans Mono", monospace;
  font-size: .84rem;
}
@media (max-width: 36rem) {
  main { padding: 2rem 1rem 3rem; }
  h1 { font-size: 1.6rem; }
  .findings li { flex-direction: column; gap: 0; }
}
@page { size: A4; margin: 16mm 15mm; }
@media print {
  :root {
    --paper: #ffffff; --card: #ffffff; --ink: #000000; --muted: #555555; --rule: #cccccc;
    --good: #1a7f5a; --note: #2f6da3; --warning: #9a6200; --failure: #b3372b;
  }
  body { font-size: 10pt; }
  main { max-width: none; padding: 0; }
  figure, tr, .findings li, .facts div { break-inside: avoid; }
  figure img { width: auto; max-width: 100%; max-height: 110mm; margin: 0 auto; }
  h2 { break-after: avoid; }
}
""".strip()
