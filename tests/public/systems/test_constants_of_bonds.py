"""Exchange, Dzyaloshinskii-Moriya and biquadratic constants by name: derivatives, fits, members, archives, refusals."""

import importlib.util
from functools import cache

import numpy as np
import pytest

import coadjoint as co
from matrix.cases import value_of
from matrix.forces import force_on
from matrix.schemes import schemes
from refusals import refused
from same_runs import check_same

pytestmark = [
    pytest.mark.skipif(importlib.util.find_spec(name) is None, reason=f"{name} is not installed")
    for name in ("gemmi", "spglib")
]
pytestmark += [pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")]  # of schemes of order one

MODES = ("dipole", "SU(N)")
VALUES = {"exchange 1 A": -0.397, "exchange 1 B": -0.075, "exchange 1 C": -0.236, "exchange 1 D": -0.261, "J3": 0.113}
FORMS = np.array([np.diag([1.0, 0, 0]), np.diag([0, 1.0, 0]), np.diag([0, 0, 1.0]), [[0] * 3, [0, 0, 1], [0, 1, 0]]])


@cache
def iron():
    return co.spins.crystal(co.spins.structure("FeI2")).subcrystal("Fe")


def model(mode="dipole", change="nothing", **values):
    """Return six ions of iron(II) with a matrix on one class of bonds and one number on two others."""
    given, bonds = VALUES | values, iron().bonds(max_distance=8.5)
    J = np.tensordot([*given.values()][:4], FORMS, 1)
    found = co.systems.spins(iron(), (3, 2, 1), spin=1, units="meV", periodic=False, mode=mode)
    found = found.exchange(bonds["1"], J).exchange(bonds["3"], given["J3"], name="J3")
    found = found.exchange(bonds["5"], given["J3"], name="J3")
    if change == "dipoles":
        found = found.dipolar()
    if change == "ions":
        found = found.substitute("Fe", 0.4, seed=1, spin=2).vacancies(0.2, seed=1)
    return found


def start(system, seed=1):
    if hasattr(system, "levels"):
        return system.random(seed)
    x = np.random.default_rng(seed).standard_normal((system.dim // 3, 3))
    return (x / np.linalg.norm(x, axis=1, keepdims=True)).ravel()


def check_derivatives(change, mode, method, span=(0.3, -0.4), step=0.02):
    """Compare with differences of declared models, backward in time, and with the time in which the motion scales."""
    system, h = model(mode, change), 1e-3
    x, ready = start(system), co.prepare(system, method, step=step)
    sol, pullback = ready.vjp(x, span)
    end = np.random.default_rng(2).standard_normal(system.dim)
    gradient = pullback(x=np.concatenate([np.zeros((len(sol.x) - 1, system.dim)), end[None]]))
    for name, value in VALUES.items():
        assert ready.parameters[name] == value
        found = ready.jvp(x, span, {name: 1.0})[1].x[-1]
        up, down = (
            co.integrate(model(mode, change, **{name: value + s * h}), x, span, step, method).x[-1] for s in (1, -1)
        )
        expected = (up - down) / (2 * h)
        assert np.abs(expected).max() > 1e-3
        np.testing.assert_allclose(found, expected, atol=h * np.abs(expected).max())
        np.testing.assert_allclose(gradient[name], end @ found, rtol=1e-9, atol=1e-9 * np.abs(end @ expected))
    if change != "dipoles":  # the energy is linear in the constants: those of factor c move as the time c t does
        along = sum(value * ready.jvp(x, span, {name: 1.0})[1].x[-1] for name, value in VALUES.items())
        expected = (span[1] - span[0]) * system.vector_field(sol.x[-1])
        of_scheme = 50 * np.abs(sol.x[-1] - co.integrate(system, x, span, step / 2, method).x[-1]).max()
        assert np.abs(along - expected).max() < of_scheme + 1e-10


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("method", [co.Splitting(order=4), co.GaussLegendre(2)], ids=str)
def test_derivatives_by_exchange_constants(mode, method):
    check_derivatives("nothing", mode, method)


@pytest.mark.parametrize("change", ["dipoles", "ions"])
def test_derivatives_beside_dipoles_and_other_ions(change):
    check_derivatives(change, "dipole", co.GaussLegendre(1))


@pytest.mark.parametrize("mode", MODES)
def test_every_scheme_that_takes_the_model_has_the_derivatives(mode):
    """Of every registered scheme that differentiates a run by the start: by differences, to the error of the scheme."""
    tried, x, span, h = 0, start(model(mode)), (0.1, 0.3), 1e-3

    def by_differences(method):
        ends = (co.integrate(model(mode, J3=VALUES["J3"] + s * h), x, span, 0.02, method).x[-1] for s in (1, -1))
        return np.subtract(*ends) / (2 * h)

    exact = by_differences(co.GaussLegendre(3))
    for text in (text for text in schemes() if "user." not in text):  # whose steps are Python calls here
        try:
            ready = co.prepare(model(mode), value_of(text), step=0.02)
            ready.jvp(x, span, {"x0": x})
        except (TypeError, ValueError):
            continue
        found, expected = ready.jvp(x, span, {"J3": 1.0})[1].x[-1], by_differences(value_of(text))
        allowed = 1e-4 * np.abs(exact).max() + 4 * np.abs(expected - exact).max()  # each has errors of this order
        np.testing.assert_allclose(found, expected, rtol=0, atol=allowed, err_msg=text)
        tried += 1
    assert tried > 20


@pytest.mark.parametrize(("mode", "change"), [*((mode, "nothing") for mode in MODES), ("dipole", "dipoles")])
def test_exchange_constants_are_fitted(mode, change):
    """Exact data are fitted to round-off, and the fitted model, its text and its system have the fitted constants."""
    method = co.GaussLegendre(1) if change == "dipoles" else co.Splitting(order=4)
    x, span = start(model(mode)), (1.0, 1.4)
    measured = {"x": co.integrate(model(mode, change), x, span, 0.05, method).x}
    guess = co.prepare(model(mode, change, **{name: 1.1 * value for name, value in VALUES.items()}), method, step=0.05)
    found = co.fit(guess, x, span, measured, dict.fromkeys(VALUES, True), sigma={"x": 0.01})
    for name, value in VALUES.items():
        assert abs(found.values[name] - value) < 1e-9
    fitted = found.solution.system
    assert np.abs(co.prepare(fitted, method, step=0.05).parameters["J3"] - found.values["J3"]) == 0.0
    assert f"bond 3: J3 = {float(found.values['J3'])!r}" in str(fitted)
    assert f"bond 5: J3 = {float(found.values['J3'])!r}" in str(fitted)
    assert abs(fitted.energy(x) - model(mode, change).energy(x)) < 1e-9


def test_unknown_names_of_a_fit_list_what_is_there():
    x, ready = start(model()), co.prepare(model(), co.Splitting(order=4), step=0.05)
    measured = {"x": ready.run(x, (0, 0.2)).x}

    def fitted(**unknown):
        return co.fit(ready, x, (0, 0.2), measured, unknown, sigma={"x": 0.01})

    with refused(
        ValueError, "parameter, state or attitude of this run 'exchange 1'; there are: " + ", ".join([*VALUES][:4])
    ):
        fitted(**{"exchange 1": True})
    with pytest.raises(ValueError, match="'A Fe 0'; there are: J3, ") as caught:
        fitted(**{"A Fe 0": True})
    assert "mean" not in str(caught.value)
    found = fitted(J3=True)
    assert found.standard_deviation("J3").shape == found.values["J3"].shape == ()
    assert found.standard_deviation("J3") == np.sqrt(found.covariance[0, 0])
    with refused(ValueError, "exchange 1 A was not fitted", "fitted were: J3"):
        found.standard_deviation("exchange 1 A")


def test_all_constants_of_bonds():
    """Numbers, matrices, vectors and K, of one name or several, on a bond without symmetry; the sum of all is H."""
    crystal = co.spins.crystal(lattice=(1, 3, 4, 90, 80, 90), sites={"Cu": (0, 0, 0)}, space_group="P 1")
    first, second = crystal.bonds(max_distance=2)
    J = np.array([[0.1, 0.2, -0.3], [0.5, 0.4, 0.6], [0.7, -0.9, 0.8]])
    for mode in MODES:
        chain = co.systems.spins(crystal, (4, 1, 1), spin=1, periodic=False, mode=mode)
        spins = chain.exchange(first, J).exchange(second, J, name="far").biquadratic(first, 0.3, name="K")
        spins = spins.dzyaloshinskii_moriya(first, (0.1, 0.0, 0.2)).biquadratic(second, 0.3, name="K")
        spins = spins.dzyaloshinskii_moriya(second, (0.1, 0.0, 0.4), name="D2")
        known = co.prepare(spins, co.GaussLegendre(2), step=0.02).parameters
        symmetric = [J[0, 0], J[1, 1], J[2, 2], 0.35, 0.2, -0.15]
        for name in ("exchange 1", "far"):
            found = [known[f"{name} {letter}"] for letter in "ABCDEFGHI"]
            np.testing.assert_allclose(found, [*symmetric, 0.75, 0.5, -0.15], atol=1e-15)  # and D_x, D_y, D_z
        assert [known[f"D2 {letter}"] for letter in "GHI"] == [0.1, 0.0, 0.4] and known["K"] == 0.3
        assert [known[f"dzyaloshinskii_moriya 1 {letter}"] for letter in "GHI"] == [0.1, 0.0, 0.2]
        x, names = start(spins), [name for name in known if name not in ("M", "linear")]
        ready = co.prepare(spins, co.GaussLegendre(2), step=0.01)
        found = sum(known[name] * ready.jvp(x, (0, 0.1), {name: 1.0})[1].x[-1] for name in names)
        expected = 0.1 * spins.vector_field(co.integrate(spins, x, (0, 0.1), 0.01, co.GaussLegendre(3)).x[-1])
        np.testing.assert_allclose(found, expected, atol=1e-7)


def test_constants_of_twisted_lattices():
    """Entries that rotations about the axis tie have derivatives together, and are refused to move alone."""
    crystal = co.spins.crystal(lattice=(1, 3, 4, 90, 90, 90), sites={"Cu": (0, 0, 0)}, space_group="P m m m")
    bond = crystal.bonds(1)["1"]

    def ring(a, b, c):
        empty = co.systems.spins(crystal, (4, 1, 1), periodic=(True, False, False), twist=(1.0, 0, 0))
        return empty.exchange(bond, np.diag([a, b, c]), name="J")

    x, method, h = start(ring(1, 1, 1)), co.GaussLegendre(2), 1e-4
    ready = co.prepare(ring(0.5, 0.5, 0.3), method, step=0.02)
    for by, moved in (({"J A": 1.0, "J B": 1.0}, (1, 1, 0)), ({"J C": 1.0}, (0, 0, 1))):
        found = ready.jvp(x, (0, 0.4), by)[1].x[-1]
        up, down = (
            co.integrate(ring(*(np.array([0.5, 0.5, 0.3]) + s * h * np.array(moved))), x, (0, 0.4), 0.02, method).x[-1]
            for s in (1, -1)
        )
        np.testing.assert_allclose(found, (up - down) / (2 * h), atol=1e-6)
    with refused(ValueError, "cannot move", "twist"):
        co.fit(ready, x, (0, 0.1), {"x": x[None] + 0.1}, {"J A": True}, sigma={"x": 1e-6}, t_eval=[0.1])


def test_members_of_other_constants_threads_and_archives(tmp_path):
    """Gradients of each member are those alone; a run that is resumed with its model has its constants."""
    systems = [model(J3=value) for value in (0.1, 0.2)]
    x, method = start(systems[0]), co.Splitting(order=4)
    y = np.random.default_rng(3).standard_normal((3, 18))
    one = [co.prepare(system, method, step=0.1).vjp(x, (0, 0.2))[1](x=y) for system in systems]
    for threads in (1, 2):
        ready = co.prepare(co.batch(systems), method, step=0.1, threads=threads)
        assert ready.parameters["J3"].tolist() == [0.1, 0.2]
        both = ready.vjp(np.array([x, x]), (0, 0.2))[1](x=np.stack([y, y], axis=1))
        for name in VALUES:
            np.testing.assert_allclose(both[name], [alone[name] for alone in one], rtol=1e-12)
    for mode in MODES:
        system = model(mode)
        x, path = start(system), tmp_path / mode
        co.integrate(system, x, (1, 1.4), 0.1, method, archive=path)
        resumed = co.resume(path, 2.0, system=system)
        check_same(resumed, co.integrate(system, x, (1, 2.0), 0.1, method))
        loaded = co.load(path, system=system).system
        assert {*VALUES} <= {*co.prepare(loaded, method, step=0.1).parameters}


@pytest.mark.parametrize("name", co.forces.names())
def test_forces_beside_constants(name):
    """With every force, in both orders, the derivative is that by differences, or refused as those by the start."""
    method, h, damping = co.GaussLegendre(2), 1e-4, co.forces.LinearDamping(0.1)
    for first in (True, False):

        def hot(value, first=first):
            system = model(J3=value)
            force = force_on(name, system)
            return system.with_forces(*((force, damping) if first else (damping, force)))

        try:
            ready = co.prepare(hot(0.1), method, step=0.05)
            x = start(ready.system)
            ready.jvp(x, (1, 1.2), {"x0": x})
        except (TypeError, ValueError):
            return
        found = ready.jvp(x, (1, 1.2), {"J3": 1.0})[1].x[-1]
        up, down = (co.integrate(hot(0.1 + s * h), x, (1, 1.2), 0.05, method).x[-1] for s in (1, -1))
        np.testing.assert_allclose(found, (up - down) / (2 * h), atol=1e-6)


def test_what_is_refused():
    bonds = iron().bonds(max_distance=8.5)
    empty = co.systems.spins(iron(), (3, 2, 1), spin=1, periodic=False)
    named = empty.exchange(bonds["1"], 0.1, name="J1")
    with refused(ValueError, "J1", "0.1", "0.2", "another name"):
        named.exchange(bonds["3"], 0.2, name="J1")
    with refused(ValueError, "J1", "0.2"):
        named.biquadratic(bonds["3"], 0.2, name="J1")
    for name in ("M", "x0", "exchange", "LinearDamping.rate"):
        with refused(ValueError, name, "other parameters"):
            empty.exchange(bonds["1"], 0.1, name=name)
    with refused(TypeError, "name"):
        empty.exchange(bonds["1"], 0.1, name=1)
    ready = co.prepare(named, co.Splitting(), step=0.1)
    x = start(named)
    with refused(ValueError, "tensor", "J1", "contains"):
        co.fit(ready, x, (0, 0.1), {"x": x[None] + 0.1}, {"J1": True, "tensor": (0,)}, sigma={"x": 1e-6}, t_eval=[0.1])
