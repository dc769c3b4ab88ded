"""Magnetic structures from mCIF: moments by operations, states of models on magnetic and paramagnetic cells."""

import importlib.util

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

pytestmark = [
    pytest.mark.skipif(importlib.util.find_spec(name) is None, reason=f"{name} is not installed")
    for name in ("gemmi", "spglib")
]


def mcif(cell, operations, sites, moments, centrings=("x,y,z,+1",), old=False, extra=""):
    """Return the text of a magnetic CIF; in the tags of version 1.0, or of before."""
    names = ("length_a", "length_b", "length_c", "angle_alpha", "angle_beta", "angle_gamma")
    lines = ["data_test", *(f"_cell_{name} {value}" for name, value in zip(names, cell, strict=True)), extra]
    for kind, listed in (("operation", operations), ("centering", centrings)):
        lines += ["loop_", f"_space_group_symop.magn_{kind}_id" if old else f"_space_group_symop_magn_{kind}.id"]
        lines += [f"_space_group_symop.magn_{kind}_xyz" if old else f"_space_group_symop_magn_{kind}.xyz"]
        lines += [f"{k} {text}" for k, text in enumerate(listed, 1)]
    lines += ["loop_", *(f"_atom_site_{name}" for name in ("label", "type_symbol", "fract_x", "fract_y", "fract_z"))]
    lines += [f"{label} {label.rstrip('0123456789')} {' '.join(map(str, place))}" for label, place in sites.items()]
    separator = "_" if old else "."
    lines += [
        "loop_",
        *(f"_atom_site_moment{separator}{name}" for name in ("label", *(f"crystalaxis_{a}" for a in "xyz"))),
    ]
    lines += [f"{label} {' '.join(map(str, moment))}" for label, moment in moments.items()]
    return "\n".join([*lines, ""])


def of_mnf2(old=False):
    """Return MnF2 in P 4_2'/m n m': both sublattices along c, opposite; theta follows from the sublattice and det W."""
    import gemmi

    operations = []
    for op in gemmi.find_spacegroup_by_name("P 42/m n m").operations():
        W, w = np.array(op.rot) / 24, np.array(op.tran) / 24
        swapped = not np.allclose(w % 1, 0)
        theta = (-1 if swapped else 1) * round(np.linalg.det(W) * W[2, 2])
        operations.append(f"{op.triplet()},{theta:+d}")
    assert len(operations) == 16 and sum(text.endswith("-1") for text in operations) == 8
    return mcif(
        (4.8734, 4.8734, 3.3099, 90, 90, 90),
        operations,
        {"Mn1": (0, 0, 0), "F1": (0.305, 0.305, 0)},
        {"Mn1": (0, 0, "4.6(2)")},
        old=old,
    )


@pytest.mark.parametrize("old", [False, True])
@pytest.mark.parametrize("g", [2.0, -2.0])
def test_the_order_of_mnf2(tmp_path, old, g):
    (tmp_path / "MnF2.mcif").write_text(of_mnf2(old))
    order = co.spins.magnetic_structure(tmp_path / "MnF2.mcif")
    assert order.crystal.labels == ("Mn1",) * 2 + ("F1",) * 4
    assert np.allclose(order.moments, [[0, 0, 4.6], [0, 0, -4.6], *np.zeros((4, 3))])
    paramagnet = co.spins.crystal(co.spins.structure("MnF2")).subcrystal("Mn")
    for crystal in (paramagnet, order.crystal.subcrystal("Mn")):
        model = co.systems.spins(crystal, (2, 3, 1), g=g)
        expected = np.sign(g) * np.where(model.sites == 0, 1, -1)[:, None] * [0, 0, 1]
        assert np.allclose(order.state(model), expected.ravel())


def test_moments_turn_in_oblique_axes(tmp_path):
    """Three spins at 120 degrees, by a threefold axis of the hexagonal cell, in the plane and out of it."""
    text = mcif(
        (6.0, 6.0, 4.0, 90, 90, 120),
        ("x,y,z,+1", "-y,x-y,z,+1", "-x+y,-x,z,+1"),
        {"V1": (0.2, 0.0, 0.0)},
        {"V1": (2.0, 1.0, 0.5)},
    )
    (tmp_path / "a.mcif").write_text(text)
    order = co.spins.magnetic_structure(tmp_path / "a.mcif")
    a, b = np.array([1.0, 0, 0]), np.array([-0.5, np.sqrt(0.75), 0])
    first = 2.0 * a + 1.0 * b + [0, 0, 0.5]
    turn = np.array([[-0.5, -np.sqrt(0.75), 0], [np.sqrt(0.75), -0.5, 0], [0, 0, 1]])
    places = order.crystal.positions
    for k in range(3):
        after = (np.array([[0, -1, 0], [1, -1, 0], [0, 0, 1]]) @ places[k]) % 1
        image = np.abs((places - after + 0.5) % 1 - 0.5).max(axis=1).argmin()
        assert np.allclose(order.moments[image], turn @ order.moments[k], atol=1e-12)
    assert np.allclose(order.moments[0], first)


