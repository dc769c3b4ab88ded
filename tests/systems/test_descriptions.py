"""Descriptions of ready-made systems, and the names of coordinates in all that is printed."""

import inspect
import json
import pickle
import re

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.configuration.construction import parse_polynomial
from coadjoint.files.records.stored_events import event_of_file, event_record
from coadjoint.systems.coordinates import coordinate_names
from coadjoint.systems.description import MAX_FORMULA_LENGTH, description
from coadjoint.systems.registry import gallery_entry_of, ready_made_systems

NAMES = co.systems.names()


def value_of(formula, names, x):
    """Evaluate a formula in named coordinates; any other word in it is an error."""
    longest_first = sorted(range(len(names)), key=lambda k: -len(names[k]))
    pattern = "|".join(re.escape(names[k]) for k in longest_first)
    places = {name: k for k, name in enumerate(names)}
    # A name that ends with a digit must not be followed by another one.
    code = re.sub(rf"({pattern})(?!\d)", lambda found: f"x[{places[found[1]]}]", formula).replace("^", "**")
    return eval(code, {"__builtins__": {}}, {"x": x})


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", NAMES)
def test_formulas_are_those_of_the_system(name):
    system, found = co.systems.get(name), description(name)
    names = found["coordinates"]
    assert len(names) == len(set(names)) == system.dim == found["dimension"]
    x = np.cos(1.0 + np.arange(system.dim))
    for kind in ("casimirs", "integrals"):
        known = getattr(system, kind, {})
        assert list(found[kind]) == list(known)
        for key, formula in found[kind].items():
            F = known[key]
            polynomial = isinstance(F, co.Polynomial) or (isinstance(F, co.Quadratic) and F.dim <= 64)
            assert (formula is not None) == polynomial, key
            if formula is not None and formula.endswith("..."):
                # Cut between two terms or signs, as late as possible.
                text = str(F.to_polynomial() if hasattr(F, "to_polynomial") else F)
                whole = re.sub(r"x(\d+)", lambda found, names=names: names[int(found[1]) - 1], text)
                cut = formula[:-3]
                assert whole.startswith(cut + " ") and len(cut) <= MAX_FORMULA_LENGTH
                assert len(cut) + len(whole[len(cut) :].split()[0]) >= MAX_FORMULA_LENGTH - 1
            elif formula is not None:
                wanted = float(getattr(F, "value", F)(x))
                # Sums of at most some hundred products of numbers below one, with coefficients of six digits.
                assert value_of(formula, names, x) == pytest.approx(wanted, rel=1e-4, abs=1e-4), (key, formula)


def assert_sections_are_those_of_the_docstring(made, found):
    """The words of each section in order, from the first line below its heading to the next heading."""
    lines = inspect.getdoc(made).splitlines()
    headings = [k for k in range(len(lines) - 1) if lines[k] and set(lines[k + 1]) == {"-"}]

    def section(heading):
        (start,) = [k for k in headings if lines[k] == heading] or [len(lines)]
        return lines[start + 2 : min([k for k in headings if k > start], default=len(lines))]

    def words(text):
        return " ".join(text).replace("`", "").split()

    summary = lines[: lines.index("")]
    assert found["summary"].split() == words(summary)
    assert words(found["equations"]) == words(lines[lines.index("") : headings[0]])
    # The first line of Returns names the type.
    assert found["state"].split() == words(section("Returns")[1:])
    assert found["source"].split() == words(section("Notes"))
    documented, names = {}, []
    for line in section("Parameters"):
        if line.startswith(" "):
            for name in names:
                documented[name]["meaning"] += words([line])
        elif line:
            names = [name.strip() for name in line.partition(" : ")[0].split(",")]
            documented.update({name: {"kind": line.partition(" : ")[2], "meaning": []} for name in names})
    for key, value in found["parameters"].items():
        assert {"kind": value["kind"], "meaning": value["meaning"].split()} == documented[key], key


@pytest.mark.parametrize("name", NAMES)
def test_what_it_says_of_the_system(name):
    system, found = co.systems.get(name), description(name)
    assert json.loads(json.dumps(found)) == found
    assert found["name"] == name and found["sign"] == system.sign
    assert found["exact"] == (system.closed_form is not None)
    signature = inspect.signature(ready_made_systems()[name]).parameters
    assert list(found["parameters"]) == list(signature)
    for key, told in found["parameters"].items():
        assert told["kind"] and told["meaning"], key
        default = np.asarray(signature[key].default, dtype=object)
        assert np.array_equal(np.asarray(told["default"], dtype=object), default)
    assert found["summary"].endswith(".") and "`" not in found["summary"]
    assert_sections_are_those_of_the_docstring(ready_made_systems()[name], found)
    gallery_entry = gallery_entry_of(name)
    assert found["gallery"] == {
        "caption": gallery_entry.caption,
        "t_span": list(gallery_entry.t_span),
        "step": gallery_entry.step,
    }
    assert found["coordinates"] == list(coordinate_names(system))
    if system.algebra is None:
        assert found["algebra"] is None and found["attitude"] == "none"
    elif hasattr(system.algebra, "triples"):
        assert found["attitude"] == ("coadjoint" if system.representation is None else "representation")
        x = np.random.default_rng(2).standard_normal(system.dim)
        assert found["rank"] == np.linalg.matrix_rank(system.structure_matrix(x), tol=1e-9)
    else:
        assert found["attitude"] == "matrices"


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
