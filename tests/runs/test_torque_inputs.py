"""Torques as inputs have the bits of a new system with these torques, for every scheme and many algebras."""

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import coadjoint as co
from coadjoint.algebra.families.phase_space import moments
from coadjoint.kernels.tables import forces as force_tables
from verification.schemes_under_test import schemes, serves
from verification.systems_under_test import full_matrix

pytestmark = pytest.mark.thinned(3)

STEP, SPANS = 0.0625, ((0.0, 0.5), (0.5, 0.0))
ALGEBRAS = {
    "so(3)": (co.algebras.so(3), -1),
    "e(3)": (co.algebras.e(3), +1),
    "so(4)": (co.algebras.so(4), -1),
    "A3,7": (co.algebras.get("A3,7", a=1.75), +1),
    "moments": (moments(4), -1),
}
INPUTS = {"fins": "Torque 2", "field": (2, 0), "jets": "Torque"}


def unforced(name):
    algebra, sign = ALGEBRAS[name]
    n = algebra.dim
    return co.LiePoissonSystem(algebra, co.Quadratic(full_matrix(n, n), linear=np.linspace(-0.1, 0.1, n)), sign)


def forced(name, jets, fins):
    """Two torques among dampings, one of which needs the gradient of H."""
    damping, drag = co.forces.LinearDamping(0.1), co.forces.DoubleBracketDamping(0.01)
    return unforced(name).with_forces(co.forces.Torque(jets), drag, co.forces.Torque(fins), damping)


def numbers(name, *members):
    """Return a state, the initial torques and fields, and others, or those of members."""
    n, rng = ALGEBRAS[name][0].dim, np.random.default_rng(4)
    sizes = {"jets": n, "fins": n, "field": 2}
    before, after = ({key: rng.uniform(-0.4, 0.4, (*k, m)) for key, m in sizes.items()} for k in ((), members))
    return rng.uniform(0.2, 0.5, n), before, after


def assert_same(one, other):
    assert np.array_equal(one.x, other.x) and np.array_equal(one.energy, other.energy)
    assert one.balance().keys() == other.balance().keys()
    for name in other.balance():
        assert one.balance()[name] == other.balance()[name]
    assert sorted(one.work) == sorted(other.work) == ["DoubleBracketDamping", "LinearDamping", "Torque", "Torque 2"]
    for force, done in other.work.items():
        for name, values in done.items():
            assert np.array_equal(one.work[force][name], values)
    assert one.attitude is None or np.array_equal(one.attitude, other.attitude)


FAMILIES = ("Splitting 4", "Composition of Splitting", "GaussLegendre 3", "rk4", "RadauEnergy 2", "Taylor 5")
PAIRS = [
    (scheme, name)
    for name in ALGEBRAS
    for scheme, method in schemes().items()
    if (name == "e(3)" or scheme in FAMILIES) and "free body" not in scheme and serves(method, unforced(name))
]


@pytest.mark.thinned(33)
@pytest.mark.parametrize(("scheme", "name"), PAIRS)
def test_run_with_torques_equals_run_of_a_new_system(scheme, name):
    method = schemes()[scheme]
    x, before, after = numbers(name)
    attitude = False if method.properties(unforced(name)).attitude == "none" else "coadjoint"
    system = forced(name, before["jets"], before["fins"])
    ready = co.prepare(system, method, STEP, inputs=INPUTS, attitude=attitude)
    changed = forced(name, after["jets"], after["fins"])
    linear = np.linspace(-0.1, 0.1, system.dim)
    linear[[2, 0]] = after["field"]
    H = co.Quadratic(full_matrix(system.dim, system.dim), linear=linear)
    changed = co.LiePoissonSystem(system.algebra, H, system.sign).with_forces(*changed.forces)
    for span in SPANS:
        sol = ready.run(x, span, 3, **after)
        assert_same(sol, co.integrate(changed, x, span, STEP, ready.method, attitude=attitude, save_every=3))
    assert sol.system.forces == changed.forces and np.array_equal(sol.system.hamiltonian.terms()[0].form.linear, linear)
    assert_same(ready.run(x, SPANS[0]), co.integrate(system, x, SPANS[0], STEP, ready.method, attitude=attitude))


