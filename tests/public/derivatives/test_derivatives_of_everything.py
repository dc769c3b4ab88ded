"""Gradients by states, parameters, inputs and forces: those of tangents, and of differences of whole runs."""

import warnings

import numpy as np
import pytest
from derivative_checks import DIFFERENCE_ERROR, assert_derivatives, difference, outputs

import coadjoint as co
from energies import pulsed
from rounding import UNIT_ROUNDOFF

F, H = co.forces, 0.0625
X3, X6 = np.array([0.3, 1.0, 0.2]), np.array([0.3, 1.0, 0.2, 0.1, 0.4, 0.9])
UNIT_SPINS = np.array([0.6, 0.0, 0.8, 0.48, 0.64, 0.6, 0.0, 0.6, -0.8])
SCHEMES = {
    "order 4": co.Splitting(order=4),
    "processed": co.Splitting(scheme="blanes_casas_murua6"),
    "compensated": co.Splitting(compensated=True),
}


def named(name, **values):
    """Return the builder of a ready-made system."""
    return lambda changed: getattr(co.systems, name)(**(values | changed))


def own(algebra, M, linear, sign=-1, **terms):
    """Return the builder of a system with a quadratic energy."""
    linear = np.asarray(linear)
    return lambda changed: co.LiePoissonSystem(
        algebra, co.Quadratic(changed.get("M", M), linear=changed.get("linear", linear)), sign=sign, **terms
    )


def wave(amplitude):
    return (
        lambda y, t: amplitude * np.cos(3 * t) * y**2,
        lambda y, t: 2 * amplitude * np.cos(3 * t) * y,
        lambda y, t: 2 * amplitude * np.cos(3 * t) + 0 * y,
    )


def timed(changed):
    M, linear = changed.get("M", [1.0, 0.5, 0.4]), changed.get("linear", np.zeros(3))
    energy = co.Quadratic(M, linear=linear) + co.Separable({0: wave(0.5), 2: wave(0.25)})
    return co.LiePoissonSystem(co.algebras.so(3), energy, sign=-1, name="timed")


BODY, TOP = named("rigid_body", inertia=(1.0, 2.0, 2.5)), named("heavy_top", inertia=(1.0, 2.0, 2.5))


def forced(base, *forces):
    """Return the builder of a system with forces, of which the parameters are named by their labels."""

    def build(changed):
        own = {name: value for name, value in changed.items() if "." not in name}
        made, seen = [], {}
        for force, values in forces:
            label = force.__name__
            seen[label] = seen.get(label, 0) + 1
            label += f" {seen[label]}" if seen[label] > 1 else ""
            new = {name.partition(".")[2]: value for name, value in changed.items() if name.startswith(f"{label}.")}
            made.append(force(**(values | new)))
        return base(own).with_forces(*made)

    return build


def plain(name):
    algebra, sign = {
        "so(3)": (co.algebras.so(3), -1),
        "so(4)": (co.algebras.so(4), -1),
        "A3,7": (co.algebras.get("A3,7", a=1.75), 1),
    }[name]
    n = algebra.dim
    return own(algebra, np.linspace(0.4, 1.2, n), np.linspace(-0.1, 0.2, n), sign), 0.3 + 0.4 * np.cos(
        1.0 + np.arange(n)
    )


@pytest.mark.thinned(1)
@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    "damping", [F.DoubleBracketDamping(0.9), F.HeatBath(0.9, temperature=0.2, seed=5)], ids=["damping", "bath"]
)
def test_dampings_on_the_orbit_are_differentiated_with_an_energy_of_the_time(damping, sign):
    """In long steps, within which the energy changes, against differences of the runs."""
    H = co.Separable(dict.fromkeys(range(3), pulsed(6.0)))
    system = co.LiePoissonSystem(co.algebras.so(3), H, sign).with_forces(damping)
    ready, x0, span, h = co.prepare(system, co.Splitting(), 0.25), np.array([0.3, -0.8, 0.5]), (0.5, 1.0), 2.0**-14
    _, tangents = ready.jvp(x0, span, {"x0": np.eye(3)})
    # Members of one run have different noise.
    ends = [np.array([ready.run(x0 + d, span).x[-1] for d in side * h * np.eye(3)]) for side in (1.0, -1.0)]
    np.testing.assert_allclose(tangents.x[-1], (ends[0] - ends[1]).T / (2 * h), rtol=0, atol=1e-7)


METHODS_IN_TIME = co.Splitting(order=4), co.GaussLegendre(1), co.SphericalMidpoint(), co.CommutatorFree(3)


