"""Typical mistakes of new users, and what the messages that answer them name."""

import re

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

pytestmark = pytest.mark.thinned(1)

BODY, X0, SPAN, SO3 = co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1), (0, 1), co.algebras.so(3)
RUN = co.integrate(BODY, X0, SPAN, 0.1)
TODA = co.integrate(co.systems.toda(2), np.array([1.0, -1.0, 0.5]), SPAN, 0.1)
SPUN = co.integrate(co.systems.body(), co.systems.body().state(), SPAN, 0.1)
COADJOINT = co.integrate(co.systems.kirchhoff_body(), np.ones(6), SPAN, 0.1, attitude="coadjoint")
CUBE = co.LiePoissonSystem(SO3, co.Polynomial({(5, 1, 1): 1.0}))


class Tensor:
    """As torch.tensor(..., requires_grad=True), which NumPy refuses to convert."""

    requires_grad = True

    def __array__(self, *_, **__):
        raise RuntimeError("Can't call numpy() on Tensor that requires grad.")


def helper(y):
    return y.__float__()


def run(*args, **kwargs):
    return co.integrate(BODY, *args, **kwargs)


def full(**kwargs):
    return co.integrate(BODY, X0, SPAN, 0.1, **kwargs)


def with_energy(H, **more):
    return co.LiePoissonSystem(SO3, H, **more)


