"""Crystals: bonds by shell, exchange matrices by symmetry, and structure files."""

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

CRYSTALS = {
    "chain of dimers": ((4.0, 5.0, 6.0, 90, 90, 90), {"Cu": [(0.3, 0.1, 0.2), (0.7, 0.1, 0.2)]}, None),
    "FeI2": ((4.05, 4.05, 6.75, 90, 90, 120), {"Fe": (0, 0, 0), "I": (1 / 3, 2 / 3, 0.249)}, "P -3 m 1"),
    "diamond": ((3.567, 3.567, 3.567, 90, 90, 90), {"C": (0.125, 0.125, 0.125)}, "F d -3 m:2"),
    "MnSi": ((4.558, 4.558, 4.558, 90, 90, 90), {"Mn": (0.137, 0.137, 0.137), "Si": (0.845, 0.845, 0.845)}, 198),
    "rutile": ((4.87, 4.87, 3.31, 90, 90, 90), {"Mn": (0, 0, 0), "F": (0.305, 0.305, 0)}, "P 42/m n m"),
    "rhombohedral": ((5.0, 5.0, 5.0, 75, 75, 75), {"Cr": (0.21, 0.21, 0.21)}, "R -3:R"),
    "monoclinic": ((5.0, 7.0, 6.0, 90, 103, 90), {"V": (0.1, 0.2, 0.3)}, "P 1 21/c 1"),
    "triclinic": ((5.0, 7.0, 6.0, 80, 103, 95), {"V": [(0.1, 0.2, 0.3), (0.9, 0.8, 0.7)]}, None),
    "kagome vectors": ([[2, 0, 0], [1, 3**0.5, 0], [0, 0, 3]], {"Cu": [(0, 0, 0), (0.5, 0, 0), (0, 0.5, 0)]}, None),
}

CUBE = (3.0, 3.0, 3.0, 90, 90, 90)


def made(name, scale=1.0):
    """Return a crystal of the list, with lengths in another unit."""
    lattice, sites, group = CRYSTALS[name]
    lattice = np.array(lattice, dtype=float)
    lattice[:3] *= scale
    return co.spins.crystal(lattice=lattice, sites=sites, space_group=group)


def length_of(crystal):
    """Return a length with some shells below it."""
    return 1.6 * np.linalg.norm(crystal.lattice, axis=1).min()


def turned_in_space(crystal):
    """Return the rotations and translations of the operations in space, by linear algebra of NumPy."""
    L = crystal.lattice.T
    return [(L @ W @ np.linalg.inv(L), L @ w) for W, w in zip(crystal.rotations, crystal.translations, strict=True)]


def place_of(crystal, point):
    """Return the site at a point, and its cell."""
    steps = np.linalg.solve(crystal.lattice.T, point) - crystal.positions
    cells = np.round(steps)
    gaps = np.linalg.norm((steps - cells) @ crystal.lattice, axis=1)
    site = int(gaps.argmin())
    assert gaps[site] < 1e-6 * np.abs(crystal.lattice).max()
    return site, tuple(cells[site].astype(int).tolist())


def drawn(bond, seed):
    """Return a random allowed matrix."""
    return np.tensordot(np.random.default_rng(seed).normal(size=len(bond.basis)), bond.basis, axes=1)


@pytest.mark.parametrize("name", CRYSTALS)
def test_bonds_are_those_counted_in_space(name):
    crystal = made(name)
    limit = length_of(crystal)
    found = {}
    for bond in crystal.bonds(limit):
        np.testing.assert_allclose(np.linalg.norm(bond.vectors, axis=1), bond.distance, rtol=1e-9)
        for (i, j), n, v in zip(bond.sites.tolist(), bond.offsets.tolist(), bond.vectors, strict=True):
            np.testing.assert_allclose(
                v, (crystal.positions[j] + n - crystal.positions[i]) @ crystal.lattice, atol=1e-12
            )
            assert (i, j, *n) not in found
            found[i, j, *n] = found[j, i, *(-m for m in n)] = bond
    counted = {
        (i, j, *n)
        for n in itertools.product(range(-4, 5), repeat=3)
        for i, x in enumerate(crystal.positions)
        for j, y in enumerate(crystal.positions)
        if 0 < np.linalg.norm((y + n - x) @ crystal.lattice) <= limit
    }
    assert set(found) == counted
    for bond in crystal.bonds(limit):
        ends = sum(key[0] == bond.first and found[key].name == bond.name for key in found)
        assert ends == bond.coordination