@pytest.mark.parametrize("method", METHODS_IN_TIME, ids=repr)
def test_an_energy_of_the_time_between_flows_of_forces(method):
    """In substeps of several lengths, which begin at their own times, by the state, the energy and the forces."""
    damping, own = (F.DoubleBracketDamping, {"alpha": 0.4}), (F.LinearDamping, {"rate": 0.1, "toward": 0.2})
    composed = method if method in METHODS_IN_TIME[::3] else co.Composition(method, (0.75, -0.5, 0.75))
    assert_derivatives(forced(timed, damping, own), composed, X3, (0.5, 0.5 - 3 * H), H)


@pytest.mark.parametrize(
    "force",
    [
        (F.HeatBath, {"alpha": 0.9, "metric": np.linspace(0.5, 1.0, 3), "temperature": 3.0, "seed": 5}),
        (F.DoubleBracketDamping, {"alpha": 3.0, "metric": np.linspace(0.5, 1.0, 3)}),
    ],
    ids=["bath", "damping"],
)
def test_gradients_of_long_steps_on_the_orbit(force):
    """Rotations by more than a radian are computed in substeps."""
    base, x0 = plain("so(3)")
    gradient = assert_derivatives(forced(base, force), co.Splitting(), 2.0 * x0, (0.5, 1.5), 0.5)
    assert any(name.endswith(".alpha") for name in gradient)


FULL = np.array([[1.0, 0.3, -0.2, 0.1], [0.3, 0.5, 0.4, 0.0], [-0.2, 0.4, 1.5, 0.25], [0.1, 0.0, 0.25, 0.75]])
NOT_UNIMODULAR = own(co.algebras.get("A4,9", b=0.5), FULL, np.linspace(-0.3, 0.4, 4), sign=1)


def cubic(changed):
    coefficients = dict(zip([(0, 1, 1), (1, 0, 2)], changed.get("coefficients", (-0.4, 0.7)), strict=True))
    return co.LiePoissonSystem(co.algebras.so(3), co.Polynomial(coefficients), sign=-1)


def driven(changed):
    """A quantum spin in a field that turns, with a parameter of its anisotropy."""
    ion = co.spins.crystal(lattice=(3, 3, 8, 90, 90, 90), sites={"Ni": (0, 0, 0)})
    model = co.systems.spins(ion, (1, 1, 1), spin=1, mode="SU(N)", periodic=False)
    field = model.field(lambda t: np.array([np.cos(3.0 * t), np.sin(3.0 * t), 0.3]))
    return field.single_ion("Ni", {"B20": float(changed.get("B20 Ni 0", -0.3))})


BY_STAGES = {
    "backward": (NOT_UNIMODULAR, co.CommutatorFree(4), -3),
    "third order": (NOT_UNIMODULAR, co.CommutatorFree(3), 2),
    "third degree": (cubic, co.CommutatorFree(2), 3),
    "driven": (driven, co.CommutatorFree(4), -3),
    "forces": (forced(driven, (F.LinearDamping, {"rate": 0.1, "toward": 0.0})), co.CommutatorFree(3), 3),
    "noise": (forced(cubic, (F.HeatBath, {"alpha": 0.3, "temperature": 0.2, "seed": 5})), co.CommutatorFree(4), 3),
}


@pytest.mark.parametrize("name", BY_STAGES)
def test_derivatives_by_the_stages_of_commutator_free_steps(name):
    """Against runs of other systems, and by entries of the parameters, which group elements need."""
    build, method, steps = BY_STAGES[name]
    x0, span = 0.3 + 0.4 * np.cos(1.0 + np.arange(build({}).dim)), (0.5, 0.5 + steps * H)
    gradient = assert_derivatives(build, method, x0, span, H)
    by_energy = {one for one in gradient.rule if "." not in one}
    assert by_energy and {gradient.rule[one] for one in by_energy} == {"exact"}
    ready = [co.prepare(build({}), method, H, attitude=kind) for kind in (False, "coadjoint")]
    runs = [one.vjp(x0, span) for one in ready]
    first, second = (pullback(np.cos(sol.x)) for sol, pullback in runs)
    assert {second.rule[one] for one in by_energy} == {"differences"}
    for one in by_energy:
        np.testing.assert_allclose(first[one], second[one], rtol=0, atol=2.0**-36)


class Spring(co.forces.Force):
    """A force of the user without formula, parameters and complex numbers."""

    def check(self, system):
        pass

    def field(self, system, x, t):
        return -np.array([float(one) for one in x]) * 0.3

    def flow(self, system, x, t, tau):
        return np.array([float(one) for one in x]) * np.exp(-0.3 * tau)

    def describe_to(self, reader, system):
        return reader.damping(np.asarray(0.3), np.zeros(system.dim))


def test_a_force_of_the_user_without_formulas_is_differentiated_by_differences():
    base, x0 = plain("so(3)")
    # Central differences of order 2 have nine digits.
    assert_derivatives(forced(base, (Spring, {})), co.Splitting(order=4), x0, (0.5, 0.25), H, error=2.0**-30)