MISTAKES = {
    # keywords of other libraries
    "dt": (lambda: run(X0, SPAN, dt=0.1), "dt", "step="),
    "max_step": (lambda: run(X0, SPAN, max_step=0.1), "max_step", "step="),
    "y0": (lambda: run(y0=X0, t_span=SPAN, step=0.1), "y0", "x0="),
    "tspan": (lambda: run(X0, tspan=SPAN, step=0.1), "tspan", "t_span="),
    "rtol": (lambda: full(rtol=1e-6), "rtol", "accuracy", "Taylor(tolerance=...)", "ReversibleSteps"),
    "atol": (lambda: full(atol=1e-6), "integrate", "atol", "accuracy="),
    "tol": (lambda: full(tol=1e-6), "tol", "accuracy="),
    "dense_output": (lambda: full(dense_output=True), "dense_output", "sol.at(t)"),
    "n_jobs": (lambda: full(n_jobs=4), "n_jobs", "threads="),
    "solver": (lambda: full(solver="rk4"), "solver", "method="),
    "verbose": (lambda: full(verbose=1), "verbose", "progress=True"),
    "saveat": (lambda: full(saveat=[0.5]), "saveat", "t_eval="),
    "workers": (lambda: full(workers=2), "workers", "co.integrate_ensemble("),
    "misspelt": (lambda: full(save_evry=2), "save_evry", "save_every="),
    "inertia as I": (lambda: co.systems.rigid_body(I=(1, 2, 3)), "I;", "inertia="),
    "order of Gauss": (lambda: co.GaussLegendre(order=4), "order", "stages"),
    "moments one by one": (lambda: co.systems.rigid_body(1, 2, 3), "3 arguments", "inertia=(1, 2, 3)"),
    # states, times and steps
    "a row for each spin": (
        lambda: co.integrate(co.systems.spin_lattice("ring", 4), np.ones((4, 3)), SPAN, 0.1),
        "x0",
        "(4, 3)",
        "np.ravel(x0)",
    ),
    "no step": (lambda: run(X0, SPAN), "step", "accuracy="),
    "both": (lambda: full(accuracy=1e-8), "step", "accuracy="),
    "a negative step": (lambda: run(X0, SPAN, -0.1), "step", "-0.1", "direction"),
    "after the end": (lambda: RUN.at(2.0), "t is 2", "from 0 to 1"),
    # schemes
    "an adaptive scheme": (lambda: full(method="RK45"), "RK45", "estimate of the error"),
    "coupled functions": (lambda: co.Splitting().properties(CUBE), "Splitting", "x1^5*x2*x3", "x1 and x2"),
    "matrices for a vector": (lambda: full(method=co.IsospectralGauss()), "IsospectralGauss", "rigid_body"),
    # events and observables
    "an event as text": (lambda: full(events="x2"), "events", "x2", "co.Event('x2')"),
    "a polynomial as an event": (lambda: full(events=co.Event("x2^2 - 0.1")), "x2^2 - 0.1", "co.Polynomial("),
    "an index beyond": (lambda: full(observe={"seventh": lambda x: x[7]}), "observe['seventh']", "index 7"),
    "no rotation": (lambda: full(attitude=2 * np.eye(3)), "attitude", "rigid_body", "orthogonal"),
    # names
    "su3": (lambda: co.algebras.get("su3"), "su3", "'su(3)'"),
    "SO(3)": (lambda: co.algebras.get("SO(3)"), "SO(3)", "'so(3)'"),
    "a plural": (lambda: co.systems.get("rigid_bodies"), "rigid_bodies", "rigid_body"),
    "no such system": (lambda: co.systems.heavi_top, "heavi_top", "'heavy_top'"),
    "a scheme among methods": (lambda: co.methods.Splitting, "Splitting", "co.Splitting"),
    "a long name": (lambda: co.systems.get("x" * 10**6), "xxx", "clebsch_body"),
    "sol.y": (lambda: RUN.y, "'y'", "x"),
    "sol.sol": (lambda: RUN.sol, "'sol'", "at(t)"),
    "sol.enregy": (lambda: RUN.enregy, "enregy", "'energy'"),
    "no rotation of a run": (lambda: RUN.rotation, "rigid_body", "attitude=True"),
    "an attitude in the state": (lambda: co.frequencies(SPUN, "attitude", 1), "body", "sol.rotation"),
    "no angular velocity": (lambda: TODA.angular_velocity, "toda", "angular velocity", "co.systems.body"),
    "coadjoint matrices as rotations": (lambda: COADJOINT.rotation, "coadjoint", "attitude=True"),
    "a panel": (lambda: RUN.plot("orbits"), "orbits", "'coadjoint orbit'"),
    "a parameter left out": (lambda: co.algebras.get("A3_7"), "A3_7", "'a'"),
    # systems and algebras
    "a system not made": (lambda: co.integrate(co.systems.rigid_body, X0, SPAN, 0.1), "system", "rigid_body"),
    "a name for an algebra": (lambda: co.LiePoissonSystem("so(3)", co.Quadratic(1)), "algebra", "co.algebras.so(3)"),
    "an array for H": (lambda: with_energy(np.eye(3)), "Hamiltonian", "ndarray", "Quadratic"),
    "M too short": (lambda: with_energy(co.Quadratic([1, 2])), "M", "2", "so(3)"),
    "linear too long": (lambda: co.Quadratic([1, 2, 3], linear=[1] * 6), "M", "linear", "6"),
    "a formula of how many": (lambda: co.Polynomial("x1^2"), "x1^2", "dim="),
    "a formula that ends with a power": (lambda: co.Polynomial("0.5*x1^^2"), "0.5*x1^^2", "'^2'"),
    "a random field of which": (lambda: co.systems.sphere_euler(N=4).random(), "random", "seed"),
    "a modified field at two numbers": (
        lambda: co.modified_field(BODY, "Splitting", 3).values((1.0, 2.0)),
        "(2,)",
        "(3,)",
    ),
    "no signs of products": (lambda: co.Polynomial("0.5 x1^2", dim=3), "0.5 x1^2", "x1^2"),
    "a wrong gradient": (
        lambda: with_energy(co.Hamiltonian(lambda x: x[0] ** 2, lambda x: np.array([x[0], 0, 0]))),
        "gradient",
        "value",
    ),
    "a number as a force": (lambda: BODY.with_forces(0.1), "force", "0.1", "LinearDamping"),
    "names as indices": (lambda: co.LieAlgebra([("D", "H", "H", 2.0)]), "indices", "LieAlgebra.from_brackets"),
    "indices from 1": (lambda: co.LieAlgebra.from_brackets(3, {(1, 2): {3: 1.0}}), "brackets", "indices from 0"),
    "names without a basis": (lambda: co.LieAlgebra.from_brackets(3, {("D", "H"): {"H": 1.0}}), "'D'", "basis="),
    "no Jacobi identity": (
        lambda: co.LieAlgebra.from_brackets(3, {(0, 1): {1: 1.0}, (1, 2): {0: 1.0}}),
        "Jacobi",
        "(0, 1, 2)",
    ),
    "an energy that is a vector": (lambda: with_energy(lambda x: x), "shape (3,)", "one number"),
    "an energy that is nothing": (lambda: with_energy(lambda x: None), "None", "one number"),
    "an energy that is a comparison": (lambda: with_energy(lambda x: x[0] > 0), "truth value", "one number"),
    "a comparison with a gradient": (lambda: with_energy(co.Hamiltonian(lambda x: x[0] > 0, np.ones_like)), "truth"),
    "a line that Numba refuses": (
        lambda: full(events=co.Event(lambda x: helper(x[0]))),
        f"line {helper.__code__.co_firstlineno + 1} of test_mistakes.py: return y.__float__()",
    ),
    "a tensor with gradients": (lambda: run(Tensor(), SPAN, 0.1), "x0", "requires_grad", "co.torch"),
    "a modified Hamiltonian of a scheme without flows": (
        lambda: co.modified_hamiltonian(BODY, co.GaussLegendre(2)),
        "GaussLegendre(stages=2)",
        "modified_field",
    ),
    "a file as an archive": (lambda: co.resume(__file__), __file__, "folder"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_the_message_names_the_mistake_and_what_to_give(name):
    make, *named = MISTAKES[name]
    with refused((TypeError, ValueError, IndexError, AttributeError), *named) as caught:
        make()
    message = str(caught.value)
    assert "\n" not in message and " at 0x" not in message and len(message) < 700
    assert not re.search(r"unexpected keyword|positional argument|NoneType", message)


def test_hints_name_what_exists():
    """Attributes of solutions of other libraries are none here, and functions in messages are there."""
    for make, *_ in MISTAKES.values():
        with pytest.raises((TypeError, ValueError, IndexError, AttributeError)) as caught:
            make()
        for name in re.findall(r"\bco\.([\w.]*\w)", str(caught.value)):
            owner = co
            for part in name.split("."):
                owner = getattr(owner, part)
