"""A result as a report: which pictures, which numbers, in which order."""

from __future__ import annotations

from pathlib import Path

from loftscan.branch_findings import tell_doubts
from loftscan.picturing import draw_pictures
from loftscan.report import Fact, Finding, MetricGroup, Report, Severity, write_report
from loftscan.result import Result
from loftscan.shape_findings import shape_tables, tell_shapes
from reconstruction.pipeline import Reconstruction


def write_result_report(path: Path, result: Result) -> None:
    """Write report.html of a result."""
    write_report(path, compose(result))


def compose(result: Result) -> Report:
    """Put a result into words, pictures and tables."""
    numbers = result.metrics
    return Report(
        title=result.name,
        subtitle=_subtitle(result),
        headline=(
            Fact("residual rms", _number(numbers["residual_rms_mm"]), "mm"),
            Fact("cloud width", _number(numbers["thickness_mm"]), "mm"),
            Fact("sections", _number(numbers["sections"])),
            Fact("bridged", 100.0 * _number(numbers["gap_fraction"]), "%"),
            Fact("volume", _number(numbers["volume_mm3"]) / 1000.0, "cm³"),
            Fact("watertight", "yes" if numbers["watertight"] else "no"),
        ),
        findings=_findings(result),
        pictures=draw_pictures(result),
        left_out=_explain_left_out(result),
        metrics=(*_tables(result), *shape_tables(result.reconstruction)),
        provenance=tuple((key, str(value)) for key, value in _flat(result.provenance)),
    )


def _number(value: object) -> float:
    return float(value) if isinstance(value, (int, float)) else float("nan")


def _subtitle(result: Result) -> str:
    settings = result.provenance["settings"]
    method = settings["method"] if isinstance(settings, dict) else ""
    points = f"{result.metrics['points_in']:,}".replace(",", "\u202f")
    return f"{points} points, method {method}; all lengths in mm"


def _findings(result: Result) -> tuple[Finding, ...]:
    sound = result.reconstruction.cleaned.after
    if sound.sound:
        drawn = isinstance(result.reconstruction, Reconstruction)
        ends = "; its two ends are flat caps" if drawn else ""
        state = f"The mesh is closed, manifold and oriented{ends}."
        findings = [Finding(Severity.GOOD, state)]
    elif _is_open_as_meant(result):
        state = (
            f"The mesh is an open surface of one piece, manifold and oriented, with"
            f" {sound.boundary_edges} edges on its border; it encloses nothing."
        )
        findings = [Finding(Severity.NOTE, state)]
    else:
        state = f"The mesh is no sound solid: {sound.boundary_edges} open edges."
        findings = [Finding(Severity.FAILURE, state)]
    verdict = result.deviation.verdict
    if verdict is not None:
        severity = Severity.GOOD if verdict.within else Severity.FAILURE
        sentence = (
            f"{verdict.share_within:.2%} of the points lie within {verdict.tolerance_mm:g} mm "
            f"of the mesh; {verdict.rule}."
        )
        findings.append(Finding(severity, sentence))
    told = tell_shapes(result.reconstruction)
    findings += [Finding(Severity.NOTE, sentence) for sentence in told]
    findings += [
        Finding(Severity.WARNING, f"{text[0].upper()}{text[1:]}.") for text in result.warnings
    ]
    return tuple(findings)


def _is_open_as_meant(result: Result) -> bool:
    """Whether a surface of open sections came out whole."""
    done = result.reconstruction
    if isinstance(done, Reconstruction) or not done.skinned.open:
        return False
    sound = done.cleaned.after
    whole = sound.manifold and sound.components == 1
    return whole and sound.misdirected_edges == 0 and sound.degenerate_faces == 0


def _explain_left_out(result: Result) -> tuple[str, ...]:
    done = result.reconstruction
    left_out, every = done.residual_all.count - done.residual.count, done.residual_all.count
    aside = ", ".join(
        f"{count} {reason.name.lower()}" for reason, count in result.cutting.aside.items() if count
    )
    doubts = () if isinstance(done, Reconstruction) else tuple(tell_doubts(done))
    return (
        f"{left_out} of {every} points in the sections ({left_out / max(1, every):.2%}) lie "
        f"farther than {done.REACH} from their section's curve. They are drawn in red and are in "
        "no residual but the one named so "
        f"(rms {done.residual_all.rms_mm:.3g} mm over all points).",
        f"Set aside before slicing: {aside or 'nothing'}.",
        "Caps are not measured: slices parallel to a flat end never sample it.",
        *doubts,
    )


# -- tables --------------------------------------------------------------------------------------

_SECTION_NAMES = "slices sections spacing patch control thickness radius cell gap contours"
_BRANCH_NAMES = "layout surface_open branches joints cavities surface_sigma mesh_tolerance"
_MESH_NAMES = "vertices faces watertight oriented manifold euler components volume area"
_GROUPS = {
    "Points": ("points_", "profiles"),
    "Sections": tuple(_SECTION_NAMES.split()),
    "Branches": tuple(_BRANCH_NAMES.split()),
    "Residuals": ("residual", "surface_deviation", "tolerance", "share_within", "within"),
    "Mesh": tuple(_MESH_NAMES.split()),
    "Effort": ("seconds", "peak", "lag", "slice_period"),
}
_UNITS = {"_mm": "mm", "_mm2": "mm²", "_mm3": "mm³", "_mb": "MB", "seconds": "s", "_s": "s"}


def _tables(result: Result) -> tuple[MetricGroup, ...]:
    facts = list(_flat(result.metrics))
    groups = [
        MetricGroup(
            title,
            tuple(_fact(key, value) for key, value in facts if key.startswith(prefixes)),
        )
        for title, prefixes in _GROUPS.items()
    ]
    return tuple(group for group in groups if group.facts)


def _fact(key: str, value: object) -> Fact:
    ending = next((ending for ending in _UNITS if key.endswith(ending)), "")
    label = key.removesuffix(ending) if ending.startswith("_") else key
    shown = value if isinstance(value, (str, int, float)) else "-" if value is None else str(value)
    return Fact(label.replace("_", " "), shown, _UNITS.get(ending, ""))


def _flat(content: dict[str, object], prefix: str = "") -> list[tuple[str, object]]:
    rows: list[tuple[str, object]] = []
    for key, value in content.items():
        name = f"{prefix}{key}"
        rows += _flat(value, f"{name} ") if isinstance(value, dict) else [(name, value)]
    return rows