SYMMETRIC = np.array([[0.2, 1.0, 0.5], [1.0, 0.3, 0.7], [0.5, 0.7, 0.9]])
OFF_DIAGONAL = SYMMETRIC - np.diag(np.diag(SYMMETRIC))


def matrices(kind, stream, size=3, **terms):
    return lambda changed: co.MatrixSystem(co.MatrixAlgebra(kind, size), stream, **terms)


def on_torus(size):
    """Return the builder of a fluid on the torus, with a constant stream of a size."""

    def build(changed):
        torus = co.systems.torus_euler(N=5)
        constant = torus.from_modes({(1, 0): size, (1, 1): 0.5 * size, (0, 1): 0.3j * size})
        return torus if size == 0.0 else co.MatrixSystem(torus.algebra, torus.stream, constant)

    return build


BLOCKS = co.MatrixAlgebra.sum(co.MatrixAlgebra("so", 3), co.MatrixAlgebra("su", 2))
MATRICES = {  # of the user, and with forces
    "composed": (named("sphere_euler", N=3, rotation=0.3), co.Composition(co.IsospectralGauss(1), (0.75, -0.5, 0.75)),
        -2),
    "gl": (matrices("gl", co.systems.Weights(SYMMETRIC)), co.IsospectralGauss(2), 2),
    "function on sp": (matrices("sp", lambda W: W - W.T, 2), co.IsospectralGauss(2), -2),
    "function of time": (matrices("so", lambda W, t: (1.0 + 0.5 * t) * OFF_DIAGONAL * W), co.IsospectralGauss(2), 2),
    "function of time, composed": (matrices("so", lambda W, t: (1.0 + 5.0 * t) * OFF_DIAGONAL * W),
        co.Composition(co.IsospectralGauss(1), (0.75, -0.5, 0.75)), -2),
    "two layers": (named("reduced_mhd", N=3), co.IsospectralGauss(2), -2),
    "lines": (on_torus(0.0), co.LineSplitting(), 2),
    "lines beside a constant stream": (on_torus(0.3), co.LineSplitting(4), -2),
    "lines, composed": (on_torus(0.3), co.Composition(co.LineSplitting(), (0.75, -0.5, 0.75)), 2),
    "shallow fluid": (named("sphere_qg", N=4, lamb=2.0, gamma=0.5, rotation=0.7), co.IsospectralGauss(3), -2),
    "body": (named("matrix_body", inertia=(1.0, 2.0, 3.5, 4.0)), co.IsospectralGauss(2), 2),
    "layers": (named("layered_qg", N=3, gamma=[[2.0, -2.0], [-1.0, 1.0]], thicknesses=[1.0, 2.0], rotation=0.25),
        co.IsospectralGauss(2), -2),
    "buoyancy": (named("thermal_qg", N=3, gamma=0.5, rotation=0.3), co.Composition(co.IsospectralGauss(2),
        (0.75, -0.5, 0.75)), 2),
    "real and complex blocks": (lambda changed: co.MatrixSystem(BLOCKS, co.systems.Weights(1.0 + np.eye(5))),
        co.IsospectralGauss(2), 2),
    "nonlinear": (matrices("gl", lambda W: W.T @ W @ W.T / 8, energy=lambda W: np.sum((W @ W.T) ** 2) / 32),
        co.IsospectralGauss(2), 2),
    "forces": (forced(named("sphere_euler", N=4, rotation=0.7), (F.Viscosity, {"nu": 0.05, "rotation": True}),
        (F.Friction, {"rate": 0.1}), (F.RandomForcing, {"energy_rate": 0.3, "band": (2, 3), "seed": 1})),
        co.IsospectralGauss(1), 2),
    "drag of a layer": (forced(named("layered_qg", N=3, rotation=0.7), (F.Friction, {"rate": 0.3, "layer": 1})),
        co.IsospectralGauss(1), 2),
    "layers on a beta plane": (forced(named("layered_qg", N=5, surface="torus"), (F.BetaPlane, {"beta": 0.5})),
        co.IsospectralGauss(2), 2),
    "forces on a warm planet": (forced(named("thermal_qg", N=3, rotation=0.7, bathymetry={(2, 1): 0.3}),
        (F.Friction, {"rate": 0.3}), (F.Viscosity, {"nu": 0.05, "layer": "carried"})), co.IsospectralGauss(1), 2),
    "forces on the torus": (forced(named("torus_euler", N=3), (F.BetaPlane, {"beta": 0.5}), (F.Friction, {"rate":
        lambda n: 0.1 * n})), co.CommutatorFree(), 2),
}  # fmt: skip


def drawing(system):
    """Return a function that draws a state of a system of matrices."""
    base = system.unforced

    def draw(rng):
        return base.from_vector(base.to_vector(base.algebra.projected(base.from_vector(rng.standard_normal(base.dim)))))

    return draw


