"""What is kept on disk is used again, and thrown away when anything that was inlined has changed."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import coadjoint as co

RUN = """
import coadjoint as co
sol = co.integrate(co.systems.rigid_body((1, 2, 3)), (0.8, 0.5, 0.6), (0, 0.5), 0.5, watch=False)
from coadjoint.kernels import flow
print(sol.x[-1, 0].hex(), sum(flow.advance.stats.cache_hits.values()), sum(flow.advance.stats.cache_misses.values()))
"""


def run_in(folder):
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    environment.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run([sys.executable, "-c", RUN], env=environment, capture_output=True, text=True, check=True)
    state, hits, misses = done.stdout.split()
    return float.fromhex(state), int(hits), int(misses)


def test_an_edited_kernel_is_compiled_again(tmp_path):
    """The sine's second coefficient -1/6 becomes -1/3: an inlined function, in another file than the loop."""
    package = Path(co.__file__).parent
    shutil.copytree(package, tmp_path / "coadjoint", ignore=shutil.ignore_patterns("*.nbc", "*.nbi", "*.pyc"))
    first, hits, misses = run_in(tmp_path)
    assert (hits, misses) == (0, 1)
    assert run_in(tmp_path) == (first, 1, 0)

    source = tmp_path / "coadjoint" / "kernels" / "arithmetic.py"
    text = source.read_text(encoding="utf-8")
    assert text.count("-1.66666666666666324348e-01") == 1
    source.write_text(text.replace("-1.66666666666666324348e-01", "-3.33333333333333333333e-01"), encoding="utf-8")
    changed, hits, misses = run_in(tmp_path)
    assert (hits, misses) == (0, 1)
    assert abs(changed - first) > 1e-6  # far above rounding
