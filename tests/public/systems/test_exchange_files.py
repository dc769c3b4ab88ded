"""Exchange constants from files: TB2J, VAMPIRE and tables give the energies that the codes define."""

import importlib.util
import itertools

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

pytestmark = [
    pytest.mark.skipif(importlib.util.find_spec(name) is None, reason=f"{name} is not installed")
    for name in ("gemmi", "spglib")
]

LATTICE = np.array([[3.0, 0.0, 0.0], [-0.5, 4.0, 0.0], [0.2, 0.3, 5.0]])
PLACES = {"O1": (0.3, 0.3, 0.3), "Fe1": (0.0, 0.0, 0.0), "Ni1": (1.5, 0.5, -0.25)}  # of a file, one outside of the cell
CRYSTAL = co.spins.crystal(lattice=LATTICE, sites={"Ni": (0.5, 0.5, 0.75), "Fe": (0.0, 0.0, 0.0)}, space_group="P 1")
LINE = "-" * 88
MEV = 1.602176634e-22  # in joules


def constants():
    """Return isotropic, antisymmetric and symmetric parts of random bonds, in both directions, in meV."""
    rng, found = np.random.default_rng(4), {}
    for i, j, R in (
        ("Fe1", "Fe1", (1, 0, 0)),
        ("Fe1", "Ni1", (0, 0, 1)),
        ("Ni1", "Fe1", (2, 0, -1)),
        ("Ni1", "Ni1", (0, 1, 0)),
    ):
        J, D, A = np.round(rng.normal(), 4), np.round(rng.normal(size=3), 4), np.round(rng.normal(size=(3, 3)), 3)
        A = A + A.T
        found[i, j, R] = J, D, A
        found[j, i, tuple(-n for n in R)] = J, -D, A
    return found


def matrix(J, D, A):
    return J * np.eye(3) + np.array([[0, D[2], -D[1]], [-D[2], 0, D[0]], [D[1], -D[0], 0]]) + A


def tb2j(path, bonds, lattice=LATTICE, extra=""):
    rows = [f"{'  '.join(f'{v:10.8f}' for v in vector)}" for vector in lattice]
    atoms = [
        f"{a:<12s} {' '.join(f'{v:13.8f}' for v in np.array(p) @ LATTICE)} {1:9.4f} {2:9.4f}" for a, p in PLACES.items()
    ]
    text = [
        "=" * 90,
        "Information: ",
        "Cell (Angstrom):",
        *rows,
        "",
        "=" * 90,
        "Atoms:  ",
        "(Note: charge and magmoms)",
    ]
    text += [
        "Atom number        x             y             z       w_charge  w_magmom",
        *atoms,
        "Total   3.0 6.0",
        extra,
    ]
    text += ["=" * 90, "Exchange: ", "    i      j          R        J_iso(meV)          vector          distance(A)"]
    for (i, j, R), (J, D, A) in bonds.items():
        vector = (np.array(PLACES[j]) + R - PLACES[i]) @ LATTICE
        shown, length = ", ".join(f"{v:6.3f}" for v in vector), np.linalg.norm(vector)
        ends = f"   {i:5s} {j:5s} ({R[0]:3d}, {R[1]:3d}, {R[2]:3d})"
        text += [LINE, f"{ends} {J:7.4f}   ({shown}) {length:6.3f} "]
        text += [f"J_iso: {J:7.4f} ", "[Testing!] DMI: ({:7.4f} {:7.4f} {:7.4f})".format(*D)]
        text += ["[Testing!]J_ani:", np.array_str(A, precision=3, suppress_small=True)]
        text += ["Combined J tensor (meV) [J = Jiso*I + DMI_antisymmetric + Jani_symmetric]:"]
        text += [np.array_str(matrix(J, D, A), precision=3, suppress_small=True)]
    path.write_text("\n".join(text) + "\n")
    return path


