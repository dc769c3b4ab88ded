"""Configuration files: systems, schemes, polynomials, brackets, and errors by key."""

import re
from fractions import Fraction

import numpy as np
import pytest
from configuration_files import OWN, READY_MADE

import coadjoint as co
from coadjoint.algebra.brackets import parse_brackets
from coadjoint.files.configuration.construction import parse_polynomial
from coadjoint.files.configuration.loading import ConfigurationError, load
from coadjoint.methods import registry


@pytest.fixture
def written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def write(text, *changes):
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "run.toml").write_text(text)
        return "run.toml"

    return write


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r", "mixed"])
def test_line_ends_are_normalized(tmp_path, end):
    """The stored text and the lines in errors are the same."""
    for text in (READY_MADE, f"{READY_MADE}wrong"):
        ends = ["\n", "\r\n", "\r"] if end == "mixed" else [end]
        lines = text.split("\n")
        joined = "".join(line + ends[k % len(ends)] for k, line in enumerate(lines[:-1])) + lines[-1]
        (tmp_path / "run.toml").write_bytes(joined.encode())
        if text == READY_MADE:
            assert load(tmp_path / "run.toml").text == READY_MADE
        else:
            with pytest.raises(ConfigurationError, match=f"line {len(lines)}, column 6: expected '=' after a key"):
                load(tmp_path / "run.toml")


def test_ready_made_system(written):
    found = load(written(READY_MADE))
    assert found.system.parameters == {"inertia": (1.0, 2.0, 2.5)}
    assert found.method == co.Splitting(order=4)
    assert (found.t_span, found.step, found.save_every, found.watch) == ((0.0, 1.0), 0.1, 1, True)
    by_hand = co.integrate(
        co.systems.rigid_body((1.0, 2.0, 2.5)), (1.0, 0.1, 0.5), (0.0, 1.0), 0.1, method=co.Splitting(order=4)
    )
    np.testing.assert_array_equal(found.integrate().x, by_hand.x)


def test_own_brackets_give_the_same_motion(written):
    own = load(written(OWN, ("0.25]", "0.4]")))
    assert own.system.algebra == co.algebras.so(3)
    assert (own.system.name, own.system.sign, list(own.system.casimirs)) == ("mine", -1, ["|x|^2"])
    body = co.systems.rigid_body((1.0, 2.0, 2.5))
    np.testing.assert_array_equal(own.integrate().x, co.integrate(body, (1.0, 0.1, 0.5), (0.0, 1.0), 0.1).x)


@pytest.mark.parametrize(
    "polynomial",
    [
        '"0.5*x1^2 + 0.25*x2^2 + 1/8*x3^2"',
        "[[0.5, [2, 0, 0]], [0.25, [0, 2, 0]], [0.125, [0, 0, 2]]]",
    ],
)
def test_polynomial_hamiltonian(written, polynomial):
    found = load(written(OWN, ("M = [1.0, 0.5, 0.25]", f"polynomial = {polynomial}")))
    assert found.system.energy([1.0, 2.0, 4.0]) == 3.5


