"""Representations of objects: one short line, and a small table in notebooks."""

import re
from operator import methodcaller

import numpy as np
import pytest

import coadjoint as co
from long import long_where

table_of = methodcaller("_repr_html_")


H = co.Hamiltonian(lambda x, t: np.cos(t) * x[2] + 0.5 * x[0] ** 2, lambda x, t: np.array([x[0], 0.0, np.cos(t)]))
BODY = co.systems.rigid_body((1, 2, 3))
SYSTEMS = [*map(co.systems.get, co.systems.names()), co.systems.spin_lattice("chain", 100)]
SYSTEMS += [BODY.with_forces(co.forces.LinearDamping(0.1), co.forces.Torque((0, 0, 1)))]
SYSTEMS += [co.LiePoissonSystem(co.algebras.so(3), H, name="driven")]


LONG_NAME = "x" * 200
FORCES = (
    lambda s: co.forces.LinearDamping(0.1),
    lambda s: co.forces.LinearDamping(np.linspace(1 / 3, 1.0, s.dim)),
    lambda s: co.forces.LinearDamping(np.eye(s.dim) / 3),
    lambda s: co.forces.Torque(np.full(s.dim, 1 / 3)),
    lambda s: co.forces.Torque(lambda x, t: np.zeros(s.dim)),
    lambda s: co.forces.DoubleBracketDamping(0.1, metric=np.eye(s.dim) / 7),
    lambda s: co.forces.HeatBath(0.1, temperature=0.5, seed=1),
    lambda s: co.forces.OwnForce(lambda x, t, tau: x, name=LONG_NAME),
    lambda s: co.forces.Viscosity(1e-6, power=4),
    lambda s: co.forces.RandomForcing(0.02, band=(2, 3), seed=1),
    lambda s: co.forces.TransportNoise((1, 2), 0.1, seed=1),
    lambda s: co.forces.BetaPlane(1 / 3),
)


def check_representation(value, limit):
    """One line, of bounded length, whose brackets are closed and whose numbers are not cut."""
    text = repr(value)
    assert text.isprintable() and len(text) <= limit, text
    assert " at 0x" not in text and "<<" not in text
    for opening, closing in ("()", "[]", "{}"):
        assert text.count(opening) == text.count(closing), text
    # Three dots stand for a whole part.
    assert not re.search(r"[\d.]\.\.\.", text), text


@pytest.mark.parametrize(
    "name", long_where(["layered_qg", "thermal_qg", "torus_euler", "torus_qg"], co.systems.names())
)  # metrics of 2400 rows
def test_systems_with_forces_and_batches_are_one_line(name):
    system = co.systems.get(name)
    check_representation(system, 260)
    forced = []
    for make in FORCES:
        try:
            forced.append(system.with_forces(make(system)))
        except (TypeError, ValueError):
            continue  # not a force of this system
    assert forced
    for one in forced:
        check_representation(one, 400)
        for force in one.forces:
            assert repr(force) == str(force) and repr(force) in repr(one)
        assert f"<{name} with forces, dimension {system.dim}: " in repr(one)
    many = system.with_forces(*[force for one in forced for force in one.forces if not force.random] * 9)
    check_representation(many, 500)
    if not isinstance(system, co.MatrixSystem):
        for member in (system, many):
            check_representation(co.batch([member, member]), 400)


def results():
    """Yield results of the functions of the library that hold arrays."""
    body, x0 = co.systems.rigid_body(inertia=(1, 2, 2.5)), (1.0, 0.2, 0.1)
    method = co.Splitting()
    sol = co.integrate(body, x0, (0, 50), 0.1, attitude=True, events=co.Event(1))
    yield from (sol, sol.events, sol.casimirs, sol.stats, sol.at([0.1, 0.2]), sol.at(0.1), sol.drift())
    yield co.equilibrium(body, (0.9, 0.1, 0.1))
    lines = co.frequencies(sol, None, 3)
    yield from (lines, lines.combinations(), co.frequencies(sol, 1, 10))
    yield co.analysis.fit_order([0.4, 0.2, 0.1], [1.6e-3, 4e-4, 1e-4], [1e-16] * 3)
    yield co.analysis.fit_order(np.linspace(0.1, 0.4, 30), np.linspace(0.1, 0.4, 30) ** 2)
    yield co.analysis.growth(np.linspace(0.0, 50.0, 500), np.linspace(0.0, 1.0, 500))
    yield from (co.methods.gauss_tableau(3), co.modified_hamiltonian(body, method, order=2))
    yield from (co.prepare(body, method, 0.1).jvp(x0, (0, 1), {"x0": x0})[1], co.choose(body, x0, (0, 10), 1e-6))
    yield from (co.lyapunov(body, x0, (0, 10), 0.1), co.poincare_section(body, x0, co.Event(1), (0, 50), 0.1))
    yield from (co.phase_drift(sol), co.certify(body, method, x0, 0.1, steps=10), co.make_corrector(body, method, x0))


def test_results_are_one_line():
    for result in results():
        check_representation(result, 700)


def test_runs_and_states_at_times():
    sol = co.integrate(BODY, (1, 0.2, 0.1), (0, 1), 0.1, attitude=True)
    assert repr(sol) == "<solution of rigid_body by Splitting(order=2): 11 points from t = 0 to 1, step 0.1>"
    table = table_of(sol)
    assert "<b>rigid_body by Splitting(order=2)</b>" in table and "11 points from t = 0 to 1" in table
    assert f"<th>drift of energy</th><td>{sol.drift()['energy']:.2g}</td>" in table
    ensemble = co.integrate(BODY, np.ones((4, 3)), (0, 1), 0.1)
    assert repr(ensemble).endswith("step 0.1, 4 members>") and "<th>members</th><td>4</td>" in table_of(ensemble)
    one, many = repr(sol.at(0.33)), repr(sol.at(np.linspace(0, 1, 1000)))
    assert one.startswith("<states at t = 0.33: x [") and "attitude of shape (3, 3)" in one and "\n" not in one
    assert many.startswith("<states at 1000 times: x of shape (1000, 3), energy of shape (1000,)") and len(many) < 200
    spins = co.integrate(co.systems.spin_lattice("ring", 9), np.tile([0.6, 0.0, 0.8], 9), (0, 1), 0.125)
    assert repr(spins.at(0.5)).endswith("and 5 more}>")


def test_functions_show_no_address():
    for value, text in (
        (co.Event(lambda x: x[0]), "Event(g=a lambda, direction=0, count=None, terminal=False, name=None)"),
        (co.forces.Torque(lambda t: np.zeros(3)), "Torque(torque=a lambda)"),
        (
            co.forces.OwnForce(lambda x, t, tau: x),
            "OwnForce(function=a lambda, name='own force', keeps_casimirs=False, backward=True)",
        ),
        (co.forces.Torque((0, 0, 1)), "Torque(torque=(0.0, 0.0, 1.0))"),
    ):
        assert repr(value) == text