def ucf(path, bonds, kind="tensorial", vectors=None):
    sizes = np.linalg.norm(LATTICE, axis=1)
    names = [name for name in PLACES if name != "O1"]
    text = ["# Unit cell size (Angstrom):", " ".join(map(repr, sizes.tolist())), "# Unit cell lattice vectors:"]
    text += [" ".join(map(repr, row)) for row in (LATTICE / sizes[:, None] if vectors is None else vectors).tolist()]
    text += ["# Atoms", "2 2", *(f"{k} {' '.join(map(str, PLACES[name]))} {k}" for k, name in enumerate(names))]
    text += ["# Interactions", f"{len(bonds)} {kind}"]
    for number, ((i, j, R), parts) in enumerate(bonds.items()):
        J = 2.0 * MEV * matrix(*parts)
        values = J.ravel() if kind == "tensorial" else np.diag(J) if kind == "vectorial" else J[:1, 0]
        text.append(
            f"{number} {names.index(i)} {names.index(j)} {R[0]} {R[1]} {R[2]} " + " ".join(map(repr, values.tolist()))
        )
    path.write_text("\n".join(text) + "\n")
    return path


def energy_of(bonds, model, x):
    """Return -sum of e_i . J e_j over both directions, of an open lattice, from the positions of the atoms."""
    e, place = x.reshape(-1, 3), {tuple(np.round(p, 6)): k for k, p in enumerate(model.positions)}
    total = 0.0
    for k, p in enumerate(model.positions):
        for (i, j, R), parts in bonds.items():
            step = (np.array(PLACES[j]) + R - PLACES[i]) @ LATTICE
            here = (np.linalg.solve(LATTICE.T, p) - PLACES[i] + 1e-9) % 1.0
            other = place.get(tuple(np.round(p + step, 6)))
            if np.all(here < 1e-6) and other is not None:
                total -= e[k] @ matrix(*parts) @ e[other]
    return total


def test_formats_have_the_energies_of_their_codes(tmp_path):
    bonds = constants()
    model = co.systems.spins(CRYSTAL, (3, 2, 3), moments={"Fe": 2.2, "Ni": 0.6}, units="meV", periodic=False)
    x = np.random.default_rng(1).normal(size=model.dim)
    wanted = energy_of(bonds, model, x)
    table = co.spins.read_exchange(tb2j(tmp_path / "exchange.out", bonds), CRYSTAL)
    assert len(table.sites) == 4 and table.units == "meV" and table.of_directions
    np.testing.assert_allclose(model.exchange(table).energy(x), wanted, rtol=1e-12)
    other = co.spins.read_exchange(ucf(tmp_path / "vampire.UCF", bonds), CRYSTAL)
    np.testing.assert_allclose(model.exchange(other).energy(x), wanted, rtol=1e-12)
    # A table in the convention of the model: once, with S_i S_j.
    S = model.spin[:2]
    rows = ["i,j,n1,n2,n3," + ",".join(f"J{a}{b} [meV]" for a in "xyz" for b in "xyz")]
    for (i, j), n, J in zip(table.sites, table.offsets, table.matrices, strict=True):
        rows.append(",".join(map(repr, [int(i), int(j), *n.tolist(), *(J / (S[i] * S[j])).ravel().tolist()])))
    (tmp_path / "bonds.csv").write_text("\n".join(rows))
    last = co.spins.read_exchange(tmp_path / "bonds.csv", CRYSTAL)
    np.testing.assert_allclose(model.exchange(last).energy(x), wanted, rtol=1e-12)
    text = (tmp_path / "exchange.out").read_text().replace("[Testing!]", "[Experimental!]")  # of other versions
    (tmp_path / "older.out").write_text(text)
    older = co.spins.read_exchange(tmp_path / "older.out", CRYSTAL)
    np.testing.assert_array_equal(older.matrices, table.matrices)
    near = co.spins.read_exchange(tmp_path / "exchange.out", CRYSTAL, max_distance=3.5)
    assert 0 < len(near.sites) < 4


