"""What `integrate` refuses, `properties` and `stepper` refuse too; group elements that a scheme refuses."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.methods.protocol.attitude import check_attitude
from coadjoint.methods.registry import scheme


def _systems():
    so3, a = co.algebras.so(3), co.algebras.get("A4_8")
    rng = np.random.default_rng(7)
    full = rng.normal(size=(6, 6))
    cosh = co.Hamiltonian(lambda x: np.cosh(x[0]) + x[1] ** 2, lambda x: np.array([np.sinh(x[0]), 2 * x[1], 0.0]))
    timed = co.Hamiltonian(lambda x, t: np.cos(t) * x[2], lambda x, t: np.array([0.0, 0.0, np.cos(t)]))
    J = lambda x: np.array([[0, x[2], -x[1]], [-x[2], 0, x[0]], [x[1], -x[0], 0]])  # noqa: E731
    yield "coupled cubic", co.LiePoissonSystem(so3, co.Polynomial({(1, 1, 1): 1.0}))
    yield "cubic powers", co.LiePoissonSystem(so3, co.Polynomial({(3, 0, 0): 1.0, (0, 2, 0): 0.5}))
    yield "cubic and coupled quadratic", co.LiePoissonSystem(so3, co.Polynomial({(3, 0, 0): 1.0, (1, 1, 0): 0.5}))
    yield "commuting cubic", co.LiePoissonSystem(a, co.Polynomial({(1, 1, 0, 0): 1.0, (2, 1, 0, 0): 0.5}))
    yield "coupled quartic", co.LiePoissonSystem(a, co.Polynomial({(0, 2, 2, 0): 1.0, (0, 0, 0, 2): 1.0}))
    yield "full quadratic", co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(full + full.T))
    yield "a function", co.LiePoissonSystem(so3, cosh)
    yield "a function of time", co.LiePoissonSystem(so3, timed)
    yield "separable", co.LiePoissonSystem(so3, co.Separable({0: (np.cosh, np.sinh)}))
    yield "a function J", co.PoissonSystem(J, co.Quadratic([1.0, 2.0, 3.0]))
    yield "forces", co.systems.rigid_body((1, 2, 3)).with_forces(co.forces.LinearDamping(0.1))
    yield (
        "forces on what does not split",
        co.LiePoissonSystem(so3, co.Polynomial({(1, 1, 1): 1.0})).with_forces(co.forces.LinearDamping(0.1)),
    )
    yield "matrices", co.systems.matrix_body((1.0, 2.0, 3.0))


SYSTEMS = dict(_systems())
METHODS = {str(method): method for name in co.methods.names() for method in scheme(name).examples()}
METHODS |= {f"{parts}": co.Splitting(parts=parts) for parts in ("free_body", "bonds", ((0,), (1,)), ((0,), (1,), (2,)))}


def _refusal(call):
    try:
        call()
    except (TypeError, ValueError) as reason:
        return type(reason), str(reason)
    except co.IntegrationError:
        return None
    return None


@pytest.mark.thinned(6)
@pytest.mark.parametrize("name", SYSTEMS)
def test_declarations_refuse_what_a_run_refuses(name):
    system = SYSTEMS[name]
    x0 = 0.1 + 0.05 * np.arange(system.dim)
    if name == "matrices":
        x0 = np.array([[0.0, 0.1, 0.2], [-0.1, 0.0, 0.3], [-0.2, -0.3, 0.0]])
    for told, method in METHODS.items():
        run = _refusal(lambda m=method: co.integrate(system, x0, (0.0, 0.01), 0.01, m))
        scheme = co.methods.Forced(method) if "forces" in name else method
        declared = _refusal(lambda s=scheme: s.properties(system))
        step = _refusal(lambda m=method: co.stepper(system, m, 0.01))
        assert (run is None) == (declared is None) == (step is None), (told, run, declared, step)
        if run is not None:
            assert run == declared == step, told


def test_the_words_of_a_refusal():
    system = SYSTEMS["coupled cubic"]
    said = (
        r"Splitting cannot be used for .*: its monomial x1\*x2\*x3 couples x1 and x2, which do not commute; give H as "
        r"a sum"
    )
    with pytest.raises(ValueError, match=said):
        co.Splitting(order=4).properties(system)
    with pytest.raises(ValueError, match=said):
        co.stepper(system, co.Splitting(), 0.1)
    with pytest.raises(ValueError, match="parts leave out x3"):
        co.Splitting(parts=((0,), (1,))).properties(co.systems.rigid_body((1, 2, 3)))


GAUSS = (co.GaussLegendre(2), co.ModifiedGaussLegendre(1, freeze="gradient"))


def system(algebra):
    return co.LiePoissonSystem(algebra, co.Quadratic(np.linspace(1.0, 2.0, algebra.dim)))


@pytest.mark.parametrize("method", GAUSS, ids=repr)
def test_gauss_accepts_a_turned_copy_of_the_coadjoint_matrices_with_more_rows(method):
    """The sum of the coadjoint and the trivial representation, in another basis: T is found, not guessed."""
    so4 = co.algebras.so(4)
    D = np.zeros((6, 7, 7))
    D[:, :6, :6] = [so4.coadjoint(e) for e in np.eye(6)]
    turn = np.eye(7) + np.triu(np.full((7, 7), 0.5), 1)
    check_attitude(method, system(so4), np.linalg.inv(turn) @ D @ turn)


@pytest.mark.parametrize("method", GAUSS, ids=repr)
@pytest.mark.parametrize(
    ("algebra", "said"),
    [
        (co.algebras.so(4), "spatial momentum"),
        (co.algebras.so(5), "spatial momentum"),
        (co.algebras.sl(2), "spatial momentum"),
        (co.algebras.e(3), "leave the group"),
        (co.algebras.A3_7(2.0), "leave the group"),
    ],
    ids=repr,
)
def test_gauss_refuses_what_it_would_lose(method, algebra, said):
    with pytest.raises(ValueError, match=said):
        check_attitude(method, system(algebra), algebra.representation)


def test_no_algebra_no_group():
    J = co.PoissonSystem(lambda x: x[0] * np.array([[0.0, 1.0], [-1.0, 0.0]]), co.Quadratic([1.0, 2.0]))
    with pytest.raises(ValueError, match="has no Lie algebra and so no group element"):
        check_attitude(co.GaussLegendre(2), J, "coadjoint")
