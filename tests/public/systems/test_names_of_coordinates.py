"""Names of coordinates in all that is printed, in datasets, polynomials and configuration files."""

import pickle

import numpy as np
import pytest

import coadjoint as co
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


def test_symbols_count_the_coordinates():
    """m1 is the symbol of the coefficient of x1^2/2, and would be a coordinate of a top."""
    H = co.modified_hamiltonian(co.systems.heavy_top(), co.Splitting(), symbols=["m1"])
    assert "x1" in str(H) and "gamma" not in str(H)


def test_polynomials_carry_names_through_arithmetic_and_are_equal_without():
    p = co.Polynomial("q^2 - p", basis=("q", "p"))
    plain = co.Polynomial("x1^2 - x2", dim=2)
    assert p == plain and hash(p) == hash(plain) and p.named(("x1", "x2")).names == ("x1", "x2")
    results = (p + plain, plain + p, -p, p * plain, p / 2, p**2, p.derivative(0), 3 - p, pickle.loads(pickle.dumps(p)))
    for result in results:
        assert result.names == ("q", "p")
    assert p.named(("a", "b")) is p.named(["a", "b"]) and p.named(("q", "p")) is p


@pytest.mark.parametrize(("name", "formula"), [("heavy_top", "m1^2 - 0.25*gamma3"), ("sklyanin", "x1^2 - 0.25*x3")])
def test_events_of_polynomials_are_stored_with_their_names(name, formula):
    """In the names of the system; x1 is the second coordinate of `sklyanin`."""
    system = co.systems.get(name)
    g = co.Polynomial(formula, basis=TOP if name == "heavy_top" else ("x0", "x1", "x2", "x3"))
    plain = co.Polynomial(g.monomials, dim=system.dim)
    events = [co.Event(g, name="named"), co.Event(plain, name="plain")]
    x0 = X0 if name == "heavy_top" else (0.9, 0.7, -1.1, 0.4)
    sol = co.integrate(system, x0, (0, 1), 0.1, co.GaussLegendre(2), events=events)
    stored = co.results.solution_inputs(sol.to_xarray())["events"]
    assert [event.g for event in stored] == [g, plain] == [g, g]


def test_polynomials_of_names_that_are_not_those_of_the_system_are_refused():
    with refused(ValueError, "m1, m2"):
        co.Polynomial("m1 + y", basis=TOP)
    with refused(ValueError, "names"):
        co.Polynomial("q", basis=("q", "p")).named(("q",))