@pytest.mark.parametrize("name", CRYSTALS)
def test_exchange_is_invariant(name):
    """An operation takes every bond to one whose matrix is the rotated one."""
    crystal = made(name)
    for bond in crystal.bonds(length_of(crystal))[:4]:
        matrices = bond.exchange(drawn(bond, 1))
        keys = zip(bond.sites.tolist(), bond.offsets.tolist(), matrices, strict=True)
        table = {}
        for (i, j), n, J in keys:
            table[i, j, *n], table[j, i, *(-m for m in n)] = J, J.T
        operations = turned_in_space(crystal)
        for R, w in operations[:: 1 + len(operations) // 40]:
            for (i, j, *n), J in table.items():
                ends = [crystal.positions[i], crystal.positions[j] + n]
                (k, first), (m, second) = (place_of(crystal, R @ (x @ crystal.lattice) + w) for x in ends)
                image = table[k, m, *np.subtract(second, first).tolist()]
                np.testing.assert_allclose(image, R @ J @ R.T, atol=1e-9)


@pytest.mark.parametrize("name", CRYSTALS)
def test_all_allowed_matrices_are_found(name):
    """The number of parameters is the dimension of the solutions of all conditions that operations set."""
    crystal = made(name)
    for bond in crystal.bonds(length_of(crystal))[:6]:
        conditions = [np.zeros((1, 9))]
        start = (bond.first, bond.second, np.array(bond.offset))
        for R, w in turned_in_space(crystal):
            ends = [crystal.positions[bond.first], crystal.positions[bond.second] + bond.offset]
            (k, first), (m, second) = (place_of(crystal, R @ (x @ crystal.lattice) + w) for x in ends)
            step = np.subtract(second, first)
            turn = np.kron(R, R)
            if (k, m) == start[:2] and (step == start[2]).all():
                conditions.append(turn - np.eye(9))
            elif (m, k) == start[:2] and (step == -start[2]).all():
                conditions.append(np.eye(9).reshape(3, 3, 9).transpose(1, 0, 2).reshape(9, 9) @ turn - np.eye(9))
        rank = np.linalg.matrix_rank(np.concatenate(conditions), tol=1e-6)
        assert len(bond.basis) == 9 - rank
        for matrix in bond.basis:
            np.testing.assert_allclose(np.concatenate(conditions) @ matrix.ravel(), 0.0, atol=1e-9)


def test_forms_in_the_literature():
    """FeI2 as in tutorials of Sunny.jl; the nearest neighbours of diamond, at the centres of inversion, have no D."""
    iron = made("FeI2").subcrystal("Fe")
    text = str(iron.bonds(4.1)["1"])
    assert "[ A  0  0 ]" in text and "[ 0  B  D ]" in text and "[ 0  D  C ]" in text and "vector: (0, 0, 0)" in text
    bonds = iron.bonds(9.8)
    assert [(bond.name, bond.coordination) for bond in bonds] == [
        ("1", 6), ("2", 2), ("3", 6), ("4", 12), ("5", 6), ("6a", 6), ("6b", 6),
    ]  # fmt: skip
    first, second = made("diamond").bonds(2.6)
    assert (first.coordination, len(first.basis)) == (4, 2) and "(0, 0, 0)" in str(first)
    assert (second.coordination, len(second.basis)) == (12, 4) and "vector: (D, 0, -D)" in str(second)


def test_ligands_decide_what_symmetry_allows():
    """Moriya's rules: a chain has D along the axis across the plane that its ligand leaves a mirror."""
    cell = (3.0, 8.0, 9.0, 90, 90, 90)
    bare = co.spins.crystal(lattice=cell, sites={"Cu": (0, 0, 0)}).bonds(3)[0]
    whole = co.spins.crystal(lattice=cell, sites={"Cu": (0, 0, 0), "O": (0.5, 0, 0.1)})
    with_ligand = whole.subcrystal("Cu").bonds(3)[0]
    assert "(0, 0, 0)" in str(bare) and "(0, D, 0)" in str(with_ligand)
    D = np.array([0.0, 0.7, 0.0])
    J = with_ligand.exchange(np.eye(3) + np.array([[0, D[2], -D[1]], [-D[2], 0, D[0]], [D[1], -D[0], 0]]))[0]
    a, b = np.random.default_rng(2).normal(size=(2, 3))
    assert a @ J @ b == pytest.approx(a @ b + D @ np.cross(a, b), rel=1e-14)
    with refused(ValueError, "bond 1", "not allowed", "nearest allowed"):
        bare.exchange(J)


def test_sites_are_moved_to_special_positions():
    crystal = co.spins.crystal(lattice=CUBE, sites={"A": (0.0004, 0, 0.9997)}, space_group="P m -3 m")
    np.testing.assert_array_equal(crystal.positions, [[0, 0, 0]])
    assert crystal.bonds(3)[0].coordination == 6
    for shared in (crystal.positions, crystal.bonds(3)[0].offsets):
        with refused(ValueError, "read-only"):
            shared[0] = 1


@pytest.mark.parametrize(
    "group", ["P 1 21/n 1", "P n m a", "P 4/n m m:1", "R 3 c:H", "P 63 m c", "F d -3 c:1", "I a -3 d"]
)
def test_general_positions(group):
    """A general position has as many images as there are operations, as in International Tables A."""
    sizes = {"P 1": 4, "P n": 8, "P 4": 16, "R 3": 18, "P 6": 12, "F d": 192, "I a": 96}
    cell = {"P 1": (5, 6, 7, 90, 103, 90), "P n": (5, 6, 7, 90, 90, 90), "P 4": (5, 5, 7, 90, 90, 90)}
    hexagonal = (5, 5, 7, 90, 90, 120) if group[:3] in ("R 3", "P 6") else (6, 6, 6, 90, 90, 90)
    lattice = cell.get(group[:3], hexagonal)
    crystal = co.spins.crystal(lattice=lattice, sites={"A": (0.1, 0.35, 0.389)}, space_group=group)
    assert len(crystal.labels) == sizes[group[:3]]
    bond = crystal.bonds(5.0 if len(crystal.labels) < 20 else 2.0)[0]
    J = drawn(bond, 5)
    values = np.linalg.eigvalsh(bond.exchange(J) + bond.exchange(J).swapaxes(1, 2))
    np.testing.assert_allclose(values, np.broadcast_to(values[0], values.shape), atol=1e-12)


def test_numbers_are_isotropic_and_nearly_allowed_matrices_are_projected():
    bond = made("FeI2").subcrystal("Fe").bonds(7.1)["3"]
    np.testing.assert_array_equal(bond.exchange(-2), np.broadcast_to(-2 * np.eye(3), (3, 3, 3)))
    typed = drawn(bond, 3).round(7)
    np.testing.assert_allclose(bond.exchange(typed)[0], typed, atol=1e-6)
    with refused(ValueError, "bond 3", "nearest allowed"):
        bond.exchange(typed.round(2))


@pytest.mark.parametrize("scale", [1e-7, 1e30])
def test_units_of_length(scale):
    for name in CRYSTALS:
        one, other = made(name), made(name, scale)
        ours, theirs = one.bonds(length_of(one)), other.bonds(length_of(other))
        assert [(b.name, b.first, b.second, b.offset) for b in ours] == [
            (b.name, b.first, b.second, b.offset) for b in theirs
        ]
        np.testing.assert_allclose([b.distance * scale for b in ours], [b.distance for b in theirs], rtol=1e-12)


CIF = """data_FeI2
_cell_length_a 4.05(1)
_cell_length_b 4.05
_cell_length_c 6.75
_cell_angle_alpha 90
_cell_angle_beta 90
_cell_angle_gamma 120
_symmetry_space_group_name_H-M 'P -3 m 1'
loop_
_atom_site_label
_atom_site_type_symbol
_atom_site_fract_x
_atom_site_fract_y
_atom_site_fract_z
_atom_site_occupancy
Fe1 Fe2+ 0 0 0 1
I1 I1- 0.3333 0.6667 0.2490(3) 1.0
"""
POSCAR = """FeI2
{scale}
{vectors}
Fe I_pv
1 2
{mode}
{sites}
"""
SITES = np.array([[0, 0, 0], [1 / 3, 2 / 3, 0.249], [2 / 3, 1 / 3, 0.751]])


def poscar(scale="1.0", factor=1.0, mode="Direct", sites=SITES):
    """Return the text of a POSCAR."""
    rows = [" ".join(f"{x:.15g}" for x in row) for row in sites.tolist()]
    vectors = factor * made("FeI2").lattice
    lines = [" ".join(f"{x:.15g}" for x in row) for row in vectors.tolist()]
    return POSCAR.format(scale=scale, vectors="\n".join(lines), mode=mode, sites="\n".join(rows))


def same(one, other):
    """Assert that the iron of two crystals has the same bonds and the same exchange."""
    ours, theirs = (c.subcrystal("Fe").bonds(9.8) for c in (one, other))
    assert [b.offset for b in ours] == [b.offset for b in theirs]
    np.testing.assert_allclose([b.distance for b in ours], [b.distance for b in theirs], rtol=1e-12)
    for b, c in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(b.exchange(drawn(b, 4)), c.exchange(drawn(b, 4)), atol=1e-12)


def written(tmp_path, name, text):
    """Return a file with a text."""
    path = tmp_path / name
    path.write_text(text)
    return path


def test_cif(tmp_path):
    crystal = co.spins.crystal(written(tmp_path, "FeI2.cif", CIF))
    assert crystal.labels == ("Fe1", "I1", "I1") and crystal.space_group == "P -3 m 1 (164)"
    np.testing.assert_allclose(crystal.positions, SITES, atol=1e-15)
    same(crystal, made("FeI2"))


def test_cif_with_operations(tmp_path):
    """The operations of a CIF count, not its name; those of a full cell are found."""
    lines = ["x,y,z", "-x,-y,-z"]
    text = CIF + "loop_\n_space_group_symop_operation_xyz\n" + "\n".join(f"'{line}'" for line in lines) + "\n"
    crystal = co.spins.crystal(written(tmp_path, "low.cif", text))
    assert len(crystal.rotations) == 2 and len(crystal.labels) == 3
    assert len(crystal.subcrystal("Fe").bonds(4.1)) == 3
    full = CIF.replace("'P -3 m 1'", "'P 1'") + "I2 I1- 0.66667 0.33333 0.751 1\n"
    same(co.spins.crystal(written(tmp_path, "full.cif", full)), made("FeI2"))


@pytest.mark.parametrize("kind", ["direct", "scaled", "volume", "Cartesian", "selective", "three"])
def test_poscar(tmp_path, kind):
    crystal = made("FeI2")
    text = {
        "direct": poscar(),
        "scaled": poscar(scale="2.025", factor=1 / 2.025),
        "volume": poscar(scale=f"{-abs(np.linalg.det(crystal.lattice)):.17g}", factor=3.0),
        "Cartesian": poscar(scale="2", factor=0.5, mode="Cartesian", sites=SITES @ crystal.lattice / 2),
        "selective": poscar(mode="Selective dynamics\nDirect").replace("\n0 0 0\n", "\n0 0 0 T F T\n"),
        "three": poscar(scale="2 2 2", factor=0.5),
    }[kind]
    found = co.spins.crystal(written(tmp_path, "POSCAR", text))
    np.testing.assert_allclose(found.lattice, crystal.lattice, atol=1e-12)
    np.testing.assert_allclose((found.positions - SITES + 0.5) % 1, 0.5, atol=1e-12)
    assert found.labels == ("Fe", "I", "I") and "(164)" in found.space_group
    ours, theirs = found.subcrystal("Fe").bonds(9.8), crystal.subcrystal("Fe").bonds(9.8)
    assert [b.offset for b in ours] == [b.offset for b in theirs]
    assert len(co.spins.crystal(written(tmp_path, "x.vasp", text), space_group="P 1").rotations) == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({}, ["lattice=", "sites="]),
        ({"lattice": CUBE}, ["sites="]),
        ({"lattice": CUBE[:5], "sites": {"A": (0, 0, 0)}}, ["shape (5,)"]),
        ({"lattice": (3, 3, 3, 90, 90, 190), "sites": {"A": (0, 0, 0)}}, ["angles"]),
        ({"lattice": (3, 3, 3, 40, 40, 90), "sites": {"A": (0, 0, 0)}}, ["no volume"]),
        ({"lattice": (3, -3, 3, 90, 90, 90), "sites": {"A": (0, 0, 0)}}, ["lengths"]),
        ({"lattice": CUBE, "sites": {}}, ["no sites"]),
        ({"lattice": CUBE, "sites": {"A": (0, 0)}}, ["fractional"]),
        ({"lattice": CUBE, "sites": {"A": (0, 0, np.nan)}}, ["A", "nan"]),
        ({"lattice": CUBE, "sites": {"A": (0, 0, 0), "B": (1, 0, 0)}}, ["A", "B", "same place"]),
        ({"lattice": CUBE, "sites": {"A": (0, 0, 0), "B": (0.02, 0, 0)}}, ["A", "B", "apart"]),
        ({"lattice": CUBE, "sites": {"A": (0.02, 0, 0)}, "space_group": "P m -3 m"}, ["0.12", "apart"]),
        ({"lattice": CUBE, "sites": {"A": (0.0006, 0, 0)}, "space_group": "P m -3 m"}, ["A", "collide"]),
        ({"lattice": CUBE, "sites": {"A": (0, 0, 0)}, "space_group": "P 6/m"}, ["P 6/m", "preserve"]),
        ({"lattice": CUBE, "sites": {"A": (0, 0, 0)}, "space_group": 227}, ["F d -3 m:1", "F d -3 m:2"]),
        ({"lattice": CUBE, "sites": {"A": (0, 0, 0)}, "space_group": "P q"}, ["P q"]),
        ({"lattice": CUBE, "sites": {"A": (0, 0, 0)}, "space_group": 231}, ["231", "230"]),
        ({"lattice": CUBE, "sites": {"A": (0, 0, 0)}, "tolerance": 0.2}, ["tolerance"]),
    ],
)
def test_refused(arguments, words):
    with refused(ValueError, *words):
        co.spins.crystal(**arguments)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.cif", "nonsense", ["a.cif", "no CIF"]),
        ("a.cif", "data_x\n_cell_length_a 1\n", ["no block"]),
        ("a.cif", CIF + CIF.replace("data_FeI2", "data_2"), ["2 structures"]),
        ("a.cif", CIF.replace("_cell_length_c 6.75\n", ""), ["_cell_length_c", "missing"]),
        ("a.cif", CIF.replace("0.6667", "?"), ["I1", "finite"]),
        ("a.cif", CIF.replace("0.6667", "1e999"), ["I1", "finite"]),
        ("a.cif", CIF.replace("1.0\n", "0.5\n"), ["occupancy", "I1"]),
        ("a.cif", CIF.replace("_symmetry_space_group_name_H-M 'P -3 m 1'\n", ""), ["space_group="]),
        ("a.cif", CIF.replace("P -3 m 1", "P m -3 m"), ["preserve"]),
        ("a.cif", CIF + "I2 I1- 0.6667 0.3333 0.751 1\n", ["same place"]),
        ("a.cif", CIF + "_space_group_symop_operation_xyz 'x,y'\n", ["x,y"]),
        ("a.cif", CIF + "_space_group_symop_operation_xyz '2*x,y,z'\n", ["2*x"]),
        ("a.cif", CIF + "_space_group_symop_operation_xyz '-x,-y,-z'\n", ["without x,y,z"]),
        ("a.cif", CIF + "_atom_site_moment.label Fe1\n", ["magnetic CIF"]),
        ("a.mcif", CIF, ["magnetic CIF"]),
        ("a.xyz", CIF, ["a.xyz", ".cif"]),
        ("POSCAR", "x\n1\n", ["lines"]),
        ("POSCAR", poscar().replace("Fe I_pv", "1 2"), ["line 6", "species"]),
        ("POSCAR", poscar().replace("1 2\n", "1\n"), ["line 7"]),
        ("POSCAR", poscar().replace("1 2\n", "1 200\n"), ["announces 201"]),
        ("POSCAR", poscar().replace("1 2\n", "1 999999999\n"), ["at most"]),
        ("POSCAR", poscar(mode="Other"), ["line 8", "Direct"]),
        ("POSCAR", poscar(scale="0"), ["volume"]),
        ("POSCAR", poscar(scale="1 2"), ["line 2"]),
        ("POSCAR", poscar().replace("0.249", "nan"), ["line 10"]),
    ],
)
def test_files_refused(tmp_path, name, text, words):
    with refused(ValueError, *words):
        co.spins.crystal(written(tmp_path, name, text))


