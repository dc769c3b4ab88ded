"""Names, shapes and rules of derivatives, and what they must not depend on."""

import pickle
import subprocess
import sys

import numpy as np
import pytest
from derivative_checks import outputs

import coadjoint as co
from rounding import UNIT_ROUNDOFF

BODY = co.systems.rigid_body(inertia=(1.0, 2.0, 2.5))
TOP = co.systems.heavy_top(inertia=(1.0, 2.0, 2.5), lever=(0.25, -0.5, 1.0))
X3, X6 = np.array([0.3, 1.0, 0.2]), np.array([1.0, -0.5, 1.5, 0.6, 0.0, 0.8])
H, F = 0.125, co.forces


def derivatives(ready, x0, span=(0.5, -0.5), seed=1, **points):
    """Return the solution, tangents along two directions of everything, and the gradient of a sum of everything."""
    rng = np.random.default_rng(seed)
    along = {name: rng.standard_normal((*value.shape, 2)) for name, value in ready.parameters.items()}
    along["x0"] = rng.standard_normal((*np.shape(x0), 2))
    _, tangents = ready.jvp(x0, span, along, **points)
    sol, pullback = ready.vjp(x0, span, **points)
    weights = {name: rng.standard_normal(value.shape) for name, value in outputs(sol).items()}
    return sol, outputs(tangents), pullback(**weights)


def same_bits(one, other):
    return all(np.array_equal(a, b, equal_nan=True) for a, b in zip(one.values(), other.values(), strict=True))


@pytest.mark.parametrize(
    "method", [co.Splitting(order=4), co.Splitting(compensated=True), co.GaussLegendre(2)], ids=str
)
def test_derivatives_have_the_same_bits_on_any_number_of_threads_and_after_pickling(method):
    x0 = X6 * np.linspace(1.0, 0.7, 70)[:, None]
    ready = co.prepare(TOP, method, H, attitude="coadjoint", threads=1)
    expected = derivatives(ready, x0, save_every=3)
    for other in (co.prepare(TOP, method, H, attitude="coadjoint", threads=2), pickle.loads(pickle.dumps(ready))):
        found = derivatives(other, x0, save_every=3)
        assert np.array_equal(found[0].x, expected[0].x)
        assert same_bits(found[1], expected[1]) and same_bits(found[2], expected[2])


def test_several_directions_are_a_further_axis():
    ready = co.prepare(TOP, co.Splitting(), H, attitude=True, inputs={"rotor": (0,)})
    rng, given = np.random.default_rng(6), {"rotor": [0.3]}
    directions = {"x0": rng.standard_normal((6, 3)), "lever": rng.standard_normal((3, 3))}
    turn = {"rotor": rng.standard_normal((1, 3))}
    sol, several = ready.jvp(X6, (0, 1), {**directions, "inputs": turn}, **given)
    assert several.x.shape == (*sol.x.shape, 3) and several.attitude.shape == (*sol.attitude.shape, 3)
    for k in range(3):
        along = {name: value[:, k] for name, value in directions.items()} | {"inputs": {"rotor": turn["rotor"][:, k]}}
        _, one = ready.jvp(X6, (0, 1), along, **given)
        for name, value in outputs(one).items():
            assert value.shape == outputs(sol)[name].shape
            np.testing.assert_allclose(value, outputs(several)[name][..., k], rtol=0, atol=2.0**6 * UNIT_ROUNDOFF)