@pytest.mark.parametrize("kind", ["isotropic", "vectorial", "0", "1"])
def test_types_of_exchange_of_vampire(tmp_path, kind):
    bonds = {
        key: (J, np.zeros(3), np.diag(np.arange(3.0) * (kind in ("vectorial", "1"))))
        for key, (J, _, _) in constants().items()
    }
    plain = {"0": "isotropic", "1": "vectorial"}.get(kind, kind)
    text = ucf(tmp_path / "a.ucf", bonds, plain).read_text()
    (tmp_path / "a.ucf").write_text(text.replace(plain, kind))
    model = co.systems.spins(CRYSTAL, (3, 2, 3), spin=2, units="meV", periodic=False)
    x = np.random.default_rng(1).normal(size=model.dim)
    table = co.spins.read_exchange(tmp_path / "a.ucf", CRYSTAL)
    np.testing.assert_allclose(model.exchange(table).energy(x), energy_of(bonds, model, x), rtol=1e-12)


def test_dzyaloshinskii_moriya_in_a_table(tmp_path):
    (tmp_path / "a.csv").write_text("i;j;n1;n2;n3;J;Dx;Dy;Dz\n0;1;0;0;0;0,5;0,1;0,2;0,3\n".replace(",", "."))
    model = co.systems.spins(CRYSTAL, (1, 1, 1), spin={"Fe": 2, "Ni": 3}, periodic=False)
    model = model.exchange(co.spins.read_exchange(tmp_path / "a.csv", CRYSTAL))
    a, b = np.eye(3)[0], np.array([0.0, 0.6, 0.8])
    assert np.isclose(model.energy([*a, *b]), 6 * (0.5 * a @ b + [0.1, 0.2, 0.3] @ np.cross(a, b)), rtol=1e-14)


def changed(text, old, new):
    assert old in text
    return text.replace(old, new, 1)


def test_what_is_refused(tmp_path):
    bonds, path = constants(), tmp_path / "exchange.out"

    def read(text, *words, crystal=CRYSTAL, name="exchange.out", error=ValueError, **others):
        (tmp_path / name).write_text(text)
        with refused(error, *words):
            co.spins.read_exchange(tmp_path / name, crystal, **others)

    text = tb2j(path, bonds).read_text()
    read(tb2j(path, bonds, LATTICE * 1.01).read_text(), "lattice vectors", "crystal")
    turned = co.spins.crystal(lattice=(3.0, 4.03, 5.01, 90, 90, 97.1), sites={"Fe": (0, 0, 0)}, space_group="P 1")
    read(text, "lattice vectors", crystal=turned)
    more = co.spins.crystal(lattice=LATTICE, sites={"Fe": [(0, 0, 0), (0.5, 0, 0)]}, space_group="P 1")
    read(text, "no atom", "0.5", crystal=more)
    iron = co.spins.crystal(lattice=LATTICE, sites={"Fe": (0, 0, 0)}, space_group="P 1")
    read(text, "Ni1", "magnetic sites", crystal=iron)
    one_way = {key: parts for k, (key, parts) in enumerate(bonds.items()) if k != 3}
    read(tb2j(path, one_way).read_text(), "one direction")
    read(
        tb2j(path, bonds | {("Ni1", "Fe1", (0, 0, -1)): (5.0, np.zeros(3), np.zeros((3, 3)))}).read_text(), "different"
    )
    read(text + f"{LINE}\n" + text[text.index("   Fe1   Fe1") : text.index("Combined")], "twice")
    read(tb2j(path, bonds, extra="Single Ion Anisotropy (meV): ").read_text(), "single-ion")
    read(text + "[Testing!] Jprime: 0.1,  B: 0.2\n", "biquadratic")
    read("nothing", "TB2J", "sections")
    read(text, "name", name="exchange.txt")
    read(text, "csv", format="xml")
    with refused(TypeError, "crystal"):
        co.spins.read_exchange(path, LATTICE)
    text = ucf(tmp_path / "a.ucf", bonds).read_text()
    read(changed(text, "tensorial", "normalised-tensorial"), "normalised", name="a.ucf")
    read(changed(text, f"{len(bonds)} tensorial", f"{10**12} tensorial"), "interactions", name="a.ucf")
    read(changed(text, f"{len(bonds)} tensorial", "6 tensorial"), "after", "biquadratic", name="a.ucf")
    read(changed(text, f"{len(bonds)} tensorial", "9 tensorial"), "interaction", name="a.ucf")
    read(ucf(tmp_path / "a.ucf", bonds, vectors=LATTICE).read_text(), "lattice vectors", name="a.ucf")
    read("# nothing", "size of the cell", name="a.ucf")
    head = "i,j,n1,n2,n3,J\n"
    read(head + "0,0,1,0,0,1\n0,0,-1,0,0,1\n", "both directions", name="a.csv")
    read(head + "0,0,1,0,0,1\n0,0,1,0,0,1\n", "twice", name="a.csv")
    read(head + "0,0,0,0,0,1\n", "itself", name="a.csv")
    read(head + "0,2,1,0,0,1\n", "site 2", name="a.csv")
    read(head + "0,0.5,1,0,0,1\n", "line 2", "whole", name="a.csv")
    read(head + "0,0,1,0,0,nan\n", "line 2", "finite", name="a.csv")
    read(head + "0,0,1,0,0,x\n", "line 2", name="a.csv")
    read(head.replace("J", "J [K]") + "0,0,1,0,0,1\n", "meV", name="a.csv")
    read(head.replace("J", "K") + "0,0,1,0,0,1\n", "columns", name="a.csv")