def test_hostile_sizes_are_refused_at_once(tmp_path):
    rows = "".join(f"H{k} H {0.1 + k / 40000:.6f} 0.37 0.13 1\n" for k in range(1, 4000))
    with refused(ValueError, "2000 sites"):
        co.spins.crystal(written(tmp_path, "many.cif", CIF + rows))
    shifts = "".join(f"'x+{k}/24,y,z'\n" for k in range(2000))
    with refused(ValueError, "2000 symmetry operations"):
        co.spins.crystal(written(tmp_path, "ops.cif", CIF + "loop_\n_space_group_symop_operation_xyz\n" + shifts))


@pytest.mark.parametrize("package", ["gemmi", "spglib"])
def test_missing_packages_are_named(monkeypatch, package):
    find = importlib.util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name, *more: None if name == package else find(name, *more))
    with refused(ModuleNotFoundError, package, "coadjoint[crystals]"):
        co.spins.crystal(lattice=CUBE, sites={"A": (0, 0, 0)}, space_group=221 if package == "gemmi" else None)


def test_wrong_calls():
    crystal = made("FeI2")
    bonds = crystal.bonds(4.1)
    with refused(KeyError, "'99'", "'1'"):
        bonds["99"]
    with refused(ValueError, "Ni", "Fe"):
        crystal.subcrystal("Ni")
    with refused(ValueError, "max_distance"):
        crystal.bonds(-1.0)
    with refused(ValueError, "bonds", "smaller"):
        crystal.bonds(1e4)
    with refused(ValueError, "bonds", "smaller"):
        crystal.bonds(1e300)
    with refused(ValueError, "shape (2, 2)"):
        bonds[0].exchange(np.eye(2))
    with refused(ValueError, "nan"):
        bonds[0].exchange(np.nan)
    with refused(ValueError, "beside"):
        co.spins.crystal("x.cif", lattice=CUBE)
