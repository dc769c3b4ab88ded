"""Archives of each version of the format, cut in the middle: `python files/kept_archives.py`, in the tests' folder.

That writes those of the present version, once for each version; those of earlier ones stay as they are.
"""

from __future__ import annotations

import sys
import tempfile
import zipfile
from pathlib import Path

import numpy as np

import coadjoint as co
from coadjoint.files.archives.resume import archive_run
from coadjoint.files.archives.store import FORMAT
from coadjoint.runs.prepared_run import PreparedRun

KEPT = Path(__file__).parent / "kept_archives"
SPAN, STEP, CUT, EVERY = (0.0, 4.0), 0.125, 13, 2
BODY, X = co.systems.rigid_body(inertia=(1, 2, 2.5)), np.array([0.25, -1.0, 0.75])
FLUID = co.systems.sphere_euler(4)
W = np.diag([0.75j, 0.25j, -0.5j, -0.5j]) + 0.125 * (np.eye(4, k=1) - np.eye(4, k=-1))
RUNS = {
    "vector": (BODY, X, co.GaussLegendre(2), {"attitude": "coadjoint"}),
    "members": (BODY, np.multiply.outer([1.0, 0.5, 0.25], X), co.Splitting(order=4), {}),
    "matrix": (FLUID, W, co.IsospectralGauss(1), {}),
    "damped": (BODY.with_forces(co.forces.LinearDamping(0.125)), X, co.GaussLegendre(1), {}),
}
"""Runs by sums, products, quotients and square roots alone: of vectors, so that the bits are those of any machine."""


def write(folder: Path) -> None:
    """Write an archive of each run into a folder."""
    for name, (system, x0, method, options) in RUNS.items():
        ready = PreparedRun(system, method, STEP, **options)
        archive_run(ready, x0, SPAN, EVERY, folder / f"{name}.zarr", until=CUT)
    co.ensemble(BODY, RUNS["members"][1], SPAN, STEP, archive=folder / "blocks.zarr", members_per_block=2)


def main() -> int:
    target = KEPT / f"format_{FORMAT}.zip"
    if target.exists():
        print(f"{target} exists; archives of a version are written once")
        return 1
    target.parent.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as kept:
        write(Path(folder))
        for file in sorted(path for path in Path(folder).rglob("*") if path.is_file()):
            kept.write(file, file.relative_to(folder))
    return 0


if __name__ == "__main__":
    sys.exit(main())
