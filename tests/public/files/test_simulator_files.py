"""Scripts of Sunny and files of VAMPIRE: their numbers, by the rules of those codes, give the energies of the model."""

import re

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

CRYSTAL = co.spins.crystal(
    lattice=[(3.0, 0.0, 0.0), (-0.5, 4.0, 0.0), (0.2, 0.3, 5.0)],
    sites={"Ni": (0.5, 0.5, 0.75), "Fe": (0.0, 0.0, 0.0)},
    space_group="P 1",
)
BOX = co.spins.crystal(lattice=(3, 4, 5, 90, 90, 90), sites={"A": [(0, 0, 0), (0.5, 0.4, 0.3)]}, space_group="P 1")
SIZE = (3, 3, 2)


def full_model(crystal, uniaxial=False, exchange_alone=False, **given):
    """Return a model with random terms of all kinds."""
    rng = np.random.default_rng(7)
    given = {"spin": [1.5, 2.0], "g": [2.0, -1.7], "units": "meV"} | given
    model = co.systems.spins(crystal, SIZE, **given)
    for bond in list(crystal.bonds(4.2))[:6]:
        model = model.exchange(bond, rng.normal(size=(3, 3)))
    model = model.dzyaloshinskii_moriya(crystal.bonds(4.2)[0], rng.normal(size=3))
    if exchange_alone:
        return model
    for site in (0, 1):
        A = rng.normal(size=(3, 3))
        if uniaxial:
            A = np.diag([0.3, 0.3, -0.4]) if site else np.outer([0.6, 0.0, 0.8], [0.6, 0.0, 0.8])
        model = model.single_ion(site, A + A.T)
    return model.field((1.5, -2.5, 3.0))


