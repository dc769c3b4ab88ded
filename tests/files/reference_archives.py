"""Archives of each format version, interrupted halfway: `python files/reference_archives.py`, in the folder `tests`.

The script writes the archives of the current format; those of earlier formats are never written again.
"""

from __future__ import annotations

import sys
import tempfile
import zipfile
from pathlib import Path

import numpy as np

import coadjoint as co
from coadjoint.files.archives.reading import FORMAT
from coadjoint.files.archives.resume import archive_run
from coadjoint.runs.prepared_run import PreparedRun

FOLDER = Path(__file__).parent / "reference_archives"
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
"""Runs of sums, products, quotients and square roots alone: for vectors the bits do not depend on the machine."""


def write(folder: Path) -> None:
    """Write an archive of each run into a folder."""
    for name, (system, x0, method, options) in RUNS.items():
        ready = PreparedRun(system, method, STEP, **options)
        archive_run(ready, x0, SPAN, EVERY, folder / f"{name}.zarr", until=CUT)
    co.ensemble(BODY, RUNS["members"][1], SPAN, STEP, archive=folder / "blocks.zarr", members_per_block=2)


def main() -> int:
    target = FOLDER / f"format_{FORMAT}.zip"
    if target.exists():
        print(f"{target} exists; the archives of a format are written once")
        return 1
    target.parent.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archives:
        write(Path(folder))
        for file in sorted(path for path in Path(folder).rglob("*") if path.is_file()):
            archives.write(file, file.relative_to(folder))
    return 0


if __name__ == "__main__":
    sys.exit(main())