def test_cotangents_of_energies_and_observed_quantities_are_those_of_their_gradients():
    observe = {"sum": lambda x: x[0] * x[1] + x[2] ** 2 + np.sin(x[0]), "first": lambda x: x[0]}
    M, b = np.array([1.0, 0.5, 0.4]), np.array([0.1, 0.0, 0.2])
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(M, linear=b), sign=-1)
    ready, rng = co.prepare(system, co.Splitting(order=4), H, observe=observe), np.random.default_rng(8)
    for x0 in (X3, np.array([X3, X3[::-1]])):
        sol, pullback = ready.vjp(x0, (0.5, -0.5), t_eval=[0.5, 0.4, -0.5])
        given = {name: rng.standard_normal(values.shape) for name, values in sol.observed.items()}
        x = np.moveaxis(sol.x, -1, 0)
        of_x = given["sum"] * np.array([x[1] + np.cos(x[0]), x[0], 2 * x[2]])
        of_x[0] += given["first"]
        w = rng.standard_normal(sol.energy.shape)
        pairs = [(pullback(observed=given), pullback(np.moveaxis(of_x, 0, -1)), {})]
        # The energy depends on M and b also at a given state.
        direct = {name: np.tensordot(w, value, w.ndim) for name, value in (("M", sol.x**2 / 2), ("linear", sol.x))}
        pairs.append((pullback(energy=w), pullback(w[..., None] * (M * sol.x + b)), direct))
        for one, other, more in pairs:
            for name, value in other.items():
                # A complex step differentiates observed quantities, and sums have tens of terms of size one.
                np.testing.assert_allclose(one[name] - more.get(name, 0.0), value, rtol=0, atol=2.0**-44)


@pytest.mark.parametrize(("span", "points"), [((2, 2), {}), ((0, 1), {"t_eval": [0.0, 0.0]})])
def test_derivatives_of_no_steps(span, points):
    ready, unit = co.prepare(BODY, co.Splitting(), H, attitude=True), np.eye(3)
    sol, tangents = ready.jvp(X3, span, {"x0": unit, "inertia": unit}, **points)
    assert np.array_equal(tangents.x, np.broadcast_to(unit, (len(sol.t), 3, 3)))
    gradient = ready.vjp(X3, span, **points)[1](np.ones(sol.x.shape), attitude=np.ones(sol.attitude.shape))
    assert gradient["x0"].tolist() == [len(sol.t)] * 3 and not gradient["inertia"].any()
    assert np.array_equal(gradient["attitude0"], len(sol.t) * np.ones((3, 3)))


def test_coefficients_are_in_the_order_of_the_monomials():
    """A polynomial of the second degree is a `Quadratic`."""
    energy = co.Polynomial({(0, 0, 3): 0.5, (1, 0, 0): 0.25, (0, 2, 0): 1.0})
    ready = co.prepare(co.LiePoissonSystem(co.algebras.so(3), energy), co.Splitting(), H)
    assert ready.parameters["coefficients"].tolist() == list(energy.monomials.values())
    found = ready.vjp(X3, (0, 0))[1](energy=[1.0])["coefficients"]
    np.testing.assert_allclose(found, [np.prod(X3**exponents) for exponents in energy.monomials], rtol=1e-15)
    quadratic = co.LiePoissonSystem(co.algebras.so(3), co.Polynomial({(0, 2, 0): 1.0}))
    assert set(co.prepare(quadratic, co.Splitting(), H).parameters) == {"M", "linear"}


def test_derivatives_by_arguments_follow_those_by_coefficients():
    """M is the inverse of the inertia, the linear term the lever, and inputs are added to the linear term."""
    linear = np.array([0, 0, 0, 0.25, -0.5, 1.0])
    energy = co.Quadratic(np.append(1 / np.array([1.0, 2.0, 2.5]), np.zeros(3)), linear=linear)
    own = co.LiePoissonSystem(co.algebras.e(3), energy, sign=-1)
    gradients = []
    for system, more in ((TOP, {}), (own, {}), (own, {"linear": linear})):
        ready = co.prepare(system, co.Splitting(order=4), H, **({"inputs": True} if more else {}))
        sol, pullback = ready.vjp(X6, (0, 4), 8, **more)
        gradients.append(pullback(np.cos(np.arange(sol.x.size)).reshape(sol.x.shape)))
    by_argument, by_coefficient, by_input = gradients
    pairs = [(by_argument["lever"], by_coefficient["linear"][3:], 2.0**-42)]
    # M of the own system has entries without a part, so that it is another rule: both converge with h.
    pairs += [(by_argument["inertia"], -by_coefficient["M"][:3] / np.array([1.0, 4.0, 6.25]), 10 * H**4)]
    pairs += [(by_input["inputs"]["linear"][3:], by_coefficient["linear"][3:], 10 * H**4)]
    for one, other, bound in pairs:
        np.testing.assert_allclose(one, other, rtol=0, atol=bound * np.abs(other).max())
    assert not by_input["linear"].any()


