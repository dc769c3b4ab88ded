"""Names of coordinates in all that is printed, in datasets, polynomials and configuration files."""

import pickle

import numpy as np
import pytest

import coadjoint as co
from configuration_files import ConfigurationFiles
from refusals import refused

TOP = ("m1", "m2", "m3", "gamma1", "gamma2", "gamma3")

X0 = (0.1, 0.2, 0.3, 0.5, 0.1, 1.0)


def names_of(system, x0=None):
    run = co.integrate(system, np.cos(np.arange(system.dim)) if x0 is None else x0, (0, 0.01), 0.01, watch=False)
    return tuple(run.to_xarray()["component"].values.tolist())


def test_names_are_those_of_the_system_else_of_the_basis_else_x():
    top = co.systems.heavy_top()
    assert names_of(top) == TOP == names_of(top.with_forces(co.forces.LinearDamping(0.1)))
    assert names_of(co.systems.rigid_body()) == ("x1", "x2", "x3")
    own = co.LieAlgebra.from_brackets(["[h, e] = 2 e", "[h, f] = -2 f", "[e, f] = h"])
    assert names_of(co.LiePoissonSystem(own, co.Quadratic(np.ones(3)))) == ("h", "e", "f")
    pair = co.algebras.copies(co.algebras.so(3), 2)
    assert names_of(co.LiePoissonSystem(pair, co.Quadratic(np.ones(6))))[::3] == ("x1[1]", "x1[2]")
    assert names_of(co.systems.spin_lattice("chain", 3))[3:5] == ("S1[2]", "S2[2]")
    assert names_of(co.systems.so_n_body((1, 2, 3, 4))) == ("x12", "x13", "x14", "x23", "x24", "x34")


def test_everything_printed_of_a_system_has_its_names():
    top = co.systems.heavy_top()
    H = co.modified_hamiltonian(top, co.Splitting())
    field = co.modified_field(top, co.Splitting(), order=3)
    described = co.Splitting().describe(top)
    for text in map(str, (top.casimirs["m.p"], H, H.terms[2], H.error_term.term, field.terms[2], described)):
        assert "m1" in text and "gamma1" in text and "x1" not in text and "e1" not in text
    assert str(top.casimirs["m.p"]) == "m1*gamma1 + m2*gamma2 + m3*gamma3"
    assert top.casimirs["m.p"].to_latex().startswith(r"m_{1} \gamma_{1}")
    assert {str(symbol) for symbol in top.casimirs["m.p"].to_sympy().free_symbols} == set(TOP)
    sites = co.systems.spin_lattice()
    assert sites.casimirs["|x|^2 [1]"].to_latex() == "{S_{1}^{[1]}}^{2} + {S_{2}^{[1]}}^{2} + {S_{3}^{[1]}}^{2}"


def test_polynomial_energies_are_printed_with_the_names_of_the_basis():
    own = co.LieAlgebra.from_brackets(["[h, e] = 2 e", "[h, f] = -2 f", "[e, f] = h"])
    system = co.LiePoissonSystem(own, co.Polynomial({(4, 0, 0): 0.25, (0, 1, 1): 1.0}))
    text = str(system.hamiltonian)
    assert "h^4" in text and "e*f" in text and "x1" not in text


def test_polynomials_carry_names_through_arithmetic_and_are_equal_without():
    p = co.Polynomial("q^2 - p", basis=("q", "p"))
    plain = co.Polynomial("x1^2 - x2", dim=2)
    assert p == plain and hash(p) == hash(plain) and p.named(("x1", "x2")).names == ("x1", "x2")
    results = (p + plain, plain + p, -p, p * plain, p / 2, p**2, p.derivative(0), 3 - p, pickle.loads(pickle.dumps(p)))
    for result in results:
        assert result.names == ("q", "p")
    assert p.named(("a", "b")) is p.named(["a", "b"]) and p.named(("q", "p")) is p


BASES = [("e0", "e1", "e2"), ("e2", "e1", "e3"), ("x3", "h", "x1"), ("e1", "x1", "e2")]


def so3(basis, H=None, **options):
    """so(3) in a basis of these names, and the energy (1, 2, 4)/2 if none is given."""
    algebra = co.LieAlgebra.from_brackets(3, {(0, 1): {2: 1}, (1, 2): {0: 1}, (2, 0): {1: 1}}, basis=basis)
    return co.LiePoissonSystem(algebra, co.Quadratic([1.0, 2.0, 4.0]) if H is None else H, **options)