def test_catalogue_attitude_ensemble_and_observed(written):
    text = """
    casimirs = {}
    algebra = {name = "A3,7", parameters = {a = 2.0}}
    hamiltonian = {M = 1.0, linear = [0.0, 0.0, 1.0]}
    initial = {x = [[1.0, 1.0, 1.0], [0.5, 0.0, 1.0]], attitude = "coadjoint"}
    run = {t_span = [0.0, 0.5], step = 0.1, watch = false, threads = 1, save_every = 2}
    observe = {height = "x3"}
    """
    sol = load(written(text)).integrate()
    assert sol.x.shape == (4, 2, 3) and sol.attitude.shape == (4, 2, 3, 3)
    assert sol.casimirs == {} and not sol.watched
    np.testing.assert_array_equal(sol.observed["height"], sol.x[..., 2])


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ([("step", "stpe")], "run.stpe: unknown key; did you mean 'step'?"),
        ([("[initial]", "[intial]")], "intial: unknown key; did you mean 'initial'?"),
        ([("[initial]", "[time]\nspan = [0.0, 1.0]\n[initial]")], "time: unknown key; known here: algebra, casimirs,"),
        ([("[initial]", "[nmae]\n[initial]")], "nmae: unknown key; known here: algebra, casimirs,"),
        ([("step = 0.1", "step = 0.1\nqqq = 1")], "run.qqq: unknown key; known here: accuracy, save_every, step,"),
        ([("step = 0.1", "")], "run: step is missing; give step, or accuracy to have it chosen"),
        ([("step = 0.1", 'step = "0.1"')], "run.step: must be a number, not '0.1'"),
        ([("step = 0.1", "step = -0.1")], "run.step: must be greater than 0.0, not -0.1"),
        ([("step = 0.1", "step = 0.1\nsave_every = 2.0")], "run.save_every: must be a whole number, not 2.0"),
        ([("step = 0.1", "step = 0.1\nsave_every = 0")], "run.save_every: must be 1 or more, not 0"),
        ([("step = 0.1", "step = 0.1\nwatch = 1")], "run.watch: must be true or false, not 1"),
        ([("step = 0.1", "step = 0.3")], "run: step 0.3 does not divide the time 1.0"),
        ([("[0, 1]", "[0, 1, 2]")], "run: t_span is [0, 1, 2]; it must be two numbers, the start and the end"),
        ([("[0, 1]", "[0, nan]")], "run.t_span: every number must be finite, and nan is not"),
        ([("x = [1.0, 0.1, 0.5]", "x = [1.0, 0.1]")], "initial.x: x0 has the shape (2,)"),
        ([("x = [1.0, 0.1, 0.5]", "x = [[1.0, 0.1, 0.5], [1.0]]")], "initial.x: must be a list of numbers or a list"),
        ([("0.5]", '0.5]\nattitude = "rotation"')], "initial.attitude: must be true, false, 'coadjoint' or a"),
        ([("0.5]", "0.5]\nattitude = [[1.0]]")], "initial.attitude: attitude has the shape (1, 1)"),
        ([('"rigid_body"', '"rigidbody"')], "system: unknown system 'rigidbody'; did you mean 'rigid_body'?"),
        ([("inertia =", "inertias =")], "system.parameters.inertias: unknown key; give [system.parameters] inertia"),
        ([("2.5]", "-2.5]")], "system: inertia[2] is -2.5; every principal moment must be positive"),
        ([("[system]", "sign = -1\n[system]")], "sign: belongs to [algebra]; the system 'rigid_body' has its own"),
        ([('"Splitting"', '"Spliting"')], "method: unknown method 'Spliting'; did you mean 'Splitting'?"),
        ([("order", "oder")], "method.oder: unknown key; did you mean 'order'?"),
        ([("order = 4", "order = 3")], "method: Splitting has the orders 1, 2, 4, 6, 8 and 10, not 3"),
        ([("order = 4", "parts = [[0, 1], [2]]")], "method: "),
        ([('name = "Splitting"', "")], "method: {'order': 4} is not a scheme; "),
        ([("step = 0.1", "step =")], "line 13, column 7: invalid value"),
        ([("step = 0.1", "step = [")], "line 14, column 1: invalid value"),
        ([("step = 0.1", "step = 0.1\nstep = 0.1")], "line 14, column 11: cannot overwrite a value"),
    ],
)
def test_errors_of_ready_made_systems_have_the_key(written, changes, expected):
    with pytest.raises(ConfigurationError) as error:
        load(written(READY_MADE, *changes)).integrate()
    message = str(error.value)
    assert "\n" not in message
    assert message.startswith(f"run.toml: {expected}")


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ([('"[e3, e1] = e2"', '"[e1, e3] = e1"')], "algebra.brackets: Jacobi identity violated for (e1, e2, e3)"),
        ([("[e3, e1] = e2", "[e3, e4] = e2")], "algebra.brackets: '[e3, e4] = e2' is not a bracket of e1, e2, e3; "),
        ([("[e3, e1] = e2", "[e2, e1] = e3")], "algebra.brackets: the bracket of e2 and e1 is given twice; "),
        ([("[e3, e1] = e2", "[e3, e1] = e2 e1")], "algebra.brackets: '[e3, e1] = e2 e1' cannot be parsed from 'e1'"),
        ([("dim = 3", 'dim = 2\nbasis = ["a", "b", "c"]')], "algebra.basis: has 3 names; dim is 2"),
        ([("dim = 3\n", "")], "algebra.dim: is missing; give it, or basis"),
        ([("brackets", "bracket")], "algebra.bracket: unknown key; did you mean 'brackets'?"),
        ([("dim = 3", "dim = 3\nparameters = {a = 1}")], "algebra.parameters: belongs to an algebra of the"),
        ([("sign = -1", "sign = 2")], "sign: must be 1 or -1, not 2"),
        ([("sign = -1", "sign = true")], "sign: must be 1 or -1, not True"),
        ([("[hamiltonian]\nM = [1.0, 0.5, 0.25]", "")], "hamiltonian: is missing; give it with [algebra]"),
        ([("M = [1.0, 0.5, 0.25]", "")], "hamiltonian.M: is missing; give M, linear or both, or formula"),
        ([("0.25]", '0.25]\npolynomial = "x1"')], "hamiltonian.M: is given with polynomial; include it there"),
        ([("M = [1.0, 0.5, 0.25]", "M = [1.0, 0.5]")], "hamiltonian: M has 2 entries; the algebra has dimension 3"),
        ([("M = [1.0, 0.5, 0.25]", "M = [[1, 2, 0], [0, 1, 0], [0, 0, 1]]")], "hamiltonian: M is not symmetric"),
        ([("M = [1.0, 0.5, 0.25]", "M = true")], "hamiltonian.M: must be a number or a list of numbers or "),
        ([("M = [1.0, 0.5, 0.25]", 'polynomial = "x1^^2"')], "hamiltonian.polynomial: 'x1^^2' cannot be parsed from"),
        ([("M = [1.0, 0.5, 0.25]", 'polynomial = "x4"')], "hamiltonian.polynomial: 'x4' has the coordinate x4; "),
        ([("M = [1.0, 0.5, 0.25]", "polynomial = 3")], "hamiltonian.polynomial: must be text such as "),
        ([("+ x3^2", "+ x3^3")], "casimirs: '|x|^2' is not a Casimir: "),
        ([("[run]", '[observe]\nspeed = "v1"\n[run]')], "observe.speed: 'v1' has 'v1', which is not a known name; "),
        ([("[algebra]", '[system]\nname = "rigid_body"\n[algebra]')], "give either [system], a ready-made one, or "),
    ],
)
def test_errors_of_own_algebras_have_the_key(written, changes, expected):
    with pytest.raises(ConfigurationError) as error:
        load(written(OWN, *changes))
    message = str(error.value)
    assert "\n" not in message
    assert message.startswith(f"run.toml: {expected}")


