"""Numbers of a table that depend on parameters: found for many monomials at once as for each alone."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.program.provenance import Provenance, in_parts, monomials_of
from coadjoint.systems.parameters import parameters_of

SQUARE = {"lattice": "square", "shape": (4, 4), "periodic": True}
SYSTEMS = {
    "lattice": co.systems.spin_lattice(**SQUARE, tensor=(1.0, 1.0, 0.5), field=(0.0, 0.1, 0.2)),
    "bonds": co.systems.spin_lattice(**SQUARE, exchange=np.linspace(1.0, 2.0, 32), on_site=(0.0, 0.0, 0.5)),
    # A Casimir is subtracted.
    "rigid body": co.systems.rigid_body((1.0, 2.0, 3.0)),
    "heavy top": co.systems.heavy_top((1.0, 2.0, 2.5), lever=(0.1, 0.2, 0.3)),
    "polynomial": co.LiePoissonSystem(
        co.algebras.so(3), co.Polynomial({(2, 0, 0): 1.0, (1, 0, 0): 0.5, (3, 0, 0): 0.25, (0, 1, 0): 2.0})
    ),
}


def triplets(found):
    return sorted(zip(*(column.tolist() for column in found), strict=True))


@pytest.mark.parametrize("name", SYSTEMS)
def test_monomials_are_found_at_once_as_each_alone(name):
    system, compared = SYSTEMS[name], 0
    for parts in ("auto", "coordinates"):
        program = co.Splitting(order=2, parts=parts).program(system)
        provenance = Provenance(program)
        for parameter in parameters_of(system).values():
            G = parameter.energy()
            alone = [(one, provenance.changes(one.coordinates)) for one in monomials_of(G)]
            assert Provenance(program).changes_of([one.coordinates for one, _ in alone]) == [c for _, c in alone]
            found = in_parts(program, G)
            assert (found is None) == any(changes is None for _, changes in alone)
            if found is None:
                continue
            for kind, of_parts in zip(("coefficients", "shifts"), found, strict=True):
                expected = [
                    (number, one.entry, by * one.factor)
                    for one, changes in alone
                    for number, by in getattr(changes, kind)
                ]
                assert triplets(of_parts) == sorted(expected)
                compared += len(expected)
    assert compared