@pytest.mark.parametrize("reversal", [1, -1])
def test_mirrors_reverse_moments_within_them(tmp_path, reversal):
    """An axial vector keeps its part across a mirror plane; time reversal changes all signs."""
    text = mcif(
        (4.0, 5.0, 6.0, 90, 90, 90),
        ("x,y,z,+1", f"x,y,-z,{reversal:+d}"),
        {"Fe1": (0.1, 0.2, 0.3)},
        {"Fe1": (1.0, 2.0, 3.0)},
    )
    (tmp_path / "a.mcif").write_text(text)
    assert np.allclose(co.spins.magnetic_structure(tmp_path / "a.mcif").moments[1], reversal * np.array([-1, -2, 3.0]))


def test_supercells_of_the_paramagnet(tmp_path):
    """A doubled cell by an antitranslation: states of models on the single one, whole or not."""
    text = mcif(
        (8.0, 4.02, 4.0, 90, 90, 90),
        ("x,y,z,+1",),
        {"Ni1": (0.0, 0.0, 0.0), "O1": (0.25, 0, 0)},
        {"Ni1": (1.0, 0.0, 1.0)},
        ("x,y,z,+1", "x+1/2,y,z,-1"),
    )
    (tmp_path / "a.mcif").write_text(text)
    order = co.spins.magnetic_structure(tmp_path / "a.mcif")
    nickel = co.spins.crystal(lattice=(4, 4, 4, 90, 90, 90), sites={"Ni": (0, 0, 0)}, space_group="P 1")
    model = co.systems.spins(nickel, (4, 1, 2))
    x = order.state(model).reshape(-1, 3)
    assert np.allclose(x, (-1.0) ** model.cells[:, :1] * np.array([1, 0, 1]) / np.sqrt(2))
    assert len(order.state(co.systems.spins(nickel, (3, 1, 1), periodic=(False, True, True)))) == 9
    oxygen = co.spins.crystal(lattice=(4, 4, 4, 90, 90, 90), sites={"O": (0.5, 0, 0)}, space_group="P 1")
    other = co.spins.crystal(lattice=(4, 4, 5, 90, 90, 90), sites={"Ni": (0, 0, 0)}, space_group="P 1")
    for crystal, size, words in [
        (nickel, (3, 1, 1), "3 cells along a"),
        (oxygen, (2, 1, 1), "no moment at spin 0"),
        (other, (2, 1, 1), "no common lattice"),
    ]:
        with refused(ValueError, words):
            order.state(co.systems.spins(crystal, size))
    with refused(TypeError, "co.systems.spins"):
        order.state(co.systems.spin_lattice())


def test_files_that_mean_something_else(tmp_path):
    good = {
        "cell": (4.0, 4.0, 4.0, 90, 90, 90),
        "operations": ("x,y,z,+1", "-y,x,z,+1", "-x,-y,z,+1", "y,-x,z,+1"),
        "sites": {"Fe1": (0, 0, 0)},
        "moments": {"Fe1": (0, 0, 2.0)},
    }
    file = tmp_path / "a.mcif"
    file.write_text(mcif(**good))
    assert np.allclose(co.spins.magnetic_structure(file).moments, [[0, 0, 2]])
    for change, words in [
        ({"moments": {"Fe1": (1.0, 0, 2.0)}}, "the operations give the site of Fe1"),
        ({"operations": (*good["operations"][:3], "y,-x,z,-1")}, "the operations give"),
        ({"moments": {"Fe2": (0, 0, 1.0)}}, "Fe2"),
        ({"moments": {"Fe1": (0, 0, 0)}}, "all zero"),
        ({"moments": {"Fe1": (0, 0, "?")}}, "a moment of 'Fe1'"),
        ({"operations": ("x,y,z",)}, "no magnetic operation"),
        ({"operations": ("x,y,z,+2",)}, "no magnetic operation"),
        ({"operations": ("x,y,z,+1", "2x,y,z,+1")}, "2"),
        ({"centrings": ("x,y,z,+1", "-x,y,z,+1")}, "centrings that turn"),
        ({"extra": "_cell_modulation_dimension 1"}, "modulated"),
        ({"cell": (4.0, 5.0, 4.0, 90, 90, 90)}, "preserve the lattice"),
    ]:
        file.write_text(mcif(**good | change))
        with refused(ValueError, "a.mcif", words):
            co.spins.magnetic_structure(file)
    for old, new, words in [
        ("crystalaxis", "spherical", "along the crystal axes"),
        ("symop_magn_operation.xyz", "symop_magn_operation.uvw", "no magnetic operations"),
        ("_atom_site_fract_x", "_atom_site_Cartn_x", "no block"),
    ]:
        file.write_text(mcif(**good).replace(old, new))
        with refused(ValueError, "a.mcif", words):
            co.spins.magnetic_structure(file)