BY_MATRICES = (
    ("dim = 3\n", 'basis = ["a", "b", "c"]\n'),
    (
        'brackets = ["[e1, e2] = e3", "[e2, e3] = e1", "[e3, e1] = e2"]',
        "matrices = [[[0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]], "
        "[[0, -1, 0], [1, 0, 0], [0, 0, 0]]]",
    ),
    ('"x1^2 + x2^2 + x3^2"', '"a^2 + b^2 + c^2"'),
)


def test_an_algebra_by_its_matrices(written):
    found = load(written(OWN, *BY_MATRICES))
    assert found.system.algebra == co.algebras.so(3) and found.system.algebra.basis == ("a", "b", "c")
    assert np.array_equal(found.system.algebra.representation, co.algebras.so(3).representation)
    with_attitude = load(written(OWN, *BY_MATRICES, ("x = [1.0, 0.1, 0.5]", "x = [1.0, 0.1, 0.5]\nattitude = true")))
    assert with_attitude.integrate().attitude.shape[-2:] == (3, 3)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ([("[0, 1, 0]]", "[0, 1, 1]]")], "algebra.matrices: [a, b] is not in the span of the 3 matrices"),
        ([("[0, 1, 0]]", "[0, 1]]")], "algebra.matrices: "),
        ([("[0, 1, 0]]", '[0, 1, "x"]]')], "algebra.matrices"),
        ([("basis =", "dim = 4\nbasis =")], "algebra.dim: is 4, and there are 3 matrices"),
        ([('["a", "b", "c"]', '["a", "b"]')], "algebra.matrices: basis must have 3 names"),
        ([("matrices =", 'brackets = ["[a, b] = c"]\nmatrices =')], "algebra.matrices: is given with brackets"),
        ([("basis =", 'name = "so(3)"\nbasis =')], "algebra.name: is for an algebra of the catalogue; give it or m"),
    ],
)
def test_errors_of_matrices_have_the_key(written, changes, expected):
    with pytest.raises(ConfigurationError, match="^run.toml: " + re.escape(expected)):
        load(written(OWN, *BY_MATRICES, *changes))