def check_matrices(name):
    build, method, steps = MATRICES[name]
    error = 1e-7 if "nonlinear" in name else DIFFERENCE_ERROR  # central differences of order 2
    draw = drawing(build({}))
    x0, span = 0.5 * draw(np.random.default_rng(2)), (0.5, 0.5 + steps * H)
    points = {} if "forces" in name else {"t_eval": 0.5 + np.sign(steps) * H * np.array([0.0, 0.25, 1.75])}
    gradient = assert_derivatives(build, method, x0, span, H, draw=draw, error=error, **points)
    algebra = build({}).unforced.algebra
    outside = gradient["x0"] - algebra.projected(gradient["x0"])
    assert np.abs(outside).max() <= 2.0**10 * UNIT_ROUNDOFF * np.abs(gradient["x0"]).max()


@pytest.mark.thinned(4)
@pytest.mark.parametrize("name", MATRICES)
def test_derivatives_of_matrices(name):
    check_matrices(name)


def test_cotangents_outside_of_an_algebra_are_projected():
    """Only one of two blocks is traceless: a part of cotangents that no state has leaves gradients as they are."""
    algebra = co.MatrixAlgebra.sum(co.MatrixAlgebra("u", 2), co.MatrixAlgebra("su", 2))
    s = co.MatrixSystem(algebra, co.systems.Weights(1.0 + np.eye(4)))
    rng = np.random.default_rng(6)
    weights = rng.standard_normal((3, 4, 4)) + 1j * rng.standard_normal((3, 4, 4))
    x0, weights[0] = 0.5 * drawing(s)(rng), 0.0  # that at the start is no part of a step
    _, pullback = co.prepare(s, co.IsospectralGauss(2), H).vjp(x0, (0.5, 0.5 - 2 * H))
    found, wanted = (pullback(one)["x0"] for one in (weights, np.array([algebra.projected(one) for one in weights])))
    for gradient in (algebra.projected(found), wanted):
        np.testing.assert_allclose(found, gradient, rtol=0, atol=2.0**10 * UNIT_ROUNDOFF * np.abs(wanted).max())


def test_derivatives_of_layers_of_different_thickness():
    """The weights of the layers are in the pairing of cotangents and streams, by which parameters are reached."""
    check_matrices("layers")


@pytest.mark.parametrize(
    "method", [co.IsospectralGauss(), co.IsospectralGauss(2), co.Composition(co.IsospectralGauss(), (0.75, -0.5, 0.75))]
)
def test_gradients_of_matrices_are_those_of_steps_in_numpy(method):
    """Over several segments of a run, of members on threads; steps in NumPy are code of their own."""
    s, h, steps = co.systems.sphere_euler(N=16, rotation=0.5), 0.01, 80
    draw, rng = drawing(s), np.random.default_rng(3)
    x0, weights = 0.3 * np.array([draw(rng), draw(rng)]), np.array([draw(rng), draw(rng)])
    gradients = []
    for threads in (1, 2):
        _, pullback = co.prepare(s, method, h, threads=threads).vjp(x0, (0.5, 0.5 - steps * h), save_every=steps)
        gradients.append(pullback([np.zeros_like(weights), weights])["x0"])
    np.testing.assert_array_equal(*gradients)
    for start, row, found in zip(x0, s.to_vector(weights), gradients[0], strict=True):
        x, taken = s.to_vector(start), []
        for k in range(steps):
            taken.append(method.linearized(s, x, 0.5 - k * h, -h))
            x = taken[-1].end
        for step in reversed(taken):
            row = step.cotangent(row)
        error = 2.0**4 * steps * UNIT_ROUNDOFF * np.abs(row).max()
        np.testing.assert_allclose(s.to_vector(found), row, rtol=0, atol=error)


@pytest.mark.parametrize("force", [(), (F.Friction(0.0),)], ids=["no force", "a friction of zero"])
@pytest.mark.parametrize("stages", [1, 2])
def test_the_gradient_of_a_casimir_is_that_at_the_start(stages, force):
    """Half the square of the state is constant: the cotangents of the streams of a step cancel up to round-off."""
    s, steps = co.systems.sphere_euler(N=24), 40
    x0 = drawing(s)(np.random.default_rng(4))
    ready = co.prepare(s.with_forces(*force) if force else s, co.IsospectralGauss(stages), 0.01)
    sol, pullback = ready.vjp(x0, (0.0, steps * 0.01), save_every=steps)
    weights = np.array([0.0 * x0, sol.x[-1]])
    gradient = pullback(weights)["x0"]
    np.testing.assert_allclose(gradient, x0, rtol=0, atol=2.0**4 * steps * UNIT_ROUNDOFF * np.abs(x0).max())
    np.testing.assert_array_equal(pullback(weights)["x0"], gradient)


