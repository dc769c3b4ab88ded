"""Representations of objects: one short line, and a small table in notebooks."""

import dataclasses
import html
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


@pytest.mark.parametrize("system", [one for one in SYSTEMS if hasattr(one, "_repr_html_")], ids=lambda one: one.name)
def test_tables_of_systems(system):
    table = table_of(system)
    assert table.startswith("<table>") and table.endswith("</table>")
    assert len(re.findall("<tr>", table)) == len(re.findall("</tr>", table)) >= 3
    for text in (repr(system), table, repr(getattr(system, "casimirs", "")), repr(getattr(system, "hamiltonian", ""))):
        assert " at 0x" not in text
    assert len(repr(system)) < 270 and len(table) < 3000


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


@pytest.mark.parametrize("name", long_where(["torus_euler"], co.systems.names()))  # a metric of 2400 x 2400 numbers
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


def test_systems_of_long_numbers_and_names():
    rng = np.random.default_rng(5)
    for algebra in (co.algebras.so(3), co.algebras.so(4), co.algebras.get("A4,9", b=0.5)):
        n = algebra.dim
        A = rng.standard_normal((n, n))
        quadratic = co.Quadratic(A @ A.T, linear=rng.standard_normal(n))
        cubic = co.Polynomial({tuple(e): 1 / (k + 3) for k, e in enumerate(rng.integers(0, 3, (30, n)))})
        split = co.SplitHamiltonian([((k,), co.Quadratic(float(A[k, k]))) for k in range(n)])
        for H in (quadratic, cubic, split, co.Separable({k: (np.cosh, np.sinh) for k in range(n)})):
            system = co.LiePoissonSystem(algebra, H, name=LONG_NAME)
            check_representation(system, 550)
            for one in (system, system.with_forces(co.forces.LinearDamping(A @ A.T))):
                check_representation(one, 550)
                check_representation(co.prepare(one, co.GaussLegendre(2), 0.1), 700)
                check_representation(co.stepper(one, co.GaussLegendre(2), 0.1), 700)
                check_representation(co.batch([one, one]), 550)

    # Forces of the user, as dataclasses of arrays.
    @dataclasses.dataclass(frozen=True, eq=False)
    class Own(co.forces.LinearDamping):
        pass

    assert repr(Own(np.eye(3) / 3)) == "Own(rate=<tuple of shape (3, 3)>, toward=0.0)"


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


def rows_of(table):
    return {name: html.unescape(value) for name, value in re.findall("<tr><th>(.*?)</th><td>(.*?)</td></tr>", table)}


@pytest.mark.parametrize("count", [1, 2, 3, 6, 7, 8])
def test_table_names_six_coordinates_and_casimirs(count):
    system = co.systems.spin_lattice("chain", count, exchange=-0.5, field=(0.0, 0.25, 0.0))
    rows = rows_of(table_of(system))
    assert list(rows) == ["coordinates", "algebra", "Hamiltonian", "sign", "Casimirs", "parameters"]
    names = [f"S{axis}[{site}]" for site in range(1, count + 1) for axis in (1, 2, 3)]
    assert rows["coordinates"] == f"{3 * count}: {', '.join(names[:6])}" + (", ..." if count > 2 else "")
    squares = [f"|x|^2 [{k}] = S1[{k}]^2 + S2[{k}]^2 + S3[{k}]^2" for k in range(1, count + 1)]
    if count == 1:
        squares = [squares[0].replace("|x|^2 [1]", next(iter(system.casimirs)))]
    assert rows["Casimirs"] == ", ".join(squares[:6] + ([f"and {count - 6} more"] if count > 6 else []))
    assert rows["algebra"] == system.algebra.name and rows["sign"] == "+1"
    H = system.hamiltonian
    assert rows["Hamiltonian"] == (str(H.to_polynomial().named(names)) if count < 3 else repr(H))
    for name, value in system.parameters.items():
        assert f"{name} = {value!r}" in rows["parameters"]


def test_tables_of_unnamed_systems():
    g = co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1.0}})
    rows = rows_of(table_of(co.LiePoissonSystem(g, co.Quadratic([1.0, 2.0]), sign=-1, name="<own>")))
    assert rows == {
        "coordinates": "2: x1, x2",
        "algebra": "without a name",
        "Hamiltonian": "0.5*x1^2 + x2^2",
        "sign": "-1",
        "Casimirs": "none is known",
    }
    curved = co.PoissonSystem(lambda x: x[0] * np.array([[0.0, 1.0], [-1.0, 0.0]]), co.Quadratic([1.0, 1.0]))
    rows = rows_of(table_of(curved))
    assert rows["algebra"] == "none" and rows["coordinates"] == "2: x1, x2" and "parameters" not in rows
    forced = co.systems.heavy_top().with_forces(co.forces.LinearDamping(0.1))
    rows = rows_of(table_of(forced))
    assert rows["coordinates"] == "6: m1, m2, m3, gamma1, gamma2, gamma3" and rows["algebra"] == "e(3)"
    assert "LinearDamping" in " ".join(rows.values())


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


def test_table_of_a_certificate():
    found = co.certify(co.systems.rigid_body(inertia=(1, 2, 3)), co.Splitting(), (1.0, 0.2, 0.1), 0.1, steps=20)
    table = table_of(found)
    assert table.count("<tr>") == len(found.rows) + 1 and "passed: every declared property holds" in table
    for row in found.rows:
        assert f"<th>{row.what}</th><td>{row.declared}</td><td>{row.verdict}</td>" in table
    assert "<td>declared</td><td>verdict</td><td>measured</td>" in table