@pytest.mark.parametrize("basis", BASES)
def test_a_name_is_that_of_one_coordinate_everywhere(basis, tmp_path, monkeypatch, capsys):
    """In energies, Casimirs, events, observed quantities, pictures and files it is the coordinate of the dataset."""
    monkeypatch.chdir(tmp_path)
    system, x0 = so3(basis), (0.9, 0.7, -1.1)
    names = names_of(system)
    polynomials = {name: co.Polynomial(f"{name} - 0.25", basis=names) for name in names}
    events = [*map(co.Event, names), *(co.Event(p, name=f"{name} - 0.25") for name, p in polynomials.items())]
    run = co.integrate(system, x0, (0, 8), 0.05, observe=polynomials, events=events)
    data = run.to_xarray()
    tables = "".join(f'[events.e{k}]\ng = "{n}"\n[events.d{k}]\ng = "{n} - 0.0"\n' for k, n in enumerate(names))
    triples = [np.roll(basis, -k).tolist() for k in range(3)]
    energy = " + ".join(f"{c}*{name}^2/2" for c, name in zip((1, 2, 4), names, strict=True))
    text = f"""
algebra = {{basis = {list(basis)}, brackets = {[f"[{a}, {b}] = {c}" for a, b, c in triples]}}}
hamiltonian = {{polynomial = "{energy}"}}
casimirs = {{own = "{" + ".join(f"{name}^2" for name in names)}"}}
observe = {{{", ".join(f'o{k} = "{name} - 0.25"' for k, name in enumerate(names))}}}
initial = {{x = {list(x0)}}}
run = {{t_span = [0, 8], step = 0.05}}
{tables}"""
    stored = ConfigurationFiles(tmp_path, capsys).run(text)
    figure = run.plot(["components"], components=list(names))
    lines = [line for line in figure.axes[0].lines if len(line.get_xdata()) > 1]
    for k, name in enumerate(names):
        x = run.x[:, k]
        np.testing.assert_array_equal(data["x"].sel(component=name), x)
        np.testing.assert_array_equal(so3(basis, f"{name}^2/2").hamiltonian.gradient(x0), np.eye(3)[k] * x0)
        np.testing.assert_array_equal(so3(basis, f"cos({name})").hamiltonian.gradient(x0), -np.sin(np.eye(3)[k] * x0))
        assert lines[k].get_ydata()[[0, -1]].tolist() == [x[0], x[-1]]
        for observed in (run.observed[name], stored.observed[f"o{k}"]):
            np.testing.assert_array_equal(observed, x - 0.25)
        crossings = np.count_nonzero(np.diff(np.sign(x)))
        assert len(run.events[name]) == len(stored.events[f"e{k}"]) == len(stored.events[f"d{k}"]) == crossings
        assert len(run.events[f"{name} - 0.25"]) == np.count_nonzero(np.diff(np.sign(x - 0.25)))
    np.testing.assert_array_equal(stored.x, run.x)
    assert sum(map(len, (run.events[name] for name in names))) > 0


def test_numbers_of_coordinates_are_names_where_no_other_coordinate_has_them():
    """x4 is the first coordinate gamma1 of a top, but no name where x0, x1, x2 or x2, x1, x3 are coordinates."""
    top = co.systems.heavy_top()
    run = co.integrate(top, X0, (0, 0.2), 0.1, co.GaussLegendre(2), events=co.Event("x4"))
    assert run.events.names == ("x4",)
    assert run.plot(["components"], components=["x4"]).axes[0].lines[0].get_ydata()[-1] == run.x[-1, 3]
    for basis, wrong in ((BASES[0], "x3"), (BASES[2], "x2")):
        system = so3(basis)
        with refused(ValueError, wrong, "x1"):
            so3(basis, f"x1^2 + {wrong}")
        with refused(ValueError, wrong):
            co.integrate(system, (1, 2, 3), (0, 1), 0.1, events=co.Event(wrong))
        with refused(ValueError, wrong):
            co.integrate(system, (1, 2, 3), (0, 1), 0.1).plot(components=[wrong])


SUM_OF_SQUARES = co.Polynomial("x1^2 + x2^2 + x3^2", dim=3)
PERMUTED = co.Polynomial("x1^2/2", basis=("x2", "x1", "x3"))