def test_parameters_of_forces_have_the_names_of_their_labels():
    """Whole numbers, bands and values at a limit of their domain are no parameters."""
    system = BODY.with_forces(F.LinearDamping(0.1), F.LinearDamping((0.1, 0.2, 0.3)), F.HeatBath(0.1, seed=1))
    assert {name: value.shape for name, value in co.prepare(system, None, H).parameters.items()} == {
        "inertia": (3,),
        "LinearDamping.rate": (),
        "LinearDamping.toward": (),
        "LinearDamping 2.rate": (3,),
        "LinearDamping 2.toward": (),
        "HeatBath.alpha": (),
        "HeatBath.metric": (),
    }
    forces = F.Viscosity(0.1, power=2), F.RandomForcing(0.5, band=(1, 2), seed=1)
    found = co.prepare(co.systems.sphere_euler(N=3).with_forces(*forces), co.IsospectralGauss(), H).parameters
    assert set(found) == {"rotation", "Viscosity.nu", "RandomForcing.energy_rate"}
    assert not co.prepare(co.systems.torus_euler(5), None, H).parameters


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("metric", [(0.5, 0.0, 0.25), (0.0, 0.0, 0.0), 0.0], ids=str)
def test_a_metric_with_zeros_is_no_parameter_and_the_strength_is_one(metric):
    x0, span, d = np.array([0.3, 0.5, -0.4]), (0.0, 4 * H), 2.0**-12

    def run(alpha):
        return co.prepare(BODY.with_forces(F.DoubleBracketDamping(alpha, metric)), None, H)

    sol, pullback = run(0.25).vjp(x0, span)
    weights = np.cos(np.arange(sol.x.size)).reshape(sol.x.shape)
    found = pullback(weights)
    assert set(found) == {"x0", "inertia", "DoubleBracketDamping.alpha"}
    ahead, behind = ((weights * run(0.25 + sign * d).run(x0, span).x).sum() for sign in (1, -1))
    assert found["DoubleBracketDamping.alpha"] == pytest.approx((ahead - behind) / (2 * d), rel=0, abs=64 * d**2)


@pytest.mark.parametrize(
    ("method", "full", "rule"),
    [
        (co.Splitting(order=4), False, "exact"),
        (co.Splitting(order=4), True, "added part"),
        (co.Taylor(order=4), False, "differences"),
    ],
)
def test_rules_of_parameters_that_flows_of_forces_depend_on(method, full, rule):
    """Those with formulas are exact, which a matrix as a metric does not have."""
    M = [[1.0, 0.1, 0.2], [0.1, 0.7, 0.0], [0.2, 0.0, 0.4]] if full else [1.0, 0.7, 0.4]
    base = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(M, linear=[0.1, 0.2, 0.3]), sign=-1)
    metric = np.diag([1.0, 0.5, 0.25])
    for damping in (F.LinearDamping(0.1), F.DoubleBracketDamping(0.1), F.DoubleBracketDamping(0.1, metric)):
        ready = co.prepare(base.with_forces(damping), method, H)
        sol, pullback = ready.vjp(X3, (0.0, 2 * H))
        found = pullback(np.ones(sol.x.shape)).rule
        own = {name: found[name] for name in ready.parameters if "." in name}
        assert own and own == {name: "differences" if ready.parameters[name].ndim == 2 else "exact" for name in own}
        assert found["M"] == rule


BODIES = [co.systems.rigid_body(inertia) for inertia in ((1.0, 2.0, 2.5), (2.0, 2.0, 2.5))]
COEFFICIENTS = {(1, 0, 0): 0.3, (0, 3, 0): 0.2}
DIFFERENT = {
    "coefficients": (
        [
            co.LiePoissonSystem(co.algebras.so(3), co.Polynomial(terms))
            for terms in (COEFFICIENTS, COEFFICIENTS | {(0, 0, 2): 0.4})
        ],
        [],
    ),
    "names": ([co.systems.gyrostat(rotors=(0.1, 0.2, 0.0)), BODY], ["inertia"]),
    "forces": (
        [BODY.with_forces(F.LinearDamping(rate)) for rate in (0.1, (0.1, 0.2, 0.3))],
        ["inertia", "LinearDamping.toward"],
    ),
}