def test_text_other_than_utf8_is_refused(tmp_path):
    (tmp_path / "run.toml").write_bytes(b"x = \xff")
    with pytest.raises(ConfigurationError, match=r"run.toml: .*UTF-8 \(byte 4\)"):
        load(tmp_path / "run.toml")


@pytest.mark.parametrize(
    "polynomial",
    [
        co.Polynomial({(2, 0, 0): 0.5, (0, 1, 1): -1}),
        co.Polynomial({(1, 0, 0): Fraction(-1, 3), (0, 0, 0): 1e-20, (0, 0, 4): 12}),
        co.Polynomial({}, dim=3),
    ],
    ids=repr,
)
def test_printed_polynomials_are_parsed(polynomial):
    assert parse_polynomial(repr(polynomial), 3) == polynomial


def test_whole_and_rational_coefficients_stay_exact():
    assert parse_polynomial("1/3*x1 + 2*x2*x1*3 - 0.5", 2) == co.Polynomial(
        {(1, 0): Fraction(1, 3), (1, 1): 6, (0, 0): -0.5}
    )


@pytest.mark.parametrize(
    "text", ["", "x1 +", "x1 x2", "x1^", "x1^-1", "x1^1.5", "2(x1 + x2)", "(1/3*x1", "1/0", "x0", "__import__('os')"]
)
def test_invalid_polynomials_are_refused(text):
    with pytest.raises(ValueError, match=r"cannot be parsed|divides by zero|x1 to x2|has the power|has the function"):
        parse_polynomial(text, 2)


@pytest.mark.parametrize("term", [[1.0, [2]], [1.0, 2], ["a", [1, 0]], [1.0, [1, -1]], 3])
def test_invalid_terms_are_refused(term):
    with pytest.raises((ValueError, TypeError), match=r"exponents|coefficient"):
        parse_polynomial([term], 2)


def test_forms_of_brackets_are_parsed():
    basis = ["e1", "e12", "e2"]
    assert parse_brackets(["[e1,e12]= -1/2*e12 + .5e2 + e12", "[ e1 , e2 ] = 0", "[e12, e2] = 2e1"], basis) == {
        (0, 1): {1: 0.5, 2: 0.5},
        (0, 2): {},
        (1, 2): {0: 2.0},
    }


def test_parameter_named_name(written):
    text = READY_MADE.replace(
        'name = "Splitting"\norder = 4', 'name = "ExplicitRungeKutta"\nparameters = {name = "runge2"}'
    )
    assert load(written(text)).method == co.ExplicitRungeKutta("runge2")
    with pytest.raises(ValueError, match="the parameter 'order' of Splitting is given twice"):
        registry.from_description({"name": "Splitting", "order": 2, "parameters": {"order": 4}})
    with pytest.raises(ValueError, match="Composition needs the parameter 'base'"):
        registry.get("Composition")
