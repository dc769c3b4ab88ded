"""Poles of Kahan's method: a solution that jumps through infinity does so with a warning."""

import warnings

import numpy as np
import pytest

import coadjoint as co
from coadjoint.methods.numerics.quadratic_field import QuadraticField
from coadjoint.runs import passed_poles as module
from coadjoint.runs.passed_poles import passed_pole

# x2' = x2^2 and x1' = -x1 x2; the solution x2 = 1 / (1 / x2(0) - t) is that of Kahan's method too.
RICCATI = co.LiePoissonSystem(co.algebras.get("A2,1"), co.Quadratic(np.array([[0.0, -1.0], [-1.0, 0.0]])))
FOURTH = co.Composition(co.Kahan(), (1 / (2 - 2 ** (1 / 3)), 1 - 2 / (2 - 2 ** (1 / 3)), 1 / (2 - 2 ** (1 / 3))))


def warned_of(system, x0, end, step=0.3, method=None, **options):
    """Return the solution and the messages of its warnings of poles."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        sol = co.integrate(system, x0, (0, end), step, method or co.Kahan(), **options)
    return sol, [str(one.message) for one in caught if "pole" in str(one.message)]


@pytest.mark.parametrize("side", [1, -1])
def test_the_step_over_the_pole_is_found(side):
    """After 10 = 1 / (1 - 0.9) follows -5; every step is exact, so no half steps show it."""
    sol, messages = warned_of(RICCATI, (0.0, side), side * 3.0)
    assert sol.x[3:5, 1] == pytest.approx([10.0 * side, -5.0 * side])
    assert sol.step_error() == np.inf
    assert len(messages) == 1 and f"at t = {0.9 * side:g}:" in messages[0]
    assert warned_of(RICCATI, (0.0, side), side * 0.9)[1] == []
    assert warned_of(RICCATI, (0.0, -side), side * 3.0)[1] == []


@pytest.mark.parametrize("every", [2, 5, 10])
def test_between_saved_points_the_steps_are_repeated(every):
    _, messages = warned_of(RICCATI, (0.0, 1.0), 3.0, save_every=every)
    assert len(messages) == 1 and "at t = 0.9:" in messages[0]
    assert len(warned_of(RICCATI, (0.0, 1.0), 3.0, t_eval=[0.0, 0.5, 3.0])[1]) == 1


def test_members_and_systems():
    """The member whose pole comes first is named, also behind members that do not move."""
    starts = np.array([(1.0, 0.0), (0.0, -1.0), (0.0, 0.7), (0.0, 1.0)])
    assert warned_of(RICCATI, starts, 3.0)[1][0].startswith("the motion of member 3 passed through a pole")
    twin = co.LiePoissonSystem(RICCATI.algebra, co.Quadratic(np.array([[0.0, -2.0], [-2.0, 0.0]])))
    starts[3] = 0.0, -1.0
    several = co.batch([RICCATI, RICCATI, RICCATI, twin])
    assert warned_of(several, starts, 3.0)[1][0].startswith("the motion of member 2 passed through a pole")
    starts[3] = 0.0, 1.0
    assert warned_of(several, starts, 3.0)[1][0].startswith("the motion of member 3 passed through a pole")


def test_substeps_of_compositions_are_looked_at():
    """The first substep, 1.35 steps long, passes the pole in the second step, and Kahan's own step does not."""
    assert FOURTH.fractions[0] == pytest.approx(1.3512, abs=1e-4)
    # 1/x2 is 0.667, and after the three substeps 0.261, 0.772 and 0.367; 0.3 times 1.3512 is 0.405.
    assert warned_of(RICCATI, (0.0, 1.5), 0.3, method=FOURTH)[1] == []
    assert "at t = 0.3:" in warned_of(RICCATI, (0.0, 1.5), 0.6, method=FOURTH)[1][0]
    assert warned_of(RICCATI, (0.0, 1.5), 0.6)[1] == []


def test_random_systems_on_sl2_against_eigenvalues():
    """A pole is between 0 and h where f'(x) has a real eigenvalue of at least 2/h; H is not definite."""
    rng, counts = np.random.default_rng(5), [0, 0]
    for _ in range(30):
        M, linear, x0 = rng.normal(size=(3, 3)), rng.normal(size=3) / 2, rng.normal(size=3)
        system = co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic(M + M.T, linear=linear))
        h = 0.1 / np.linalg.norm(system.jacobian(x0), 2)
        sol, messages = warned_of(system, x0, 300 * h, h, save_every=10)
        fine, _ = warned_of(system, x0, 300 * h, h)
        roots = np.array([np.linalg.eigvals(system.jacobian(x)) for x in fine.x[:-1]])
        passed = bool(((abs(roots.imag) < 1e-9 * abs(roots)) & (roots.real >= 2 / h)).any())
        assert passed == bool(messages)
        counts[passed] += 1
        if passed:
            assert sol.step_error() == np.inf
    assert min(counts) >= 5