@pytest.mark.parametrize("name", DIFFERENT)
def test_gradients_of_a_batch_are_by_the_parameters_of_all_members(name):
    systems, shared = DIFFERENT[name]
    ready, x0 = co.prepare(co.batch(systems), co.GaussLegendre(2), H), np.array([X3, X3[::-1]])
    assert list(ready.parameters) == shared
    sol, pullback = ready.vjp(x0, (0.0, 1.0))
    gradient = pullback(sol.x)
    assert list(gradient) == ["x0", *shared] and list(gradient.rule) == shared
    for m, system in enumerate(systems):
        found = co.prepare(system, co.GaussLegendre(2), H).vjp(x0[m], (0.0, 1.0))[1](sol.x[:, m])
        assert all(np.array_equal(gradient[one][m], found[one]) for one in gradient)


@pytest.mark.parametrize("forces", [(), (F.DoubleBracketDamping(0.125),)], ids=["plain", "damped"])
@pytest.mark.thinned(2)
def test_the_rule_of_a_batch_is_the_least_exact_of_its_members(forces):
    """Bodies with equal moments have fewer parts, of which the forms change with the moments."""
    bodies = [body.with_forces(*forces) if forces else body for body in BODIES]
    rules = [
        co.prepare(body, co.Splitting(), H).jvp(X3, (0.0, 1.0), {"inertia": np.ones(3)})[1].rule for body in bodies
    ]
    assert rules == [{"inertia": "exact"}, {"inertia": "added part"}]
    for order in (bodies, bodies[::-1]):
        ready = co.prepare(co.batch(order), co.Splitting(), H)
        sol, tangents = ready.jvp(X3, (0.0, 1.0), {"inertia": np.ones((2, 3))})
        assert tangents.rule == {"inertia": "added part"}
        assert ready.vjp(X3, (0.0, 1.0))[1](sol.x).rule["inertia"] == "added part"


@pytest.mark.parametrize("end", [5.0, 5.2, 8.0])
def test_members_that_have_ended_have_neither_tangents_nor_cotangents(end):
    ready = co.prepare(BODY, co.Splitting(order=4), 0.1, attitude=True)
    x0 = np.array([[1.0, 0.2, 0.5], [0.5, 0.3, 0.9], [0.9, -0.1, 0.4]])
    event, rng = co.Event("x2", terminal=True), np.random.default_rng(3)
    sol, tangents = ready.jvp(x0, (0, end), {"x0": np.ones((3, 3))}, save_every=4, events=event)
    gone = np.isnan(sol.x[..., 0])
    assert gone.any()
    for value in (tangents.x, tangents.energy[..., None], tangents.attitude):
        assert np.array_equal(np.isnan(value).reshape(*gone.shape, -1).all(axis=-1), gone)
    _, pullback = ready.vjp(x0, (0, end), save_every=4, events=event)
    weights = {name: rng.standard_normal(getattr(sol, name).shape) for name in ("x", "energy", "attitude")}

    def without(value):
        masks = {name: gone.reshape(*gone.shape, *[1] * (w.ndim - 2)) for name, w in weights.items()}
        return pullback(**{name: np.where(masks[name], value, w) for name, w in weights.items()})

    wanted = without(0.0)
    assert same_bits(wanted, pullback(**weights)) and same_bits(wanted, without(np.nan))


# Rotations of four and more blocks by one angle, and parts of eight and more angles.
LARGE = {
    "so(6)": co.LiePoissonSystem(co.algebras.so(6), co.Quadratic(np.linspace(1, 3, 15))),
    "su(4)": co.LiePoissonSystem(co.algebras.su(4), co.Quadratic(np.linspace(1, 3, 15))),
    "spins": co.systems.spin_lattice(shape=10, field=(0.1, 0.2, 0.3)),
}


