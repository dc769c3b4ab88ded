"""Typical mistakes of new users, and the key words of the messages that answer them."""

import re

import numpy as np
import pytest

import coadjoint as co

BODY, X0, SO3 = co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1), co.algebras.so(3)
RUN = co.integrate(BODY, X0, (0, 1), 0.1)
SPAN = (0, 1)


def run(*args, **kwargs):
    return co.integrate(BODY, *args, **kwargs)


def full(**kwargs):
    return co.integrate(BODY, X0, SPAN, 0.1, **kwargs)


SYSTEM = co.LiePoissonSystem
E3 = co.algebras.e(3)
CUBE = co.LiePoissonSystem(SO3, co.Polynomial({(1, 1, 1): 1.0}))

# Calls and the beginnings of their messages.
MISTAKES = {
    # keywords of other libraries
    "dt": (lambda: run(X0, SPAN, dt=0.1), "integrate has no dt; give step=, the size of a step"),
    "h": (lambda: run(X0, SPAN, h=0.1), "integrate has no h; give step="),
    "max_step": (lambda: run(X0, SPAN, max_step=0.1), "integrate has no max_step; give step="),
    "y0": (lambda: run(y0=X0, t_span=SPAN, step=0.1), "integrate has no y0; give x0=, the initial momentum"),
    "tspan": (lambda: run(X0, tspan=SPAN, step=0.1), "integrate has no tspan; give t_span=, start and end"),
    "rtol": (
        lambda: full(rtol=1e-6),
        "integrate has no rtol: a step that is chosen by an estimate of the error would lose",
    ),
    "tol": (lambda: full(tol=1e-6), "integrate has no tol; give accuracy=, the required error of the momentum"),
    "dense_output": (lambda: full(dense_output=True), "integrate has no dense_output; it needs none: sol.at(t) has"),
    "n_jobs": (lambda: full(n_jobs=4), "integrate has no n_jobs; give threads="),
    "solver": (lambda: full(solver="rk4"), "integrate has no solver; give method=, such as Splitting(order=4)"),
    "verbose": (lambda: full(verbose=1), "integrate has no verbose; give progress=True"),
    "saveat": (lambda: full(saveat=[0.5]), "integrate has no saveat; give t_eval=, the times at which states are"),
    "workers": (
        lambda: full(workers=2),
        "integrate has no workers; give threads=, or processes to co.integrate_ensemble(",
    ),
    "misspelt": (lambda: full(save_evry=2), "integrate has no save_evry; did you mean save_every=?"),
    "choose with tol": (lambda: co.choose(BODY, X0, SPAN, tol=1e-8), "choose has no tol; give accuracy="),
    "prepare with dt": (lambda: co.prepare(BODY, co.Splitting(), dt=0.1), "prepare has no dt; give step="),
    "inertia as I": (lambda: co.systems.rigid_body(I=(1, 2, 3)), "rigid_body has no I; give inertia=, the principal"),
    "moments one by one": (
        lambda: co.systems.rigid_body(1, 2, 3),
        "rigid_body was given 3 arguments, and takes inertia; give several values as one, inertia=(1, 2, 3)",
    ),
    "a row for each spin": (
        lambda: co.integrate(co.systems.spin_lattice("ring", 4), np.ones((4, 3)), SPAN, 0.1),
        "x0 has the shape (4, 3); it must be (12,) or (members, 12); np.ravel(x0) makes one state of its numbers",
    ),
    "an event as text": (lambda: full(events="x2"), "events is 'x2'; give an Event, such as co.Event('x2'), or a list"),
    "a polynomial as an event": (
        lambda: full(events=co.Event("x2^2 - 0.1")),
        "the event x2^2 - 0.1 is 'x2^2 - 0.1', which is no coordinate; give a polynomial, "
        "co.Polynomial('x2^2 - 0.1', basis=('x1', 'x2', 'x3'))",
    ),
    "su3": (lambda: co.algebras.get("su3"), "unknown algebra 'su3'; did you mean 'su(3)'?"),
    "so_4": (lambda: co.algebras.get("so_4"), "unknown algebra 'so_4'; did you mean 'so(4)'?"),
    "a file as an archive": (lambda: co.resume(__file__), f"{__file__}: is a file; an archive is a folder"),
    "order of Gauss": (lambda: co.GaussLegendre(order=4), "GaussLegendre has no order; it takes stages"),
    # algebras and attitudes
    "names as indices": (
        lambda: co.LieAlgebra([("D", "H", "H", 2.0)]),
        "structure constants use indices from 0; give brackets by names to LieAlgebra.from_brackets",
    ),
    "brackets without a dimension": (
        lambda: co.LieAlgebra.from_brackets({("D", "H"): {"H": 2}}),
        "brackets is {('D', 'H'): {'H': 2}}; give lines such as '[h, e] = 2 e', or first the dimension, as in",
    ),
    "an attitude that is no rotation": (
        lambda: full(attitude=2 * np.eye(3)),
        "attitude is no element of the group of rigid_body: it is not orthogonal: g^T g differs from the unit",
    ),
    # schemes
    "an adaptive scheme": (
        lambda: full(method="RK45"),
        "RK45 chooses each step by an estimate of the error, and so loses",
    ),
    "a scheme misspelt": (lambda: full(method="Spliting"), "unknown method 'Spliting'; did you mean 'Splitting'?"),
    "a class": (lambda: full(method=co.Splitting), "method is the class Splitting; give a scheme, such as Splitting()"),
    "an odd order": (lambda: co.Splitting(order=3), "Splitting has the orders 1, 2, 4, 6, 8 and 10, not 3"),
    "order as text": (lambda: co.Splitting(order="4"), "order is '4'; it must be a number"),
    "no stage": (lambda: co.GaussLegendre(0), "stages of GaussLegendre must be a whole number from 1 up, not 0"),
    "coupled functions": (
        lambda: co.Splitting().properties(CUBE),
        "Splitting cannot be used for Lie-Poisson system on so(3): its monomial x1*x2*x3 couples x1 and x2, which do "
        "not",
    ),
    "matrices for a vector": (
        lambda: full(method=co.IsospectralGauss()),
        "IsospectralGauss integrates matrices, but rigid_body is no MatrixSystem; take Splitting or GaussLegendre",
    ),
    # times and steps
    "no step": (lambda: run(X0, SPAN), "integrate was given neither of step and accuracy; give step=, or accuracy="),
    "both": (lambda: full(accuracy=1e-8), "integrate was given both of step and accuracy; give step=, or accuracy="),
    "a step that does not fit": (
        lambda: run(X0, SPAN, 0.3),
        "step 0.3 does not divide the time 1.0; the nearest steps that do are 0.25 and 0.333",
    ),
    "a negative step": (lambda: run(X0, SPAN, -0.1), "step is -0.1; it must be positive (the direction comes from"),
    "one time": (lambda: run(X0, 10, 0.1), "t_span is 10; it must be two numbers, the start and the end"),
    "accuracy zero": (lambda: run(X0, SPAN, accuracy=0), "accuracy is 0; it must lie between 0 and 1, such as 1e-6"),
    "save_every half": (lambda: full(save_every=2.5), "save_every must be a whole number from 1 up, not 2.5"),
    "t_eval a number": (lambda: full(t_eval=10), "t_eval has the shape (); it must be a row of times, at least one"),
    "after the end": (lambda: RUN.at(2.0), "t is 2; it must lie within the run, from 0 to 1"),
    # states
    "two of three": (lambda: run((1, 2), SPAN, 0.1), "x0 has the shape (2,); it must be (3,) or (members, 3)"),
    "text": (lambda: run("abc", SPAN, 0.1), "x0 is 'abc'; it must be an array of real numbers, all rows of the same"),
    "NaN": (lambda: run((1, 2, np.nan), SPAN, 0.1), "x0 contains NaN or infinity; every component must be finite"),
    "states of another size": (
        lambda: BODY.energy(np.ones((4, 2))),
        "x has shape (4, 2); a point of this system has shape (3,), many have (k, 3)",
    ),
    # observables and attributes
    "a function, no mapping": (
        lambda: full(observe=lambda x: x[0]),
        "observe is a lambda; it must map names to Polynomials or functions of x",
    ),
    "an index beyond": (
        lambda: full(observe={"a": np.linalg.norm, "seventh": lambda x: x[7]}),
        "observe['seventh'] cannot be evaluated at the start: index 7 is out of bounds for axis 0 with size 3",
    ),
    "a part of the state": (
        lambda: full(observe={"a": lambda x: x[:2]}),
        "observe['a'] returns array([1. , 0.2]) at the start; it must return one real number",
    ),
    "quaternions": (
        lambda: full(attitude="quaternion"),
        "attitude is 'quaternion'; it must be True, False, 'coadjoint' or an initial group element",
    ),
    "sol.y": (lambda: RUN.y, "a Solution has no attribute 'y'; here it is x"),
    "sol.sol": (lambda: RUN.sol, "a Solution has no attribute 'sol'; here it is at(t), the states at any times"),
    "sol.enregy": (lambda: RUN.enregy, "a Solution has no attribute 'enregy'; did you mean 'energy'?"),
    "a panel": (lambda: RUN.plot("orbits"), "unknown kind of picture 'orbits'; here it is 'coadjoint orbit'"),
    # systems
    "an algebra for a system": (
        lambda: co.integrate(SO3, X0, SPAN, 0.1),
        "system is LieAlgebra('so(3)', dim=3: [e1, e2] = e3, [e1, e3] = -e2, [e2, e3] = e1); it must be a Lie",
    ),
    "a system not made": (
        lambda: co.integrate(co.systems.rigid_body, X0, SPAN, 0.1),
        "system is the function rigid_body; it must be a LiePoissonSystem or a PoissonSystem",
    ),
    "no such system": (
        lambda: co.systems.heavi_top,
        "co.systems has no attribute 'heavi_top'; did you mean 'heavy_top'?",
    ),
    "no such system by name": (lambda: co.systems.get("frisbee"), "unknown system 'frisbee'; there are: clebsch_body,"),
    "no such algebra": (lambda: co.algebras.get("SO(3)"), "unknown algebra 'SO(3)'; did you mean 'so(3)'?"),
    "a scheme among methods": (
        lambda: co.methods.Splitting,
        "co.methods has no attribute 'Splitting'; it is co.Splitting",
    ),
    "a name for an algebra": (
        lambda: SYSTEM("so(3)", co.Quadratic([1, 2, 3])),
        "algebra is a str; give a LieAlgebra, such as co.algebras.so(3)",
    ),
    "an array for H": (
        lambda: SYSTEM(SO3, np.eye(3)),
        "the Hamiltonian is a ndarray; give a Quadratic, Polynomial, Separable, SplitHamiltonian or Hamiltonian, a "
        "function of x, or the text of a formula",
    ),
    "a text for Hamiltonian": (
        lambda: co.Hamiltonian("cos(x1)"),
        "value is the text 'cos(x1)'; give co.formula(text, dim), or the text to the system",
    ),
    "M too short": (lambda: SYSTEM(E3, co.Quadratic([1, 2, 3])), "M has 3 entries; e(3) has dimension 6; give 6"),
    "linear too long": (
        lambda: co.Quadratic([1, 2, 3], linear=[1] * 6),
        "M has 3 entries and linear has 6; give both one for each coordinate of the system",
    ),
    "M not symmetric": (
        lambda: co.Quadratic([[1, 2], [3, 4]]),
        "M is not symmetric: M[0, 1] = 2 but M[1, 0] = 3; give both the same value",
    ),
    "a formula of how many": (
        lambda: co.Polynomial("x1^2"),
        "'x1^2' does not determine the number of coordinates; give dim= or basis=",
    ),
    "a formula without signs of products": (
        lambda: co.Polynomial("0.5 x1^2", dim=3),
        "'0.5 x1^2' cannot be parsed from 'x1^2' on; write numbers, coordinates, parameters and operations on them, "
        "such as 0.5*x1^2 - x2*(x3 + 1)/3",
    ),
    "a wrong gradient": (
        lambda: SYSTEM(SO3, co.Hamiltonian(lambda x: x[0] ** 2, lambda x: np.array([x[0], 0, 0]))),
        "gradient contradicts value: along a sample direction it gives",
    ),
    "no Casimir": (
        lambda: SYSTEM(SO3, co.Quadratic(1), casimirs={"c": co.Polynomial({(1, 0, 0): 1.0})}),
        "'c' is not a Casimir: component 1 of J(x) grad C(x) is",
    ),
    "200 functions": (
        lambda: co.integrate([lambda x: x] * 200, X0, SPAN, 0.1),
        "system is 200 functions; it must be a LiePoissonSystem or a PoissonSystem, such as co.systems.rigid_body()",
    ),
    "a moment below zero": (
        lambda: co.systems.rigid_body((1, -2, 3)),
        "inertia[1] is -2; every principal moment must be positive",
    ),
    "a number as a force": (
        lambda: BODY.with_forces(0.1),
        "a force is 0.1; it must be one of co.forces, such as LinearDamping(0.1)",
    ),
    # algebras
    "indices from 1": (
        lambda: co.LieAlgebra.from_brackets(3, {(1, 2): {3: 1.0}, (2, 3): {1: 1.0}, (3, 1): {2: 1.0}}),
        "brackets use indices from 0, and these go from 1 to 3; subtract 1 from each",
    ),
    "names without a basis": (
        lambda: co.LieAlgebra.from_brackets(3, {("D", "H"): {"H": 1.0}}),
        "brackets name 'D', which is not in the basis ('e1', 'e2', 'e3'); give basis=",
    ),
    "no Jacobi identity": (
        lambda: co.LieAlgebra.from_brackets(3, {(0, 1): {1: 1.0}, (1, 2): {0: 1.0}}),
        "Jacobi identity violated for (e1, e2, e3) = indices (0, 1, 2): defect 1 in component e1",
    ),
    "a parameter left out": (
        lambda: co.algebras.get("A3_7"),
        "algebra 'A3_7' needs the parameter 'a', as in get('A3_7', a=...)",
    ),
}