@pytest.mark.parametrize("parts", ["auto", "free_body"])
def test_changing_thruster_matches_the_closed_form(parts):
    """A symmetric body with N about its axis: x3 is the integral of N, the phase that of x3 (1/2 - 1)."""
    body = co.systems.rigid_body(inertia=(1.0, 1.0, 2.0)).with_forces(co.forces.Torque((0.0, 0.0, 0.0)))
    ready = co.prepare(body, co.Splitting(parts=parts), 0.125, inputs={"thruster": "Torque"})
    x, spin, phase = np.array([0.5, -0.2, 0.8]), 0.8, 0.0
    start = x[0] + 1j * x[1]
    for k, N in enumerate((0.4, 0.0, -1.5, 0.75)):
        x = ready.run(x, (0.5 * k, 0.5 * k + 0.5), 4, thruster=(0.0, 0.0, N)).x[-1]
        phase += -0.5 * (0.5 * spin + N * 0.125)
        spin += 0.5 * N
    assert abs(x[2] - spin) < 64 * 2.0**-53
    assert abs(x[0] + 1j * x[1] - start * np.exp(-1j * phase)) < 64 * 2.0**-53
    assert np.array_equal(ready.run(x, (0, 1)).x, co.integrate(body, x, (0, 1), 0.125, ready.method).x)


@pytest.mark.parametrize("scheme", ["Splitting 2", "GaussLegendre 2", "Projected(base=Splitting(order=2))"])
@pytest.mark.parametrize("name", ["e(3)", "A3,7"])
def test_torques_and_noise_per_member(scheme, name):
    x, before, after = numbers(name, 5)
    bath = co.forces.HeatBath(0.1, temperature=0.1, seed=7)
    system = forced(name, before["jets"], before["fins"]).with_forces(bath)
    ready = co.prepare(system, schemes()[scheme], STEP, inputs=INPUTS, threads=2)
    states = x * np.linspace(0.8, 1.2, 5)[:, None]
    sol = ready.run(states, SPANS[0], **after)
    together = co.integrate(sol.system, states, SPANS[0], STEP, ready.method)
    assert np.array_equal(sol.x, together.x) and np.array_equal(sol.energy, together.energy)
    assert sol.system[3].forces[2] == co.forces.Torque(after["fins"][3])
    some = ready.run(x, SPANS[0], jets=after["jets"])
    assert np.array_equal(some.x, ready.run(np.tile(x, (5, 1)), SPANS[0], jets=after["jets"]).x)
    assert some.work["Torque 2"]["energy"].shape == (9, 5) and np.ptp(some.x[-1], axis=0).min() > 0.0
    shared = ready.run(states, SPANS[0], fins=after["fins"][1])
    assert np.array_equal(shared.x[:, 0], ready.run(states[0], SPANS[0], fins=after["fins"][1]).x)


def test_threads_share_a_run_and_its_tables(monkeypatch):
    x, before, after = numbers("so(4)", 8)
    system = forced("so(4)", before["jets"], before["fins"])
    ready = co.prepare(system, co.Splitting(), STEP, inputs=INPUTS, threads=1)
    own = [{key: values[m] for key, values in after.items()} for m in range(8)]
    expected = [co.integrate(ready.run(x, (0, 1), **one).system, x, (0, 1), STEP, ready.method).x for one in own]

    def refuse(*_):
        raise AssertionError

    monkeypatch.setattr(co.Splitting, "loop", refuse)
    monkeypatch.setattr(force_tables, "forced_loop", refuse)
    gate = threading.Barrier(8)

    def work(m):
        gate.wait()
        return [ready.run(x, (0, 1), **own[m]).x for _ in range(3)]

    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(work, range(8)))
    assert all(np.array_equal(x, expected[m]) for m, runs in enumerate(found) for x in runs)