def states(model, count=2):
    x = np.random.default_rng(2).normal(size=(count, model.dim // 3, 3))
    return (x / np.linalg.norm(x, axis=-1, keepdims=True)).reshape(count, -1)


class Sunny:
    """The energy of a script, by the definitions in the documentation of Sunny.jl."""

    def __init__(self, script):
        self.script = script
        found = dict(re.findall(r"^(\w+) = (.*)$", script, re.M))
        self.lattice = self.matrix(found["latvecs"]).T
        self.positions = np.array(eval(found["positions"]))
        pairs = re.findall(r"(\d+) => Moment\(s=([\d/]+), g=([-.\de]+)\)", script)
        self.spin = [eval(s) for _, s, _ in pairs]
        self.g = [float(g) for *_, g in pairs]
        self.dims = eval(re.search(r"dims=(\(.*?\))\)", script)[1])
        self.open = [False] * 3
        if "remove_periodicity!" in script:
            assert script.index("to_inhomogeneous") < script.index("remove_periodicity!")
            flags = re.search(r"remove_periodicity!\(sys, \((.*)\)\)", script)[1]
            self.open = [flag.strip() == "true" for flag in flags.split(",")]

    @staticmethod
    def matrix(text):
        return np.array([[float(one) for one in row.split()] for row in text.strip("[]").split(";")])

    def sites(self, name):
        return [
            tuple(int(n) - 1 for n in m.split(","))
            for m in re.findall(rf"{name}\(sys, .*?\(([\d, ]+)\)\)", self.script)
        ]

    def energy(self, S, mu_B):
        """Return the energy of spins S (a, b, c, site, 3) of lengths s; zero at vacancies."""
        total = 0.0
        for J, i, j, n in re.findall(r"set_exchange!\(sys, (\[.*?\]), Bond\((\d+), (\d+), (\[.*?\])\)\)", self.script):
            J, i, j, n = self.matrix(J), int(i) - 1, int(j) - 1, eval(n)
            for cell in np.ndindex(*self.dims):
                other = np.add(cell, n)
                if any(flag and not 0 <= k < d for flag, k, d in zip(self.open, other, self.dims, strict=True)):
                    continue
                total += S[cell][i] @ J @ S[tuple(other % self.dims)][j]
        for terms, site in re.findall(r"set_onsite_coupling!\(sys, S -> (.*), (\d+)\)", self.script):
            for factor, a, b in re.findall(r"([-.\de]+)\*S\[(\d)\]\*S\[(\d)\]", terms):
                one = S[..., int(site) - 1, :]
                total += float(factor) * (one[..., int(a) - 1] * one[..., int(b) - 1]).sum()
        for B in re.findall(r"set_field!\(sys, (\[.*?\])", self.script):
            total += mu_B * (np.array(self.g)[:, None] * S * eval(B)).sum()
        for B, site in re.findall(r"set_field_at!\(sys, (\[.*?\]).*?\(([\d, ]+)\)\)", self.script):
            place = tuple(int(k) - 1 for k in site.split(","))
            total += mu_B * self.g[place[3]] * (S[place] @ eval(B))
        return total


@pytest.mark.parametrize("units", ["meV", "natural"])
@pytest.mark.parametrize("periodic", [True, (True, False, True), False])
@pytest.mark.parametrize("change", ["", "vacancies", "fields"])
def test_a_script_of_sunny_has_the_energy_of_the_model(units, periodic, change):
    model = full_model(CRYSTAL, units=units, periodic=periodic)
    if change == "vacancies":
        model = model.vacancies(0.2, seed=3)
    if change == "fields":
        model = model.field(np.random.default_rng(1).normal(size=(len(model.sites), 3)))
    x = states(model)
    script = Sunny(co.spins.to_sunny(model, x[0]))
    assert np.allclose(script.lattice, CRYSTAL.lattice) and np.allclose(script.positions, CRYSTAL.positions)
    assert script.dims == SIZE and script.spin == [1.5, 2.0] and script.g == [-2.0, 1.7]
    mu_B = 0.057883817982 if units == "meV" else 1.0
    assert ("units.T" in script.script) == (units == "meV")
    for state in x:
        S = np.zeros((*SIZE, 2, 3))
        for cell, site, s in zip(model.cells, model.sites, state.reshape(-1, 3), strict=True):
            S[(*cell, site)] = script.spin[site] * s
        found = script.energy(S, mu_B)
        assert abs(found - model.energy(state)) < 1e-11 * max(1.0, abs(found))
    occupied = {(*cell, site) for *cell, site in np.column_stack([model.cells, model.sites]).tolist()}
    assert set(script.sites("set_vacancy_at!")) == set(np.ndindex(*SIZE, 2)) - occupied
    dipoles = re.findall(r"set_dipole!\(sys, (\[.*?\]), \(([\d, ]+)\)\)", script.script)
    assert np.array_equal([eval(S) for S, _ in dipoles], x[0].reshape(-1, 3))
    places = [tuple(int(k) - 1 for k in site.split(",")) for _, site in dipoles]
    assert places == [(*cell, site) for *cell, site in np.column_stack([model.cells, model.sites]).tolist()]


def test_dipoles_of_sunny_have_no_demagnetization():
    model = co.systems.spins(BOX, SIZE, spin=1, units="meV").dipolar()
    assert "enable_dipole_dipole!(sys, units.vacuum_permeability; demag=0)" in co.spins.to_sunny(model)


def energy_of_vampire(folder, m, mu_B=0.057883817982):
    """Return the energy in meV of moments m (a, b, c, atom, 3), by the rules of VAMPIRE; E is in joules."""
    text = {name: (folder / name).read_text() for name in ("spins.mat", "spins.ucf", "input")}
    rows = [line.split("#")[0].split() for line in text["spins.ucf"].splitlines()]
    rows = [row for row in rows if row]
    count = int(rows[4][0])
    materials = [int(row[4]) for row in rows[5 : 5 + count]]
    bonds, kind = rows[6 + count :], rows[5 + count][1]
    assert len(bonds) == int(rows[5 + count][0])

    def constant(material, name, default):
        found = re.search(rf"material\[{material + 1}\]:{name}=(\S+)", text["spins.mat"])
        return found[1] if found else default

    open_axes = [f"create:periodic-boundaries-{axis}" not in text["input"] for axis in "xyz"]
    strength = float(re.search(r"strength=(\S+)", text["input"])[1])
    B = strength * np.array(eval(re.search(r"unit-vector=(\S+)", text["input"])[1]))
    total, dims = 0.0, m.shape[:3]
    for _, i, j, *rest in bonds:
        i, j, n = int(i), int(j), [int(k) for k in rest[:3]]
        J = np.array(rest[3:], dtype=float)
        J = J.reshape(3, 3) if kind == "tensorial" else J[0] * np.eye(3)
        for cell in np.ndindex(*dims):
            other = np.add(cell, n)
            if not any(flag and not 0 <= k < d for flag, k, d in zip(open_axes, other, dims, strict=True)):
                total -= 0.5 * m[cell][i] @ J @ m[tuple(other % dims)][j] / 1.602176634e-22
    for atom, material in enumerate(materials):
        k = float(constant(material, "second-order-uniaxial-anisotropy-constant", 0)) / 1.602176634e-22
        e = np.array(eval(constant(material, "uniaxial-anisotropy-direction", "0,0,1")))
        total -= k * ((m[..., atom, :] @ e) ** 2).sum()
        total -= float(constant(material, "atomic-spin-moment", 0)) * mu_B * (m[..., atom, :] @ B).sum()
    return total


@pytest.mark.parametrize("periodic", [True, (True, False, True)])
def test_files_of_vampire_have_the_energy_of_the_model(tmp_path, periodic):
    model = full_model(BOX, uniaxial=True, periodic=periodic)
    files = co.spins.to_vampire(model, tmp_path / "run")
    assert [file.name for file in files] == ["spins.mat", "spins.ucf", "input"]
    signs, energies = np.sign(model.moments)[:, None], []
    for x in states(model, 3):
        m = (signs * x.reshape(-1, 3)).reshape(*SIZE, 2, 3)
        energies.append((energy_of_vampire(tmp_path / "run", m), model.energy(x)))
    differences = np.diff(energies, axis=1)[:, 0]  # a constant of the anisotropy
    assert np.ptp(differences) < 1e-10 * np.abs(energies).max()
    text = (tmp_path / "run" / "spins.mat").read_text()
    assert "relative-gamma=0.85" in text and "num-materials=2" in text
    sizes = [float(s) for s in re.findall(r"system-size-.=(\S+) !A", (tmp_path / "run" / "input").read_text())]
    assert [int(np.ceil(size / edge)) for size, edge in zip(sizes, (3, 4, 5), strict=True)] == list(SIZE)


def test_exchange_goes_round(tmp_path):
    """What is written for VAMPIRE is read again, tensors and isotropic."""
    single = co.systems.spins(BOX, SIZE, units="meV").exchange(BOX.bonds(4)["1a"], -1.25)
    for model in (full_model(BOX, exchange_alone=True, g=1.7), single):
        _, ucf, _ = co.spins.to_vampire(model, tmp_path)
        again = co.systems.spins(BOX, SIZE, units="meV").exchange(co.spins.read_exchange(ucf, BOX))
        for x in states(model):
            assert abs(again.energy(x) - model.energy(x)) < 1e-10 * np.abs(model.energy(x))


def test_what_other_codes_do_not_have(tmp_path):
    model = small = co.systems.spins(BOX, (1, 1, 1), spin=1, periodic=False, units="meV")
    left = co.spins.crystal(lattice=np.diag([1.0, 1.0, -1.0]), sites={"A": (0, 0, 0)}, space_group="P 1")
    hot = model.with_forces(co.forces.Gilbert(0.1))
    alloy = model.substitute("A", 0.5, seed=1, spin=1.0)
    for given, words in [
        (hot, "forces"),
        (alloy, "substituted"),
        (model.field(lambda t: (0.0, 0.0, t)), "function"),
        (co.systems.spins(BOX, SIZE, spin=0.7, units="meV"), "multiple of 1/2"),
        (co.systems.spins(left, SIZE), "left-handed"),
        (co.systems.spins(BOX, SIZE, periodic=False).dipolar(), "dipoles"),
    ]:
        with refused(ValueError, words):
            co.spins.to_sunny(given)
    with refused(ValueError, f"({small.dim},)"):
        co.spins.to_sunny(model, np.ones(3))
    for given, words in [
        (hot, "forces"),
        (alloy, "substituted"),
        (co.systems.spins(BOX, SIZE), "natural units"),
        (co.systems.spins(CRYSTAL, (1, 1, 1), units="meV"), "along x, y, z"),
        (model.single_ion(0, np.diag([1, 2, 4])), "three different axes"),
        (model.vacancies(0.5, seed=1), "vacancies"),
        (model.dipolar(), "dipoles"),
        (model.field(np.ones((2, 3))), "each spin"),
    ]:
        with refused(ValueError, words):
            co.spins.to_vampire(given, tmp_path / "none")
    assert not (tmp_path / "none").exists()
    for function in (co.spins.to_sunny, lambda system: co.spins.to_vampire(system, tmp_path)):
        with refused(TypeError, "co.systems.spins"):
            function(co.systems.spin_lattice())
