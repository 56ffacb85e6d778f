"""The standard deviation of a fitted surface at 100 000 scattered places, on one core.

Run: ``python benchmarks/deviation.py [--repeats N]``. Process time, for the largest net that a
branch may have and a small one. The posterior is that of a net held by its stiffness and one
measurement a control point: what it says does not matter here, how large it is does.
"""

from __future__ import annotations

import argparse
import statistics
import time

import numpy as np

from reconstruction.nurbs import points_and_tangents_at
from reconstruction.skinning.assembly import (
    add_stiffness,
    empty_system,
    stiffness_rows,
    unknowns_of,
    variances_across,
)
from reconstruction.skinning.blocks import factorise, inverse_blocks
from reconstruction.skinning.net import Net, basis_at, knots_of, unit_normals

PLACES = 100_000


def tube(around: int, along: int) -> Net:
    """A tube of that many spans each way."""
    turn = np.arange(around) / around * 2 * np.pi
    control = np.empty((around, along + 3, 3))
    control[..., 0], control[..., 1] = 50 * np.cos(turn)[:, None], 50 * np.sin(turn)[:, None]
    control[..., 2] = np.linspace(0.0, 100.0, along + 3)
    return Net(
        control, knots_of(around, closed=True), knots_of(along, closed=False), closed_u=True,
        closed_v=False, apex=np.zeros(along + 3, np.bool_),
    )  # fmt: skip


def median_ms(net: Net, repeats: int) -> float:
    """Milliseconds for places at random, from parameters to deviations."""
    unknowns = unknowns_of(net, (None, None))
    system = empty_system(unknowns)
    for each in stiffness_rows(net, unknowns):
        add_stiffness(system, each, np.ones(len(each.values_mm)))
    for block in system[0].diagonal:
        block[np.diag_indices(len(block))] += 1.0
    factor = factorise(system[0])
    if factor is None:
        raise SystemExit("the system is not positive definite")
    inverse = inverse_blocks(factor)
    u, v = np.random.default_rng(0).random((2, PLACES)) * np.array(net.spans)[:, None]

    def deviations() -> np.ndarray:  # as Skin.deviation_mm, which needs a whole fit
        _, first_u, first_v = points_and_tangents_at(net.surface(), u, v)
        at = (
            basis_at(u, net.knots_u, 0, closed=net.closed_u),
            basis_at(v, net.knots_v, 0, closed=net.closed_v),
        )
        normals = unit_normals(first_u, first_v)
        return np.sqrt(variances_across(inverse, net, unknowns, at, normals))

    times = []
    for _ in range(repeats + 1):
        start = time.process_time()
        deviations()
        times.append(time.process_time() - start)
    return 1e3 * statistics.median(times[1:])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=7)
    repeats = parser.parse_args().repeats
    print(f"{PLACES} deviations; medians of {repeats}")
    for around, along in ((24, 12), (240, 160)):
        print(f"{around:4} x {along:3} spans{median_ms(tube(around, along), repeats):10.1f} ms")


if __name__ == "__main__":
    main()