def test_number_of_mistakes():
    assert len(MISTAKES) >= 58


@pytest.mark.parametrize("name", MISTAKES)
def test_message_answers_the_mistake(name):
    make, expected = MISTAKES[name]
    with pytest.raises((TypeError, ValueError, IndexError, AttributeError)) as caught:
        make()
    message = str(caught.value)
    assert message.startswith(expected), message
    # One short line, without addresses of objects.
    assert "\n" not in message and " at 0x" not in message
    assert len(message) < 700
    assert not re.search(r"unexpected keyword|positional argument|NoneType", message)


def test_no_ravel_hint_for_several_states():
    with pytest.raises(ValueError, match=r"must be \(3,\) or \(members, 3\)$"):
        run(np.ones((3, 1, 3)), SPAN, 0.1)


def test_algebras_from_names_and_lines():
    names = co.LieAlgebra.from_brackets(
        3, {("h", "e"): {"e": 2}, ("h", "f"): {"f": -2}, ("e", "f"): {"h": 1}}, basis=("h", "e", "f")
    )
    lines = co.LieAlgebra.from_brackets(["[h, e] = 2 e", "[h, f] = -2 f", "[e, f] = h"])
    arguments = co.LieAlgebra.from_brackets(3, ["[h, e] = 2 e", "[h, f] = -2 f", "[e, f] = h"], basis=("e", "h", "f"))
    assert names == lines and lines.basis == ("h", "e", "f")
    assert arguments.basis == ("e", "h", "f") and arguments != lines
    assert arguments.casimirs()["C2"].degree == lines.casimirs()["C2"].degree == 2