def test_structures_that_are_functions_have_the_same_poles():
    other = co.PoissonSystem(lambda x: np.array([[0.0, x[1]], [-x[1], 0.0]]), RICCATI.hamiltonian, RICCATI.sign, 2)
    assert "at t = 0.9:" in warned_of(other, (0.0, 1.0), 3.0)[1][0]


def test_what_is_not_examined():
    """Forces come between substeps; other schemes have no poles."""
    sol = warned_of(RICCATI, (0.0, 1.0), 3.0)[0]
    member = np.array([0])
    assert passed_pole(sol, RICCATI, co.Kahan(), member, 0.3).t == pytest.approx(0.9)
    assert passed_pole(sol, RICCATI, co.GaussLegendre(1), member, 0.3) is None
    damped = RICCATI.with_forces(co.forces.LinearDamping(0.1))
    assert passed_pole(sol, damped, co.Kahan(), member, 0.3) is None


def test_long_runs_are_examined_where_the_state_is_large(monkeypatch):
    """The determinants of a hundred of 3000 steps are computed, and the pole is among them."""
    monkeypatch.setattr(module, "EXAMINED", 400)
    monkeypatch.setattr(module, "COMPARED", 400)
    for every in (1, 10):
        assert len(warned_of(RICCATI, (0.0, 1.0005), 3.0, 1e-3, save_every=every)[1]) == 1


def test_prepared_runs_and_archives(tmp_path):
    ready = co.prepare(RICCATI, co.Kahan(), step=0.3)
    with pytest.warns(co.LargeStepWarning, match="passed through a pole"):
        ready.run((0.0, 1.0), (0, 3.0))
    # The first step of the run passes it, which is all that is known of an archive.
    with pytest.warns(co.LargeStepWarning, match="member 1 passed through a pole .* at t = 0:"):
        co.integrate_ensemble(RICCATI, [(0.0, 1.0), (0.0, 4.0)], (0, 3.0), 0.3, co.Kahan(), archive=tmp_path / "a")


@pytest.mark.parametrize("side", [1, -1])
def test_steps_after_the_end_of_the_run_or_of_a_member_do_not_count(side):
    """The pole at 1.45 lies in the ten steps after the saved point 1, but after the end of the run at 1.1 or 1.2."""
    start = (0.0, side / 1.45)
    assert "at t = 1.4:" in warned_of(RICCATI, start, side * 2.0, 0.1, save_every=10)[1][0].replace("-", "")
    assert warned_of(RICCATI, start, side * 1.1, 0.1, save_every=10)[1] == []
    assert warned_of(RICCATI, start, side * 1.1, 0.1, t_eval=[0.0, side * 1.0, side * 1.1])[1] == []
    end = co.Event(lambda x, t: abs(x[1]) - 4.0, terminal=True)  # reached at 1.2
    for members in ([start], [start, (0.0, side * 0.1)]):
        sol, messages = warned_of(RICCATI, members, side * 2.0, 0.1, save_every=10, events=end)
        assert messages == [] and sol.step_error() == 0.0


@pytest.mark.parametrize("h", [0.07, -0.3])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", ["so(3)", "e(3)", "A4,8", "sl(2)"])
def test_steps_from_many_states_are_those_of_the_scheme(name, sign, h):
    """Of a linear part, and of a constant one where J is a function with a constant part."""
    rng = np.random.default_rng(6)
    algebra = co.algebras.get(name)
    n = algebra.dim
    M, constant = rng.normal(size=(2, n, n))
    linear, *states = rng.normal(size=(5, n))
    states = np.array(states)
    H = co.Quadratic(M + M.T, linear=linear)
    plain = co.LiePoissonSystem(algebra, H, sign=sign)
    affine = co.PoissonSystem(lambda x: plain.structure_matrix(x) + (constant - constant.T), H, sign, n)
    for system in (plain, affine):
        field = QuadraticField.of(system)
        for x, slope in zip(states, field.derivative(states), strict=True):
            columns = [(system.vector_field(x + e) - system.vector_field(x - e)) / 2 for e in np.eye(n)]
            np.testing.assert_allclose(slope, np.transpose(columns), rtol=0, atol=1e-12)
        after, passed = field.step(states, h)
        expected = [co.Kahan().step(system, x, 0.0, h) for x in states]
        np.testing.assert_allclose(after, expected, rtol=1e-10, atol=1e-10)
        crossings = [np.linalg.eigvals(h / 2 * slope) for slope in field.derivative(states)]
        odd = [np.count_nonzero((abs(r.imag) < 1e-9) & (r.real > 1)) % 2 == 1 for r in crossings]
        assert passed.tolist() == odd


def test_the_search_is_short_where_few_points_are_saved(monkeypatch):
    """As many steps as determinants are allowed, whatever the number of steps between saved points."""
    taken, step = [], QuadraticField.step

    def counted(self, x, h):
        taken.append(len(x))
        return step(self, x, h)

    monkeypatch.setattr(QuadraticField, "step", counted)
    monkeypatch.setattr(module, "EXAMINED", 900)
    body = co.systems.rigid_body(inertia=(1.0, 2.0, 2.5))
    warned_of(body, (1.0, 0.2, 0.5), 200.0, 0.05, save_every=4000)
    assert sum(taken) == len(taken) == 100
