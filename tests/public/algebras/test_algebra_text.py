"""The command lists the catalogue, and shows dimension, basis, brackets and Casimirs of an algebra."""

import pytest
from lie_algebras import known_casimirs

import coadjoint as co
from command import command
from refusals import refused

pytestmark = pytest.mark.thinned(1)


def rows_of(text):
    """The lines under each heading, those that are continued joined."""
    found = {}
    for line in text.splitlines()[1:]:
        assert len(line) <= 100
        heading, value = line[:14].strip(), line[14:]
        if heading:
            name, found[heading] = heading, [value]
        else:
            found[name].append(value)
    return found


def test_every_name_of_the_catalogue_is_listed(capsys):
    listed = command(capsys, "algebras")
    lines = listed.out.splitlines()
    assert listed.status == 0 and len(lines) == len(co.algebras.names())
    for name, line in zip(co.algebras.names(), lines, strict=True):
        head, about = line[:16].strip(), line[16:]
        assert head.partition("(")[0] == name.partition("(")[0]
        if about.startswith("a family"):
            example = about.rpartition(" ")[2]
            assert head == name and co.algebras.get(example).dim > 0
            alone = command(capsys, "algebras", name)
            assert alone.status == 2 and name in alone.err and example in alone.err
        else:
            needed = [key for key in head.partition("(")[2].rstrip(")").split(", ") if key and name != head]
            g = co.algebras.get(name, **dict.fromkeys(needed, 1)) if name not in ("A3_5", "A4_2") else None
            assert g is None or about.startswith(f"dimension {g.dim}")
    assert "A4_9(b)         dimension 4, -1 < b <= 1" in lines


@pytest.mark.parametrize(
    ("name", "parameters"),
    [("so(3)", {}), ("so(6)", {}), ("A4,8", {}), ("A4,7", {}), ("A5,23", {"b": 0.5}), ("sl(3)", {}), ("so(9)", {})],
)
def test_each_line_is_that_of_the_algebra(capsys, name, parameters):
    g = co.algebras.get(name, **parameters)
    shown = command(capsys, "algebras", name, *(f"{key}={value}" for key, value in parameters.items()))
    rows = rows_of(shown.out)
    assert shown.status == 0 and shown.out.splitlines()[0] == g.name and rows["dimension"] == [str(g.dim)]
    assert " ".join(rows["basis"]) == ", ".join(g.basis if g.dim <= 30 else (*g.basis[:3], "...", g.basis[-1]))
    lines = rows["brackets"]
    if lines[-1].startswith("and"):
        assert lines.pop().endswith("more") and len(lines) == 20
        known = {line.strip() for line in str(g).splitlines()[1:]}
        assert set(lines) <= known
    else:
        assert co.LieAlgebra.from_brackets(g.dim, lines, basis=g.basis) == g
    casimirs = " ".join(rows["casimirs"])
    for key, value in known_casimirs(g).items():
        assert key in casimirs and (len(str(value)) > 200 or str(value) in casimirs)
    assert known_casimirs(g) or "no Casimir" in casimirs
    size = "none is known" if g.representation is None else f"{g.representation.shape[1]} x "
    assert rows["matrices"][0].startswith(size)
    assert list(rows) == ["dimension", "basis", "brackets", "casimirs", "matrices"]


def test_names_of_the_basis_are_read():
    with refused(ValueError, "basis"):
        co.LieAlgebra([], dim=2, basis=("a", "a"))