def turning(x, t):
    """A component along an axis that turns, so that its gradient depends on the time."""
    return np.cos(0.5 * t) * x[1] + np.sin(0.5 * t) * x[2]


X = np.array([1.0, 0.2, 0.5])
PAIR = np.array([X, [0.5, 0.3, 0.9]])
END = co.Event("x2", terminal=True)
EVENTS = {
    "forward": (BODY, co.Splitting(order=4), X, (0.5, 20.5), {"events": END, "save_every": 3, "attitude": True}),
    "backward": (BODY, co.Splitting(), X, (0.5, -19.5), {"events": END, "t_eval": [0.43, -0.2, -1.5, -8.0]}),
    "turning": (BODY, co.GaussLegendre(2), X, (0.5, 10.5), {"events": co.Event(turning, count=2, terminal=True),
        "save_every": 7}),
    "polynomial": (BODY, co.Splitting(order=4), X, (0.5, 5.5), {"events": co.Event(co.Polynomial({(0, 1, 1): 1.0, (1,
        0, 0): -0.03}))}),
    "step by step": (TOP, co.Taylor(order=4), X6, (0.0, 0.7), {"events": co.Event(2)}),
    "in time": (timed, co.GaussLegendre(2), X, (0.5, 20.5), {"events": co.Event("x2", count=2, terminal=True),
        "save_every": 7}),
    "ensemble": (BODY, co.Splitting(order=4), PAIR, (0.5, 20.5), {"events": END, "save_every": 3, "attitude": True}),
    "forces": (forced(BODY, (F.LinearDamping, {"rate": 0.1, "toward": 0.0})), co.Splitting(order=4), X, (0.5, 20.5),
        {"events": END}),
}  # fmt: skip


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", EVENTS)
def test_derivatives_of_crossings_and_of_the_runs_that_they_end(name):
    build, method, x0, span, options = EVENTS[name]
    assert_derivatives(build, method, x0, span, 0.1, **options)


def test_observed_quantities_of_the_time_move_with_the_crossing_that_ends_a_run():
    observe = {"clock": lambda x, t: t, "both": lambda x, t: x[0] * t**2, "state": lambda x: x[2] ** 2}
    ready = co.prepare(BODY({}), co.Splitting(order=4), step=0.05, observe=observe)
    event = co.Event(lambda x: x[1] + 0.2, terminal=True)
    sol, pullback = ready.vjp(X, (1.0, 21.0), save_every=7, events=event)
    assert sol.t[-1] < 20.0
    weights = {name: np.random.default_rng(k).standard_normal(len(sol.t)) for k, name in enumerate(observe)}
    found, direction = pullback(observed=weights)["x0"], np.array([0.5, -1.0, 0.3])

    def total(by):
        run = ready.run(X + by * direction, (1.0, 21.0), save_every=7, events=event)
        return sum(weights[name] @ run.observed[name] for name in observe)

    assert abs(found @ direction - difference(total)) <= DIFFERENCE_ERROR * np.abs(found * direction).sum()


def _functions(rng, count):
    """A function that is not defined at zero, where lanes without a member might call it."""
    pytest.importorskip("numba")

    def slope(x):
        if x <= 0.0:
            raise ValueError("outside")
        return -1.0 / x

    def curvature(x):
        if x <= 0.0:
            raise ValueError("outside")
        return 1.0 / x**2

    piece = co.Separable({0: (lambda x: -np.log(x), slope, curvature)})
    energies = [co.Quadratic(rng.uniform(0.5, 1.0, 3)) + piece for _ in range(count)]
    return [co.LiePoissonSystem(co.algebras.so(3), energy) for energy in energies]


