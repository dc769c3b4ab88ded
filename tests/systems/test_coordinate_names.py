"""Each coordinate has one name: in printed polynomials, descriptions, datasets, files and pictures."""

import pickle

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.configuration.construction import parse_polynomial
from coadjoint.files.records.stored_events import event_of_file, event_record
from coadjoint.systems.coordinates import coordinate_names
from coadjoint.systems.description import description

TOP = ("m1", "m2", "m3", "gamma1", "gamma2", "gamma3")
X0 = (0.1, 0.2, 0.3, 0.5, 0.1, 1.0)


def test_names_are_those_of_the_system_else_of_the_basis_else_x():
    top, body = co.systems.heavy_top(), co.systems.rigid_body()
    assert coordinate_names(top) == TOP == coordinate_names(top.with_forces(co.forces.LinearDamping(0.1)))
    assert coordinate_names(co.batch([top, top])) == TOP
    assert coordinate_names(body) == ("x1", "x2", "x3")
    own = co.LieAlgebra.from_brackets(["[h, e] = 2 e", "[h, f] = -2 f", "[e, f] = h"])
    assert coordinate_names(co.LiePoissonSystem(own, co.Quadratic(np.ones(3)))) == ("h", "e", "f")
    assert coordinate_names(co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), 2), co.Quadratic(np.ones(6))))[
        ::3
    ] == ("x1[1]", "x1[2]")


def test_everything_printed_of_a_system_has_its_names():
    top = co.systems.heavy_top()
    H = co.modified_hamiltonian(top, co.Splitting())
    field = co.modified_field(top, co.Splitting(), order=3)
    printed = [top.casimirs["m.p"], top.integrals, H, H.terms[2], H.error_term.term, field.terms[2]]
    printed += [co.Splitting().describe(top), top._repr_html_()]
    for text in map(str, printed[:1] + printed[2:]):
        assert "m1" in text and "gamma1" in text and "x1" not in text and "e1" not in text
    assert str(top.casimirs["m.p"]) == "m1*gamma1 + m2*gamma2 + m3*gamma3"
    assert top.casimirs["m.p"].to_latex().startswith(r"m_{1} \gamma_{1}")
    assert {str(symbol) for symbol in top.casimirs["m.p"].to_sympy().free_symbols} == set(TOP)
    sites = co.systems.spin_lattice()
    assert sites.casimirs["|x|^2 [1]"].to_latex() == "{S_{1}^{[1]}}^{2} + {S_{2}^{[1]}}^{2} + {S_{3}^{[1]}}^{2}"


@pytest.mark.parametrize("name", ["sklyanin", "vlasov_moments", "decorated_particles", "heavy_top", "toda"])
def test_descriptions_have_the_names_of_plots_and_datasets(name):
    system = co.systems.get(name)
    found = description(name)
    assert tuple(found["coordinates"]) == coordinate_names(system)
    for key, casimir in system.casimirs.items():
        if isinstance(casimir, co.Polynomial):
            assert casimir.names == coordinate_names(system) and str(casimir).startswith(found["casimirs"][key][:60])


def test_symbols_count_the_coordinates():
    """m1 is the symbol of the coefficient of x1^2/2, and would be a coordinate of a top."""
    H = co.modified_hamiltonian(co.systems.heavy_top(), co.Splitting(), symbols=["m1"])
    assert "x1" in str(H) and "gamma" not in str(H)


def test_datasets_have_coordinate_names():
    run = co.integrate(co.systems.heavy_top(), X0, (0, 1), 0.1)
    assert run.to_xarray()["component"].values.tolist() == list(TOP)


def test_polynomials_carry_names_through_arithmetic_and_are_equal_without():
    p = co.Polynomial("q^2 - p", basis=("q", "p"))
    plain = co.Polynomial("x1^2 - x2", dim=2)
    assert p == plain and hash(p) == hash(plain) and p.named(("x1", "x2")).names == ("x1", "x2")
    results = (p + plain, plain + p, -p, p * plain, p / 2, p**2, p.derivative(0), 3 - p, pickle.loads(pickle.dumps(p)))
    for result in results:
        assert result.names == ("q", "p")
    assert p.named(("a", "b")) is p.named(["a", "b"]) and p.named(("q", "p")) is p
    with pytest.raises(ValueError, match="names"):
        p.named(("q",))


def test_files_take_names_and_x1():
    top = co.systems.heavy_top()
    named, plain = (event_of_file("far", {"g": g}, top).g for g in ("m1^2 - 0.25*gamma3", "x1^2 - 0.25*x6"))
    assert named == plain == parse_polynomial([[1, [2, 0, 0, 0, 0, 0]], [-0.25, [0, 0, 0, 0, 0, 1]]], 6)
    assert event_of_file("m", {"g": "m2"}, top).g == "m2"
    with pytest.raises(ValueError, match="m1, m2"):
        parse_polynomial("m1 + y", 6, TOP)


def test_a_name_with_two_meanings_is_refused():
    """x1 is the second coordinate of `sklyanin`; polynomials in x1, x2, ... keep their meaning."""
    names = coordinate_names(co.systems.sklyanin())
    assert parse_polynomial("x1^2 - x4", 4, names) == co.Polynomial("x1^2 - x4", dim=4)
    with pytest.raises(ValueError, match="x1"):
        parse_polynomial("x0 + x1", 4, names)


@pytest.mark.parametrize("name", ["sklyanin", "heavy_top"])
def test_stored_events_are_read_back(name):
    system = co.systems.get(name)
    n = system.dim
    for g in (co.Polynomial.variable(1, n), co.Polynomial.variable(1, n).named(coordinate_names(system)) ** 2 - 1):
        text, missing = event_record([co.Event(g, name="mine")], ["mine"])
        from coadjoint.files.records.entries import Entry
        from coadjoint.files.records.stored_events import events_of

        (event,) = events_of(Entry(text, "events"), system)
        assert event.g == g and not missing