@pytest.mark.parametrize(
    "arguments", ["Splitting", {"name": "Splitting", "order": 2}, {"name": "Splitting", "parameters": {"order": 2}}]
)
def test_schemes_by_name_or_mapping(arguments):
    for sol in (full(method=arguments), co.prepare(BODY, arguments, 0.1).run(X0, SPAN)):
        assert sol.method == co.Splitting() and (sol.x == RUN.x).all()
    assert (co.stepper(BODY, arguments, 0.1)(X0) == RUN.x[1]).all()
    assert full(method={"name": "Splitting", "order": 4}).method == co.Splitting(order=4)
    assert co.integrate(BODY, X0, SPAN, 0.1, "rk4").method == co.ExplicitRungeKutta("rk4")


def test_missing_polynomial_casimirs_are_explained():
    found = co.algebras.get("A3_7", a=0.5).casimirs()
    assert found == {} and not found
    assert repr(found) == (
        "{} (no polynomial up to degree 4; of Casimirs of any kind there is 1; casimirs_known has: log C)"
    )
    assert "no Casimir of any kind" in repr(co.algebras.get("A2_1").casimirs())
    assert repr(SO3.casimirs()) == "{'C2': x1^2 + x2^2 + x3^2}"


def test_broken_solution_raises_attribute_error():
    prepared = co.prepare(BODY, None, 0.1)
    prepared.run(X0, SPAN)  # the check of its step reads the times
    broken = prepared.run(X0, SPAN)
    del broken.record.__dict__["times"]
    with pytest.raises(AttributeError, match="times"):
        _ = broken.t
    assert not hasattr(RUN, "_ipython_display_") and not hasattr(RUN, "__array__")


def test_help_and_message_of_tolerances_agree():
    with pytest.raises(TypeError) as refused:
        full(rtol=1e-6, atol=1e-9)
    help_of_tolerances = re.search(r"rtol, atol : None\n(.*?)\n\n", co.integrate.__doc__, re.DOTALL)[1]
    for words in ("accuracy", "Taylor(tolerance=...)", "ReversibleSteps(Splitting(...))", "chosen by an estimate"):
        assert words in str(refused.value) and words in " ".join(help_of_tolerances.split())
