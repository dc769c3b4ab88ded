"""Descriptions of algebras and of the catalogue as text, line by line against the algebra."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.algebra import catalogue
from coadjoint.algebra.algebra_summary import algebra_of, algebra_text, listed_algebras
from coadjoint.algebra.families.low_dimensional import entries


def rows_of(text):
    """Return the lines under each heading, those that are continued joined."""
    found = {}
    for line in text.splitlines()[1:]:
        assert len(line) <= 100
        heading, value = line[:14].strip(), line[14:]
        if heading:
            name, found[heading] = heading, [value]
        else:
            found[name].append(value)
    return found


def test_every_name_of_the_catalogue_is_listed_with_what_it_needs():
    lines = listed_algebras()
    assert len(lines) == len(catalogue.names())
    for name, line in zip(catalogue.names(), lines, strict=True):
        head, about = line[:16].strip(), line[16:]
        entry = entries().get(name)
        if entry is not None:
            parameters = entry.get("parameters", [])
            assert head == (f"{name}({', '.join(parameters)})" if parameters else name)
            wanted = [f"dimension {entry['dim']}", entry.get("range"), entry.get("note")]
            assert about == ", ".join(part for part in wanted if part)
        elif name in catalogue.families():
            assert head == name and about.startswith("a family; give the numbers, such as ")
            example = about.removeprefix("a family; give the numbers, such as ")
            assert catalogue.get(example).dim > 0 and example.split("(")[0] == name.split("(")[0]
            with pytest.raises(ValueError, match="is a family; give its numbers, such as") as refused:
                algebra_of(name, {})
            assert str(refused.value) == f"{name} is a family; give its numbers, such as {example}"
            numbers = {key: 3 for key in catalogue.families()[name]}
            assert algebra_of(name, numbers) == catalogue.get(name, **numbers)
        else:
            assert head == name and about == f"dimension {catalogue.get(name).dim}"


@pytest.mark.parametrize(
    "g",
    [
        catalogue.so(3),
        catalogue.so(6),
        catalogue.get("A4,8"),
        catalogue.get("A5,23", b=0.5),
        catalogue.sl(3),
        catalogue.so(9),
        co.LieAlgebra([(0, 1, 1, 2.0)], dim=3, basis=("a", "b", "c")),
        co.LieAlgebra([(0, 1, 1, 1.0), (0, 2, 2, np.sqrt(2.0))], dim=3),
        co.LieAlgebra([], dim=2, name="still"),
        co.LieAlgebra([(0, 1, 1, 1.0)], dim=17),
        co.LieAlgebra([(0, 1, 1, 1.0)], dim=2, casimirs={"own": co.Polynomial({(1, 0): 1})}),
    ],
    ids=repr,
)
def test_each_line_is_that_of_the_algebra(g):
    text = algebra_text(g)
    rows = rows_of(text)
    assert text.splitlines()[0] == (g.name or "a Lie algebra") and rows["dimension"] == [str(g.dim)]
    listed = g.basis if g.dim <= 30 else (*g.basis[:3], "...", g.basis[-1])
    assert " ".join(rows["basis"]) == ", ".join(listed)
    count = len(set(zip(g.triples.i.tolist(), g.triples.j.tolist(), strict=True)))
    lines = rows["brackets"]
    if count > 20:
        assert lines.pop() == f"and {count - 20} more"
        x = np.eye(g.dim)
        for line in lines:
            (i, j), right = (g.basis.index(part.strip(" []")) for part in line.split("=")[0].split(",")), line
            (only,) = co.LieAlgebra.from_brackets(g.dim, [right], basis=g.basis).bracket(x[i], x[j]).nonzero()
            assert np.array_equal(only, g.bracket(x[i], x[j]).nonzero()[0])
        assert len(lines) == 20
    elif count and all(c == float(f"{c:.6g}") for c in g.triples.c):
        assert co.LieAlgebra.from_brackets(g.dim, lines, basis=g.basis) == g and len(lines) == count
    elif not count:
        assert lines == ["none but zero"]
    casimirs = " ".join(rows["casimirs"])
    known = g.casimirs_known
    if known:
        for name, value in known.items():
            assert name in casimirs and (len(str(value)) > 200 or str(value) in casimirs)
    elif g.dim > 16:
        assert casimirs == "not computed here, since there are 17 coordinates; call casimirs() of the algebra"
    elif g.casimirs():
        assert casimirs == " ".join(f"{name} = {value}" for name, value in g.casimirs().items())
    else:
        assert casimirs.startswith("no polynomial up to degree 4; of Casimirs of any kind there ")
    rho = g.representation
    matrices = "none is known; use the coadjoint representation" if rho is None else f"{rho.shape[1]} x {rho.shape[1]}"
    assert rows["matrices"] == [matrices] and list(rows) == ["dimension", "basis", "brackets", "casimirs", "matrices"]