def test_names_of_texts_in_sums_and_of_systems_without_an_algebra():
    with refused(ValueError, "x2, x1, x3", "x1, x2, x3"):
        PERMUTED + SUM_OF_SQUARES
    assert (co.Polynomial("q", basis=("q", "p")) + co.Polynomial("x2", dim=2)).names == ("q", "p")
    J = co.systems.sklyanin().structure_function
    system = co.PoissonSystem(J, "x1^2/2 + x0", dim=4, name="sklyanin")
    np.testing.assert_array_equal(system.hamiltonian.gradient(np.ones(4)), [1.0, 1.0, 0.0, 0.0])
    with refused(ValueError, "x1", "basis"):
        co.PoissonSystem(J, co.Polynomial("x1^2", dim=4), name="sklyanin")


@pytest.mark.parametrize("basis", [BASES[0], ("e1", "e2", "e3"), ("h", "e7", "f")])
def test_basis_elements_name_their_coordinates_everywhere(basis, tmp_path, monkeypatch, capsys):
    """The coordinate of e0 is called x0, and e0 is the same one in formulas, polynomials, events and files."""
    monkeypatch.chdir(tmp_path)
    system, element = so3(basis), basis[1]
    names = names_of(system)
    assert names == tuple(name.replace("e", "x") for name in basis)
    for name in (element, names[1]):
        for text in (f"{name}^2/2", f"cos({name})"):
            for H in (text, co.formula(text, basis=basis), co.formula(text, basis=names)):
                assert np.flatnonzero(so3(basis, H).hamiltonian.gradient([0.4, 0.5, 0.6])).tolist() == [1]
        text = f"{name} - 0.25"
        observe = {"p": co.Polynomial(text, basis=basis), "f": co.formula(f"sin({name})", basis=basis)}
        events = [co.Event(name, name="one"), co.Event(co.Polynomial(name, basis=names), name="two")]
        run = co.integrate(system, (0.9, 0.7, -1.1), (0, 8), 0.05, observe=observe, events=events)
        np.testing.assert_array_equal(run.observed["p"], run.x[:, 1] - 0.25)
        np.testing.assert_allclose(run.observed["f"], np.sin(run.x[:, 1]), rtol=1e-15)
        assert len(run.events["one"]) == len(run.events["two"]) == np.count_nonzero(np.diff(np.sign(run.x[:, 1]))) > 0
        triples = [np.roll(basis, -k).tolist() for k in range(3)]
        stored = ConfigurationFiles(tmp_path, capsys).run(f"""
algebra = {{basis = {list(basis)}, brackets = {[f"[{a}, {b}] = {c}" for a, b, c in triples]}}}
hamiltonian = {{formula = "{basis[0]}^2/2 + {name}^2 + 2*{basis[2]}^2"}}
casimirs = {{own = "{" + ".join(f"{e}^2" for e in basis)}"}}
observe = {{p = "{text}"}}
initial = {{x = [0.9, 0.7, -1.1]}}
run = {{t_span = [0, 8], step = 0.05}}
events = {{one = {{g = "{name}"}}, two = {{g = "{name} - 0.0"}}}}""")
        np.testing.assert_array_equal(stored.observed["p"], run.observed["p"])
        assert len(stored.events["one"]) == len(stored.events["two"]) == len(run.events["one"])
    np.testing.assert_array_equal(
        so3(basis, integrals={"C": co.formula("+".join(f"{e}^2" for e in basis), basis=basis)})
        .integrals["C"]
        .gradient(np.ones(3)),
        2 * np.ones(3),
    )


def test_an_unknown_name_lists_the_known_ones():
    for refusal in (
        lambda: so3(BASES[0], "y^2"),
        lambda: co.Polynomial("y^2", basis=BASES[0]),
        lambda: co.formula("sin(y)", basis=names_of(so3(BASES[0]))),
        lambda: co.integrate(so3(BASES[0]), (1, 2, 3), (0, 1), 0.1, events=co.Event("y")),
    ):
        with refused(ValueError, "y", "1", "2"):
            refusal()
    with refused(ValueError, "'y', which is not a known name", "x1, x2", "parameters a"):
        co.formula("a*y", dim=2, parameters={"a": 1.0})
    with refused(ValueError, "e1, e0, e2"):  # e1 is the second element, not the first
        so3(BASES[0], co.Polynomial("e1^2", basis=("e1", "e0", "e2")))
    assert str(co.formula("e1*x1^2", dim=3, parameters={"e1": 7})) == "7*x1^2"  # parameters come first
