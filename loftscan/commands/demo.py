"""``loftscan demo``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loftscan.commands.options import Debug, JsonLines, Overwrite
from loftscan.commands.outcome import save, tell, writable_formats
from loftscan.commands.running import fail, run

if TYPE_CHECKING:
    from loftscan.cad_files import CadWriter
    from loftscan.demo import Scanning
    from loftscan.result import Result


def demo(
    part: Annotated[
        str,
        typer.Option(help="cylinder, cone, vase, badly-acquired, blade, or a mesh file in mm."),
    ] = "vase",
    out: Annotated[
        Path, typer.Option(help="Folder for the result; the scan goes beside it, to OUT.scan.")
    ] = Path("demo-out"),
    seed: Annotated[int, typer.Option(help="Of the noise.", min=0)] = 20,
    scale: Annotated[
        float, typer.Option(help="How much faster than real time the station moves.", min=0.01)
    ] = 10.0,
    rings: Annotated[int, typer.Option(help="Slices to scan, foot to top.", min=2)] = 40,
    overwrite: Overwrite = False,
    json_lines: JsonLines = False,
    debug: Debug = False,
) -> None:
    """Scan a simulated part, reconstruct it meanwhile, judge it.

    The station is simulated on real wires; the scan goes beside the result, to OUT.scan.
    """

    def work() -> None:
        from loftscan.cad_files import CadWriter
        from loftscan.demo import ScanFailed, check_scan_folder, judge, scanning
        from loftscan.result import check_output
        from loftscan.simulation import simulate

        wanted = writable_formats(None)
        kept = out.with_name(f"{out.name}.scan")
        check_output(out, overwrite=overwrite)
        check_scan_folder(kept, overwrite=overwrite)
        try:
            if not json_lines:
                print(f"scanning {part} on a simulated station, into {kept}", flush=True)
            with (
                CadWriter(wanted) as cad,
                simulate(part, seed=seed, scale=scale, rings=rings) as station,
                scanning(station, kept) as scan,
            ):
                result = _followed(
                    scan, out, wanted, cad, overwrite=overwrite, json_lines=json_lines
                )
            told = judge(part, out / "mesh.stl")
        except ScanFailed as failed:
            fail(failed.code, str(failed))
        except KeyboardInterrupt:
            if not (kept / "scan.json").exists():
                raise
            fail(3, f"stopped by the operator; the slices so far are kept in {kept}")
        tell(result, out, json_lines=json_lines)
        _tell_truth(told, result, json_lines=json_lines)

    run(work, debug=debug)


def _followed(
    scan: Scanning,
    out: Path,
    formats: tuple[str, ...],
    cad: CadWriter,
    *,
    overwrite: bool,
    json_lines: bool,
) -> Result:
    """Fit every slice as it appears, and save the result."""
    from loftscan.demo import SupervisedScan
    from loftscan.following import FollowedScan
    from loftscan.interruption import interruptible
    from loftscan.reconstructing import Settings
    from loftscan.streaming import finish, stream
    from loftscan.warming import warm_up
    from loftscan.watching import watching

    with interruptible() as interruption, watching(json_lines=json_lines) as watch:
        pause, progress = interruption.pausing(scan.pause), interruption.heeding(watch.step)
        coming = SupervisedScan(FollowedScan(scan.folder, pause=pause), scan)
        updates = stream(coming, Settings(), progress=progress, prepare=warm_up)
        result = finish(watch.passing(updates))
        save(result, out, formats, cad, progress, overwrite=overwrite, json_lines=json_lines)
    return result


def _tell_truth(told: dict[str, float], result: Result, *, json_lines: bool) -> None:
    """Say how far the walls lie from the true part, and how far the fitting lagged behind."""
    lag_s, period_s = (
        result.metrics.get(name) for name in ("lag_median_s", "slice_period_median_s")
    )
    if json_lines:
        print(json.dumps({"event": "truth", **told}))
        print(json.dumps({"event": "lag", "median_s": lag_s, "slice_period_s": period_s}))
        return
    print(
        f"truth, by the simulator: the walls lie {told['rms_mm']:.3f} mm rms from the part"
        f" ({told['mean_mm']:+.3f} mm on average, 95 % within {told['percentile_95_mm']:.3f} mm,"
        f" all within {told['max_mm']:.3f} mm; {told['points']} points, caps left out)"
    )
    if isinstance(lag_s, float) and isinstance(period_s, float):
        print(f"live: a section {lag_s:.2f} s after its slice; a slice every {period_s:.2f} s")
