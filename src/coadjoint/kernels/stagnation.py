"""When is a fixed point iteration done? When its corrections have stopped falling at the level of round-off."""

from __future__ import annotations

from typing import Any

from coadjoint.kernels.arithmetic import fma
from coadjoint.kernels.compiling import inlined

GO_ON, SETTLED, FAILED = 0, 1, 2
FIRST_TEST = 3  # early corrections may rise before they fall
MOST = 200
GROWTH = 2.0**64  # of the first correction: a correction so much larger will not come back
NOISE = 2.0**-32  # of the size of the stages: only below it is a correction that does not fall taken for round-off


@inlined
def restage(
    mix: Any, stages: int, low: int, high: int, n: int, base: Any, error: Any, slopes: Any, points: Any, work: Any
) -> tuple[float, float, bool]:
    """Set the points low to high - 1 to base + (error + sum_j mix_ij slope_j); each has n components.

    Returns the largest correction (NaN if anything is not finite), the largest component, and whether the correction of
    any component has fallen below all that it has been: components differ in size, and each is followed until it stops.
    """
    largest, size, spoilt, falling = 0.0, 0.0, 0.0, False
    for c in range(n):
        work.change[c] = 0.0
    for i in range(low, high):
        for c in range(n):
            total = error[c]
            for j in range(stages):
                total = fma(mix[i * stages + j], slopes[j * n + c], total)
            new = base[c] + total
            change = abs(new - points[i * n + c])
            points[i * n + c] = new
            spoilt += 0.0 * new
            work.change[c] = max(work.change[c], change)
            size = max(size, abs(new))
    for c in range(n):
        if work.change[c] < work.least[c]:
            work.least[c] = work.change[c]
            falling = True
        largest = max(largest, work.change[c])
    return largest + spoilt, size, falling


@inlined
def verdict(iteration: int, first: float, largest: float, size: float, falling: bool, quiet: int) -> tuple[int, int]:
    """Return whether to go on, and for how many iterations nothing has fallen: two in a row are the end.

    One alone can be chance: the corrections turn while they shrink where the iteration has complex eigenvalues.
    """
    if largest == 0.0:
        return SETTLED, 0
    if not (largest <= GROWTH * first and iteration < MOST):
        return FAILED, 0
    quiet = quiet + 1 if iteration > FIRST_TEST and not falling and largest <= NOISE * size else 0
    return (SETTLED if quiet == 2 else GO_ON), quiet