@pytest.mark.parametrize("members", [1, 9])
@pytest.mark.parametrize("name", LARGE)
def test_tangents_keep_the_momentum_in_space(name, members):
    """Where A x = x0, dA x + A dx = dx0."""
    system, method = LARGE[name], co.Splitting(parts="coordinates" if name == "su(4)" else "auto")
    x0, direction = np.random.default_rng(6).standard_normal((2, members, system.dim))
    sol, tangents = co.prepare(system, method, H / 2, attitude="coadjoint").jvp(x0, (0, 2 * H), {"x0": direction})
    rotated = np.einsum("pmij,pmj->pmi", tangents.attitude, sol.x) + np.einsum(
        "pmij,pmj->pmi", sol.attitude, tangents.x
    )
    np.testing.assert_allclose(rotated, np.broadcast_to(direction, sol.x.shape), rtol=0, atol=1e-11)


def test_derivatives_of_attitudes_do_not_depend_on_the_scale_of_a_casimir():
    """Multiples of Casimirs are subtracted from the energy; attitudes are turned back by them."""
    squares = co.Polynomial({(2, 0, 0): 1.0, (0, 2, 0): 1.0, (0, 0, 2): 1.0})
    found = []
    for scale in (1.0, 4.0):
        system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 2.0, 3.0]), casimirs={"C": scale * squares})
        ready = co.prepare(system, co.Splitting(), H, attitude="coadjoint")
        found.append(ready.jvp(X3, (0, 4 * H), {"M": np.array([0.5, -1.0, 2.0])})[1].attitude)
    np.testing.assert_allclose(*found, rtol=0, atol=1e-13)


OWN_STEPS = {
    "flows": (TOP, co.ReversibleSteps(co.Splitting(order=4), 0.1), X6, (0.5, 3.5), {}),
    "flows backward": (TOP, co.ReversibleSteps(co.Splitting(order=4), 0.1), X6, (0.5, -2.5), {}),
    "times": (BODY, co.ReversibleSteps(co.Splitting(), 0.1), X3, (0.5, 3.5), {"t_eval": [0.5, 1.5, 3.5]}),
    "series": (BODY, co.Taylor(order=8, tolerance=1e-10), X3, (0.5, 3.5), {}),
}


@pytest.mark.parametrize("name", OWN_STEPS)
def test_runs_with_steps_of_their_own_have_the_derivatives_of_the_motion(name):
    """Of steps with their lengths fixed, which approach those of fixed steps."""
    system, method, x0, span, options = OWN_STEPS[name]
    rng, ready = np.random.default_rng(2), co.prepare(system, method, 1.0)
    along = {k: rng.standard_normal(v.shape) for k, v in [("x0", x0), *ready.parameters.items()]}
    sol, tangents = ready.jvp(x0, span, along, **options)
    assert np.array_equal(sol.x, ready.run(x0, span, **options).x)
    fine = co.prepare(system, co.GaussLegendre(4), 1 / 64).jvp(x0, span, along, t_eval=sol.t)[1].x
    error = {"times": 2e-2, "series": 1e-8}.get(name, 1e-3)
    np.testing.assert_allclose(tangents.x, fine, rtol=0, atol=error * np.abs(fine).max())


MEASURED = """
import resource, sys
import numpy as np
import coadjoint as co
lattice = co.systems.spin_lattice("square", shape=(36, 36))
system = lattice
if sys.argv[2] != "by exchange":
    system = co.LiePoissonSystem(lattice.algebra, lattice.hamiltonian, sign=lattice.sign)
x0 = np.random.default_rng(1).standard_normal(system.dim)
ready = co.prepare(system, {"splitting": co.Splitting(order=2), "gauss": co.GaussLegendre(1)}[sys.argv[1]], 0.01)
ready.run(x0, (0, 0.02))
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
if sys.argv[2] == "jvp":
    ready.jvp(x0, (0, 0.02), {"x0": x0})
else:
    sol, pullback = ready.vjp(x0, (0, 0.02))
    pullback(x=np.ones(sol.x.shape))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="the largest memory of a process is read by getrusage")
@pytest.mark.parametrize(("scheme", "product"), [("splitting", "jvp"), ("splitting", "by exchange"), ("gauss", "vjp")])
def test_memory_of_derivatives_is_not_quadratic(scheme, product):
    """A matrix for the 1296 angles of a part would take 13 MB, and one for the state 120 MB."""
    command = [sys.executable, "-c", MEASURED, scheme, product]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert int(done.stdout) * (1 if sys.platform == "darwin" else 1024) < 2.5 * 8 * 1296**2