@pytest.mark.parametrize(
    ("count", "method"),
    [(3, co.Splitting(compensated=True, parts="coordinates")), (9, co.Splitting(order=4, parts="coordinates"))],
    ids=str,
)
def test_members_with_functions_that_are_differentiated_together_have_the_bits_of_single_runs(count, method, capfd):
    """In both directions of time, between steps, and with members that share a system."""
    rng = np.random.default_rng(count)
    different = _functions(rng, count)
    systems = [*different, different[1]]
    x0, span = rng.uniform(0.2, 0.9, (count + 1, 3)), (1.0, 0.5) if count == 3 else (0.5, 1.0)
    options = {"t_eval": (0.9, 0.66, 0.5)[:: 1 if count == 3 else -1]}
    ready = co.prepare(co.batch(systems), method, H)
    directions = {name: rng.standard_normal((*v.shape, 2)) for name, v in [("x0", x0), *ready.parameters.items()]}
    sol, tangents = ready.jvp(x0, span, directions, **options)
    weights = {name: rng.standard_normal(value.shape) for name, value in outputs(sol).items()}
    gradient = ready.vjp(x0, span, **options)[1](**weights)
    assert "outside" not in capfd.readouterr().err
    for m in range(0, count + 1, 1 + count // 8):
        single = co.prepare(systems[m], method, H)
        alone, one = single.jvp(x0[m], span, {name: value[m] for name, value in directions.items()}, **options)
        assert np.array_equal(sol.x[:, m], alone.x)
        assert all(np.array_equal(value, outputs(tangents)[name][:, m]) for name, value in outputs(one).items())
        found = single.vjp(x0[m], span, **options)[1](**{name: value[:, m] for name, value in weights.items()})
        assert all(np.array_equal(gradient[name][m], value) for name, value in found.items())


def test_a_member_of_a_batch_whose_derivatives_overflow_leaves_those_of_the_others():
    """One member grows without bound along its direction; the others are those of a batch without it."""
    plane = co.algebras.get("A2,1")
    fields = [co.LiePoissonSystem(plane, co.Quadratic([0.0, 0.0], linear=(k, 0.0))) for k in (1, 2, 3)]
    ready, x0 = co.prepare(co.batch(fields), co.Splitting(), H), np.full((3, 2), 0.5)
    directions = {"x0": np.array([(0.0, 1.0), (0.0, 1e300), (0.0, 1.0)])}
    with pytest.raises(co.IntegrationError) as raised:
        ready.jvp(x0, (0.0, -16.0), directions)
    found = raised.value.derivatives.x
    for m in (0, 2):
        alone = co.prepare(fields[m], co.Splitting(), H).jvp(x0[m], (0.0, -16.0), {"x0": directions["x0"][m]})[1]
        assert np.array_equal(found[:, m], alone.x)


def test_members_of_an_ensemble_have_the_noise_of_their_numbers():
    """Also beyond the number that a loop takes at a time; gradients by shared parameters are sums over members."""
    base, _ = plain("A3,7")
    x0, last = np.random.default_rng(2).uniform(0.2, 0.6, (34, 3)), 33
    moving, span = {"HeatBath.temperature": np.array(0.5)}, (0.5, 0.5 + H)

    def run_from(stream):
        return co.prepare(base({}).with_forces(F.HeatBath(0.3, temperature=0.2, seed=5, stream=stream)), None, H)

    sol, tangents = run_from(0).jvp(x0, span, moving)
    weights = np.zeros_like(sol.x)
    weights[:, [1, last]] = 1.0
    gradient, total = run_from(0).vjp(x0, span)[1](weights), 0.0
    for m in (1, last):
        single, alone = run_from(m).jvp(x0[m], span, moving)
        assert np.array_equal(single.x, sol.x[:, m]) and np.array_equal(alone.x, tangents.x[:, m])
        found = run_from(m).vjp(x0[m], span)[1](np.ones((2, 3)))
        np.testing.assert_allclose(gradient["x0"][m], found["x0"], rtol=2.0**6 * UNIT_ROUNDOFF)
        total += found["HeatBath.temperature"]
    assert abs(total - gradient["HeatBath.temperature"]) <= 2.0**10 * UNIT_ROUNDOFF * abs(total)


@pytest.mark.parametrize("forces", [(), (F.LinearDamping(1e-4),)], ids=["free", "forced"])
@pytest.mark.parametrize("members", [1, 9])
def test_gradients_through_steps_that_contract_warn_of_their_errors(members, forces):
    """Flows are undone from the end of a step: what has contracted by exp(-h) has lost as many digits."""
    plain = co.LiePoissonSystem(co.algebras.get("A3_2"), co.Quadratic([1.0, 0.5, 0.3]))
    system = plain.with_forces(*forces) if forces else plain
    x0, direction, weight = (
        np.tile([0.7, -0.4, 0.6], (members, 1)),
        np.array([0.5, -1.0, 0.3]),
        np.array([0.2, 0.6, 1.0]),
    )
    for step, lost in ((0.5, False), (20.0, True)):
        ready = co.prepare(system, co.Splitting(order=2), step)
        sol, tangents = ready.jvp(x0, (0.0, 2 * step), {"x0": np.tile(direction, (members, 1))})
        weights = np.zeros_like(sol.x)
        weights[-1] = weight
        _, pullback = ready.vjp(x0, (0.0, 2 * step))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            warnings.simplefilter("ignore", co.LongWait)  # of a busy machine
            gradient = pullback(x=weights)["x0"]
        error = np.abs(gradient @ direction - tangents.x[-1] @ weight)
        size = np.abs(gradient * direction).sum(axis=1) + np.abs(tangents.x[-1] * weight).sum(axis=1)
        assert np.any(error > 2.0**-20 * size) == lost
        assert [warning.category for warning in caught] == [co.LargeStepWarning] * lost
        assert not lost or "jvp" in str(caught[0].message)


@pytest.mark.parametrize("method", [co.GaussLegendre(2), co.GaussLegendre(4)], ids=str)
@pytest.mark.parametrize("step", [0.25, 4.0])
def test_derivatives_of_long_steps(method, step):
    """The iteration for the derivatives of the stages converges for the smaller step, and not for the larger one."""
    ready, x0, span, direction = co.prepare(BODY({}), method, step), 2.0 * X3, (0.0, 4 * step), np.array([0.5, -1.0, 2])
    wanted = difference(lambda by: ready.end(x0 + by * direction, span))
    _, tangents = ready.jvp(x0, span, {"x0": direction}, save_every=4)
    np.testing.assert_allclose(tangents.x[-1], wanted, rtol=0, atol=8 * DIFFERENCE_ERROR * np.abs(wanted).max())
    gradient = ready.vjp(x0, span, save_every=4)[1](x=[np.zeros(3), np.ones(3)])["x0"]
    size = np.abs(gradient * direction).sum()
    assert abs(gradient @ direction - tangents.x[-1].sum()) <= 2.0**12 * UNIT_ROUNDOFF * size


def test_derivatives_where_products_of_their_iteration_overflow():
    """In a step so long that the changes of the diverging iteration pass the square root of the largest number."""
    ready, span, direction = (
        co.prepare(BODY({}), co.GaussLegendre(2), 3000.0),
        (0.0, 3000.0),
        np.array([0.5, -1.0, 2.0]),
    )
    wanted = difference(lambda by: ready.end(X3 + by * direction, span))
    _, tangents = ready.jvp(X3, span, {"x0": direction})
    np.testing.assert_allclose(tangents.x[-1], wanted, rtol=0, atol=8 * DIFFERENCE_ERROR * np.abs(wanted).max())


def test_substeps_of_driven_runs_and_shifted_energies_of_forced_ones():
    """A field that turns once in each step is another one in every substep.

    A Casimir is subtracted from the energy of the forced body; its factor of the attitude begins anew in each step.
    """
    driven = co.systems.spin_lattice("chain", 2, field=lambda t: [np.cos(60.0 * t), np.sin(60.0 * t), 0.3 * t])
    composed = co.Composition(co.GaussLegendre(2), (0.4, 0.2, 0.4))
    assert_derivatives(lambda changed: driven, composed, X6, (1.3, 1.0), 0.1)
    u = (0.1, 0.2, 0.3)
    build = forced(BODY, (F.LinearDamping, {"rate": 0.3, "toward": u}), (F.Torque, {"torque": u}))
    for x0, span in ((X3, (0.5, 0.75)), (np.array([X3, X3[::-1]]), (0.5, 0.375))):
        assert_derivatives(build, co.Splitting(order=4), x0, span, H, attitude=True)


def test_differences_by_an_entry_far_below_the_others_do_not_show_rounding():
    """Differences on the scale of the entry would lose ten digits."""
    found = []
    for entry in (0.0, 1e-9):
        M = [[1.0, entry, 0.1], [entry, 0.7, 0.0], [0.1, 0.0, 0.4]]
        ready = co.prepare(co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(M)), co.Kahan(), 0.05)
        _, tangents = ready.jvp(X3, (0.0, 0.2), {"M": np.eye(9)[3].reshape(3, 3)}, save_every=4)
        found.append(tangents.x[-1])
    assert np.abs(found[1] - found[0]).max() <= DIFFERENCE_ERROR


