"""Few parts: on every catalogue algebra at most as many as sets of commuting coordinates are known to cover it."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.algebra.families.low_dimensional import entries
from coadjoint.program.parts.decompose import decompose
from coadjoint.program.parts.split import split
from verification.test_catalogue import EXAMPLES

# Numbers of sets of commuting coordinates; two elsewhere.
THREE = """A3_8 A3_9 A4_7 A4_8 A4_9 A4_10 A4_11 A5_3 A5_6 A5_19 A5_20 A5_21 A5_23 A5_24 A5_25 A5_26 A5_28 A5_29 A5_30
A5_31 A5_36 A5_37 A5_39 A5_40""".split()


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", entries())
def test_as_few_parts_as_commuting_sets_that_cover_the_coordinates(name):
    count, algebra = 3 if name in THREE else 2, co.algebras.get(name, **EXAMPLES.get(name, {}))
    system = co.LiePoissonSystem(algebra, co.Quadratic(np.linspace(1.0, 2.0, algebra.dim)))
    parts = split(system, "auto")
    assert len(parts) <= count
    assert len(decompose(system, "auto").parts) <= len(parts)
    covered = sorted(i for part in parts for form, _ in part.forms for i in form)
    assert covered == list(range(algebra.dim))
    for part in parts:
        chosen = [i for form, _ in part.forms for i in form]
        assert all(algebra.commuting(i, j) for i in chosen for j in chosen)