def test_tables_and_models_that_do_not_fit(tmp_path):
    (tmp_path / "a.csv").write_text("i,j,n1,n2,n3,J\n0,0,1,0,0,1\n")
    table = co.spins.read_exchange(tmp_path / "a.csv", CRYSTAL)
    model = co.systems.spins(CRYSTAL, (3, 3, 3), periodic=False)
    with refused(ValueError, "natural", "meV"):
        co.systems.spins(CRYSTAL, (3, 3, 3), units="meV").exchange(table)
    with refused(ValueError, "J is"):
        model.exchange(table, 1.0)
    with refused(ValueError, "exchange"):
        model.exchange(table).exchange(table)
    bond = next(b for b in CRYSTAL.bonds(3.1) if b.first == b.second == 0)
    (tmp_path / "back.csv").write_text("i,j,n1,n2,n3,J\n0,0,-1,0,0,1\n")
    for one in (table, co.spins.read_exchange(tmp_path / "back.csv", CRYSTAL)):  # from either end of the bond
        with refused(ValueError, "file", "once"):
            model.exchange(one).exchange(bond, 1.0)
    added = model.exchange(table).dzyaloshinskii_moriya(bond, (0, 0, 1.0))
    assert added.energy(np.tile([0.0, 0, 1], 54)) == model.exchange(table).energy(np.tile([0.0, 0, 1], 54))
    bond = next(b for b in CRYSTAL.bonds(6) if b.first != b.second)
    J, back = np.arange(9.0).reshape(3, 3), [bond.second, bond.first, *(-n for n in bond.offset)]
    names = "i,j,n1,n2,n3," + ",".join(f"J{a}{b}" for a in "xyz" for b in "xyz")
    (tmp_path / "b.csv").write_text(f"{names}\n{','.join(map(repr, [*map(int, back), *J.T.ravel().tolist()]))}\n")
    reverse = model.exchange(co.spins.read_exchange(tmp_path / "b.csv", CRYSTAL))
    x = np.random.default_rng(2).normal(size=model.dim)
    both = [one.dzyaloshinskii_moriya(bond, (0.3, 1, -2)).energy(x) for one in (reverse, model.exchange(bond, J))]
    np.testing.assert_allclose(*both, rtol=1e-13)  # a bond that the file lists from its second site
    for size in itertools.product((1, 2), repeat=2):
        with refused(ValueError, "file", "periodic=False"):
            co.systems.spins(CRYSTAL, (size[0], *size)).exchange(table)