@pytest.mark.parametrize(
    "x0",
    [
        (-0.883, 0.828, 0.683, 0.774, 0.536, -0.629),
        pytest.param((0.781, -0.81, -0.715, -0.819, 0.426, 0.691), marks=pytest.mark.long),
    ],
    ids=str,
)
def test_differences_by_entries_that_change_the_parts_are_those_of_the_parts_here(x0):
    """The parts of this splitting are ordered anew where a moment changes by some 0.01."""
    assert_derivatives(named("manakov_top"), co.Projected(co.Splitting()), np.array(x0), (0.0, H), H)


@pytest.mark.parametrize(
    ("system", "parts", "x0"),
    [
        (TOP({}), "free_body", (0.0, 0.0, 0.0, 0.3, 0.1, 0.9)),
        (co.systems.heavy_top(inertia=(1.0, 1.0, 1.0)), "free_body", (0.0, 0.0, 0.0, 0.3, 0.1, 0.9)),
        (co.systems.spin_lattice(shape=2, exchange=1.3), "bonds", (0.6, 0.0, 0.8, -0.6, 0.0, -0.8)),
    ],
    ids=["top", "round top", "opposite spins"],
)
@pytest.mark.parametrize("members", [(), (40,)])
def test_bodies_at_rest_and_opposite_spins_have_derivatives(system, parts, x0, members):
    """Their rotation has no axis, but an angular velocity that is linear in the momentum."""
    x0, span, direction = np.array(x0), (0.5, 1.5), np.linspace(-1.0, 0.5, 6)
    ready = co.prepare(system, co.Splitting(order=2, parts=parts), 0.1)
    wanted = difference(lambda by: ready.end(x0 + by * direction, span))
    start, along = np.broadcast_to(x0, (*members, 6)), np.broadcast_to(direction, (*members, 6))
    sol, tangents = ready.jvp(start, span, {"x0": along}, save_every=10)
    np.testing.assert_allclose(tangents.x[-1], np.broadcast_to(wanted, (*members, 6)), atol=DIFFERENCE_ERROR)
    cotangent = np.zeros(sol.x.shape)
    cotangent[-1] = np.arange(1.0, 7.0)
    found = ready.vjp(start, span, save_every=10)[1](cotangent)["x0"]
    np.testing.assert_allclose(found @ direction, wanted @ np.arange(1.0, 7.0), atol=64 * DIFFERENCE_ERROR)