@pytest.mark.parametrize("h", [0.125, -0.125])
def test_stepper_with_torques(h):
    x, before, after = numbers("e(3)")
    for method in (co.Splitting(order=2), co.GaussLegendre(2)):
        step = co.stepper(forced("e(3)", before["jets"], before["fins"]), method, h, inputs=INPUTS)
        y = step(x, **after)
        moved, K = step.both(x, attitude="coadjoint", **after)
        assert np.array_equal(moved, y) and np.array_equal(K, step.group(x, attitude="coadjoint", **after))
        near = [(step(x + d, **after) - step(x - d, **after)) / 2e-5 for d in 1e-5 * np.eye(6)]
        assert np.abs(step.tangent(x, **after) - np.transpose(near)).max() < 1e-8
        # The half flows of the jets are the first and the last of a step, y = F(x + h/2 N) + h/2 N.
        jets = after["jets"] + np.eye(6)[4] * 2.0**-20
        last = step(x, **{**after, "jets": jets}) - y
        assert np.abs(last - 0.5 * h * 2.0**-20 * (step.tangent(x, **after)[:, 4] + np.eye(6)[4])).max() < 1e-10


def test_torque_inputs_beside_functions():
    whole = co.Hamiltonian(lambda x: x[0] ** 2 + x[1] ** 4, lambda x: np.array([2 * x[0], 4 * x[1] ** 3, 0.0]))
    drag = co.forces.OwnForce(lambda x, t, tau: x * np.exp(-0.1 * tau), name="drag")
    wave = co.forces.Torque(lambda t: np.array([0.0, np.sin(t), 0.1]))
    sl = co.LiePoissonSystem(co.algebras.sl(2), whole).with_forces(wave, co.forces.Torque((0.1, 0.0, 0.0)))
    x, N = np.array([0.4, -0.3, 0.5]), np.array([0.2, 0.7, -0.1])
    sol = co.prepare(sl, co.GaussLegendre(2), STEP, inputs={"N": "Torque 2"}).run(x, SPANS[0], N=N)
    changed = sl.system.with_forces(wave, co.forces.Torque(N))
    assert np.array_equal(sol.x, co.integrate(changed, x, SPANS[0], STEP, co.GaussLegendre(2)).x)
    with pytest.raises(TypeError, match="Hamiltonian, which has no linear term"):
        co.prepare(sl, co.GaussLegendre(2), STEP, inputs={"N": "Torque 2", "field": (0,)})
    for label, kind in (("Torque", "Torque"), ("drag", "OwnForce")):
        with pytest.raises(TypeError, match=rf"inputs has '{label}' for N, which is .{kind}\(.*only a constant Torque"):
            co.prepare(sl.with_forces(drag), co.GaussLegendre(2), STEP, inputs={"N": label})


def test_wrong_torque_inputs_are_refused():
    body = co.systems.rigid_body((1, 2, 3))
    pushed = body.with_forces(co.forces.Torque((0, 0, 1)), co.forces.LinearDamping(0.1))
    given = [
        (ValueError, "unknown force 'Torqe'; did you mean 'Torque'", pushed, {"N": "Torqe"}),
        (ValueError, "'Torque' more than once", pushed, {"N": "Torque", "M": "Torque"}),
        (TypeError, "'LinearDamping' for N, which is 'LinearDamping", pushed, {"N": "LinearDamping"}),
        (TypeError, "give each torque a name", pushed, "Torque"),
        (ValueError, "'Torque' for N, and rigid_body has no forces", body, {"N": "Torque"}),
        (ValueError, "'t', which is reserved", pushed, {"t": "Torque"}),
    ]
    for kind, words, system, inputs in given:
        with pytest.raises(kind, match=words):
            co.prepare(system, None, 0.1, inputs=inputs)
    ready = co.prepare(pushed, None, 0.1, inputs={"N": "Torque"})
    for kind, words, torque in (
        (ValueError, r"N has the shape \(2,\).*\(3,\), or \(members, 3\)", (1, 2)),
        (ValueError, "N contains NaN or infinity", (0, np.inf, 0)),
        (TypeError, "N is 'full'", "full"),
    ):
        with pytest.raises(kind, match=words):
            ready.run((0.1, 1.0, 0.2), (0, 1), N=torque)
    with pytest.raises(ValueError, match="tangent is taken at one state"):
        co.stepper(pushed, co.Splitting(), 0.1, inputs={"N": "Torque"}).tangent((0.1, 1.0, 0.2), N=np.zeros((2, 3)))