@pytest.mark.parametrize("method", [co.Splitting(order=2), co.GaussLegendre(2)], ids=str)
def test_parameters_do_not_move_coefficients_that_are_inputs(method):
    """The field of all spins acts on those coordinates that inputs have not replaced."""
    given = {"B": np.array([0.3, -0.2])}
    gradient = assert_derivatives(
        named("spin_lattice", shape=3, field=(0.1, 0.2, 0.3)), method, UNIT_SPINS, (0.0, 0.5),
        inputs={"B": (0, 7)}, values=given,
    )  # fmt: skip
    assert "field" in gradient and np.any(gradient["field"])


@pytest.mark.parametrize(
    ("name", "parameter", "order"),
    [("so(3)", "M", 4), ("so(3)", "linear", 2), ("A3,7", "linear", 4), ("so(4)", "M", 2), ("so(4)", "linear", 4)],
)
def test_derivatives_by_added_parts_have_the_order_of_the_scheme(name, parameter, order):
    """Of energies with full matrices; the reference has another scheme and a step that is eight times smaller."""
    algebra = plain(name)[0]({}).algebra
    n = algebra.dim
    B = np.random.default_rng(n).uniform(-0.2, 0.2, (n, n))
    system = co.LiePoissonSystem(algebra, co.Quadratic(np.eye(n) + B + B.T, linear=np.linspace(-0.3, 0.3, n)), sign=-1)
    x0, w = 0.3 + 0.4 * np.cos(1.0 + np.arange(n)), np.random.default_rng(1).uniform(-1.0, 1.0, n)
    direction = {parameter: np.diag(w) + B + B.T if parameter == "M" else w}

    def derivatives(method, count):
        ready = co.prepare(system, method, 1.0 / count, attitude="coadjoint")
        _, tangents = ready.jvp(x0, (0, 1), direction, count)
        return np.concatenate([tangents.x[-1], tangents.attitude[-1].ravel()]), tangents.rule

    wanted, _ = derivatives(co.GaussLegendre(4), 64)
    found = [derivatives(co.Splitting(order=order), count) for count in (16, 32)]
    assert found[0][1] == {parameter: "added part"}
    errors = [np.linalg.norm(value - wanted) for value, _ in found]
    # The next order of the error is at most some times the step larger or smaller.
    assert abs(np.log2(errors[0] / errors[1]) - order) < 0.6
    assert errors[1] < 40 * 32.0**-order * np.linalg.norm(wanted)


GIVEN = {"fields": [[3, 4], [5, 1]], "rotor": (0,)}
FOUR = {"fields": np.array([[0.3, 0.1], [0.2, 0.4]]), "rotor": np.array([-0.2])}


@pytest.mark.parametrize("scheme", ["order 4", "processed", "compensated"])
def test_undone_steps_give_the_same_gradient(scheme):
    ready = co.prepare(TOP({}), SCHEMES[scheme], 0.05, attitude=True, inputs=GIVEN)
    gradients = []
    for reverse in ("exact", "reversible"):
        sol, pullback = ready.vjp(X6, (0.0, 5.0), save_every=9, reverse=reverse, **FOUR)
        weights = {name: np.cos(np.arange(v.size)).reshape(v.shape) for name, v in outputs(sol).items()}
        gradients.append(pullback(**weights))
    for name in gradients[0]:
        for one, other in zip(*((g[name].values() if name == "inputs" else [g[name]]) for g in gradients), strict=True):
            # The states differ by rounding, whose growth over 100 steps is below 2^14 for these motions.
            np.testing.assert_allclose(other, one, rtol=0, atol=2.0**14 * UNIT_ROUNDOFF * max(1.0, np.abs(one).max()))
