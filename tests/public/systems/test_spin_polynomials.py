"""Biquadratic couplings and Stevens functions of spins: energies by hand, torques, symmetry, temperature, refusals."""

import importlib.util

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

import coadjoint as co
from refusals import refused

pytestmark = [
    pytest.mark.skipif(importlib.util.find_spec(name) is None, reason=f"{name} is not installed")
    for name in ("gemmi", "spglib")
]

TETRAGONAL = co.spins.crystal(lattice=(1, 1, 1.2, 90, 90, 90), sites={"Mn": (0, 0, 0)}, space_group="P 4/m m m")
BOND = TETRAGONAL.bonds(1)["1"]
S, J, K, B = 1.5, 0.4, -0.3, np.array([0.1, 0.2, 0.3])
STEVENS = {"B20": 0.1, "B40": 0.02, "B44": -0.05, "B60": 0.004, "B64": 0.003}


def of_all(vectors):
    """Return the Stevens functions of the test, of vectors (..., 3) with their lengths."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    r2 = x * x + y * y + z * z
    fourfold = x**4 - 6 * x**2 * y**2 + y**4
    return {
        "B20": 3 * z**2 - r2,
        "B40": 35 * z**4 - 30 * z**2 * r2 + 3 * r2**2,
        "B44": fourfold,
        "B60": 231 * z**6 - 315 * z**4 * r2 + 105 * z**2 * r2**2 - 5 * r2**3,
        "B64": (11 * z**2 - r2) * fourfold,
    }


def by_hand(x, size=(4, 3)):
    """Return the energies of states (..., n) of the model, periodic in the plane."""
    spins = S * x.reshape(*x.shape[:-1], *size, 3)
    energy = sum(STEVENS[name] * values for name, values in of_all(spins).items()) - 2.0 * spins @ B
    for axis in (-3, -2):
        products = np.sum(spins * np.roll(spins, -1, axis), axis=-1)
        energy = energy + J * products + K * products**2
    return np.sum(energy, axis=(-1, -2))


def torque(t, x):
    """Return S' of S' = S x (-dH/dS), by complex steps."""
    gradient = by_hand(x + 1e-30j * np.eye(len(x))).imag / 1e-30
    return np.cross(x.reshape(-1, 3), -gradient.reshape(-1, 3) / S).ravel()


def model(size=(4, 3, 1)):
    plain = co.systems.spins(TETRAGONAL, size, spin=S, periodic=(True, True, False))
    return plain.exchange(BOND, J).biquadratic(BOND, K).single_ion("Mn", STEVENS).field(B)


def start(spins, seed=1):
    x = np.random.default_rng(seed).standard_normal((spins, 3))
    return (x / np.linalg.norm(x, axis=1, keepdims=True)).ravel()


def test_runs_follow_the_torques_in_every_kind_of_scheme():
    """Splittings converge with their order to torques of the energy by hand; other schemes agree with them."""
    spins, x0 = model(), start(12)
    assert abs(spins.energy(x0) - by_hand(x0)) < 1e-13 * abs(by_hand(x0))
    assert np.abs(spins.vector_field(x0) - torque(0, x0)).max() < 1e-13
    exact = solve_ivp(torque, (0, 0.5), x0, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]

    def error(method, h):
        sol = co.integrate(spins, x0, (2.0, 2.5), h, method)
        assert max(value for name, value in sol.drift().items() if name != "energy") < 1e-13
        return np.abs(sol.x[-1] - exact).max()

    for order, h in ((2, 0.01), (4, 0.02)):
        coarse, fine = (error(co.Splitting(order=order), step) for step in (h, h / 2))
        assert abs(np.log2(coarse / fine) - order) < 0.1
    assert error(co.Splitting(order=6), 0.01) < 1e-9
    for method in (co.GaussLegendre(3), co.Taylor(order=12)):
        assert error(method, 0.01) < 1e-9
    back = co.integrate(spins, exact, (0.5, 0), 0.005, co.Splitting(order=6))
    assert np.abs(back.x[-1] - x0).max() < 1e-9


def test_two_spins_turn_about_their_sum():
    """S_1 . S_2 is constant, and both spins turn about S_1 + S_2 at the rate J + 2 K S_1 . S_2."""
    pair = co.systems.spins(TETRAGONAL, (2, 1, 1), spin=S, periodic=False).exchange(BOND, J).biquadratic(BOND, K)
    x0 = start(2)
    first, second = S * x0.reshape(2, 3)
    total, rate = first + second, J + 2 * K * first @ second
    axis, angle = total / np.linalg.norm(total), np.linalg.norm(total) * rate * 3.0

    def turned(v):  # S_1' = S_1 x (-rate S_2) = rate (S_1 + S_2) x S_1
        return v * np.cos(angle) + np.cross(axis, v) * np.sin(angle) + axis * (axis @ v) * (1 - np.cos(angle))

    expected = np.concatenate([turned(first), turned(second)]) / S
    sol = co.integrate(pair, x0, (0, 3), 0.005, co.Splitting(order=6))
    assert np.abs(sol.x[-1] - expected).max() < 1e-10
    assert set(pair.integrals) == {"total S1", "total S2", "total S3"}


def few(spins, energy=1.0, K=K):
    """Return an open chain of spins with all terms of degree four, in a unit of energy."""
    chain = co.systems.spins(TETRAGONAL, (spins, 1, 1), spin=S, periodic=False).exchange(BOND, energy * J)
    stevens = {name: energy * STEVENS[name] for name in ("B20", "B40", "B44")}
    return chain.biquadratic(BOND, energy * K).single_ion("Mn", stevens).field(energy * B)


def test_members_batches_archives_and_units(tmp_path):
    """The same bits alone, beside others, in a batch, and resumed; other units of energy scale the time alone."""
    x0, method, spins, weaker = start(2), co.Splitting(order=4), few(2), few(2, K=0.5 * K)
    alone = co.integrate(spins, x0, (0, 0.4), 0.01, method).x[-1]
    assert np.array_equal(co.integrate(spins, np.tile(x0, (17, 1)), (0, 0.4), 0.01, method).x[-1, 9], alone)
    both = co.integrate(co.batch([weaker, spins]), np.tile(x0, (2, 1)), (0, 0.4), 0.01, method).x[-1]
    assert np.array_equal(both[1], alone)
    assert np.array_equal(both[0], co.integrate(weaker, x0, (0, 0.4), 0.01, method).x[-1])
    co.integrate(spins, x0, (0, 0.2), 0.01, method, archive=tmp_path / "run")
    assert np.array_equal(co.resume(tmp_path / "run", 0.4).x[-1], alone)
    for unit in (1e-7, 1e30):
        scaled = co.integrate(few(2, unit), x0, (0, 0.4 / unit), 0.01 / unit, method).x[-1]
        assert np.abs(scaled - alone).max() < 1e-12


def test_derivatives():
    """Gradients by the start, the field and the coefficients agree with differences, of the rule for each."""
    spins, x0, direction = few(2), start(2), np.random.default_rng(2).standard_normal(6)

    def end(method, x, K=K):
        return co.integrate(spins if K == -0.3 else few(2, K=K), x, (0, 0.5), 0.01, method).x[-1]

    # The derivative by a constant of parts that share it is that of the exact motion, to the order of the scheme.
    for method, of_scheme in ((co.Splitting(order=6), 1e-8), (co.GaussLegendre(3), 1e-8)):
        _, pullback = co.prepare(spins, method, step=0.01).vjp(x0, (0, 0.5), save_every=50)
        gradient = pullback(x=np.stack([np.zeros(6), direction]))
        d = np.random.default_rng(3).standard_normal(6)
        ahead, behind = (end(method, x0 + e * d) @ direction for e in (1e-5, -1e-5))
        assert abs(gradient["x0"] @ d - (ahead - behind) / 2e-5) < 1e-7
        ahead, behind = (end(method, x0, K + e) @ direction for e in (1e-5, -1e-5))
        assert abs(gradient["biquadratic 1"] - (ahead - behind) / 2e-5) < of_scheme


NAMED = {"biquadratic 1": K, **{f"{name} Mn 0": STEVENS[name] for name in ("B20", "B40", "B44")}}


def of_constants(values, mode="dipole"):
    """Return a chain of three spins with the constants of these values."""
    spin = 2 if mode == "SU(N)" else S
    chain = co.systems.spins(TETRAGONAL, (3, 1, 1), spin=spin, periodic=False, mode=mode)
    chain = chain.exchange(BOND, J).biquadratic(BOND, values["biquadratic 1"])
    return chain.single_ion("Mn", {name: values[f"{name} Mn 0"] for name in ("B20", "B40", "B44")}).field(B)


@pytest.mark.parametrize("method", [co.Splitting(order=4), co.GaussLegendre(2)])
@pytest.mark.parametrize("name", NAMED)
@pytest.mark.parametrize("change", ["nothing", "ions", "forces", "SU(N)"])
def test_derivatives_by_constants_by_name(name, change, method):
    """By central differences, whose error is h^2 of the third derivative, backward in time from another start."""
    span, h = (0.3, -0.2), 1e-4

    def spins(value):
        found = of_constants(NAMED | {name: value}, mode="SU(N)" if change == "SU(N)" else "dipole")
        if change == "ions":
            return found.substitute("Mn", 0.4, seed=1, spin=1)
        return found.with_forces(co.forces.LinearDamping(0.2)) if change == "forces" else found

    at = spins(NAMED[name])
    x = at.random(1) if change == "SU(N)" else start(3)
    ready = co.prepare(at, method, step=0.005)
    assert ready.parameters[name] == NAMED[name]
    found = ready.jvp(x, span, {name: 1.0})[1].x[-1]
    up, down = (co.integrate(spins(NAMED[name] + s * h), x, span, 0.005, method).x[-1] for s in (1, -1))
    expected = (up - down) / (2 * h)
    assert np.abs(expected).max() > 0.01
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())
    end = np.random.default_rng(2).standard_normal(at.dim)
    sol, pullback = ready.vjp(x, span)
    gradient = pullback(x=np.concatenate([np.zeros((len(sol.x) - 1, at.dim)), end[None]]))[name]
    np.testing.assert_allclose(gradient, end @ found, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_derivatives_by_constants_of_twisted_lattices():
    """By central differences, as above, of a ring of three spins, of which one bond crosses the twisted end."""
    x, h, names = start(3), 1e-4, ("biquadratic 1", "B40 Mn 0")

    def twisted(K, B40):
        ring = co.systems.spins(TETRAGONAL, (3, 1, 1), spin=S, periodic=(True, False, False), twist=(1.0, 0, 0))
        return ring.exchange(BOND, J).biquadratic(BOND, K).single_ion("Mn", {"B40": B40})

    ready = co.prepare(twisted(K, 0.02), co.GaussLegendre(2), step=0.005)
    for name, change in zip(names, np.eye(2) * h, strict=True):
        found = ready.jvp(x, (0, 0.5), {name: 1.0})[1].x[-1]
        up, down = (
            co.integrate(twisted(*((K, 0.02) + s * change)), x, (0, 0.5), 0.005, co.GaussLegendre(2)).x[-1]
            for s in (1, -1)
        )
        expected = (up - down) / (2 * h)
        np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())


def test_constants_are_fitted_by_name():
    """Exact data are fitted to round-off; coefficients that symmetry ties have derivatives together."""
    x0, method = start(3), co.Splitting(order=4)
    measured = {"x": co.integrate(of_constants(NAMED), x0, (0, 0.2), 0.01, method, save_every=5).x}
    guess = co.prepare(of_constants({name: 1.05 * value for name, value in NAMED.items()}), method, step=0.01)
    found = co.fit(guess, x0, (0, 0.2), measured, dict.fromkeys(NAMED, True), sigma={"x": 0.01}, save_every=5)
    for name, value in NAMED.items():
        assert abs(found.values[name] - value) < 1e-8
    assert f"K = {float(found.values['biquadratic 1'])!r}" in str(found.solution.system)
    cube = co.spins.crystal(lattice=(1, 1, 1, 90, 90, 90), sites={"Mn": (0, 0, 0)}, space_group="P m -3 m")
    tied = co.systems.spins(cube, (2, 1, 1), periodic=False).single_ion("Mn", {"B40": 0.1, "B44": 0.5})
    one = co.prepare(tied, method, step=0.01)
    moved = one.jvp(start(2), (0, 0.1), {"B40 Mn 0": 1.0, "B44 Mn 0": 5.0})[1].x[-1]
    ends = [
        co.integrate(
            co.systems.spins(cube, (2, 1, 1), periodic=False).single_ion("Mn", {"B40": b, "B44": 5 * b}),
            start(2), (0, 0.1), 0.01, method,
        ).x[-1]
        for b in (0.1 + 1e-5, 0.1 - 1e-5)
    ]  # fmt: skip
    np.testing.assert_allclose(moved, (ends[0] - ends[1]) / 2e-5, atol=1e-7)
    with pytest.raises(ValueError, match="cannot move from the guess: the Stevens coefficients are not allowed"):
        co.fit(one, start(2), (0, 0.1), {"x": ends[0][None] + 0.1}, {"B40 Mn 0": True}, sigma={"x": 1e-6}, t_eval=[0.1])


def test_fitted_coefficients_are_not_forgotten_for_declared_constants():
    """A pair in a field that was fitted is no longer that of its declaration, from which constants build models."""
    x0, method = start(2), co.GaussLegendre(2)
    pair = co.systems.spins(TETRAGONAL, (2, 1, 1), spin=S, periodic=False).exchange(BOND, J).biquadratic(BOND, K)
    measured = {"x": co.integrate(pair.field(1.1 * B), x0, (0, 0.2), 0.01, method, save_every=5).x}
    ready = co.prepare(pair.field(B), method, step=0.01)
    found = co.fit(ready, x0, (0, 0.2), measured, {"linear": True}, sigma={"x": 0.01}, save_every=5)
    np.testing.assert_allclose(found.values["linear"], np.tile(-2.2 * S * B, 2), rtol=1e-9)
    assert "biquadratic 1" in ready.parameters
    fitted = found.solution.system
    assert set(co.prepare(fitted, method, step=0.01).parameters) == {"M", "linear", "coefficients"}
    assert "changed since" in str(fitted) and "changed since" not in str(pair)
    with refused(ValueError, "other coefficients", "declare"):
        fitted.single_ion("Mn", np.diag([0, 0, 0.1]))


def test_vacancies_and_substituted_ions():
    """Ions of another length have their energies: K S_i^2 S_j^2, and B_lm S^l of each degree."""
    full = co.systems.spins(TETRAGONAL, (4, 3, 1), spin=S, periodic=False).biquadratic(BOND, K)
    full = full.single_ion("Mn", STEVENS)
    alloy = full.vacancies(0.25, seed=1).substitute("Mn", 0.5, seed=2, spin=1.1)
    x = start(len(alloy.sites))
    spins, expected = alloy.spin[:, None] * x.reshape(-1, 3), 0.0
    assert len(set(alloy.spin)) == 2
    for i in range(len(spins)):
        expected += sum(STEVENS[name] * value for name, value in of_all(spins[i]).items())
        for j in range(i):
            if np.abs(alloy.cells[i] - alloy.cells[j]).sum() == 1:
                expected += K * (spins[i] @ spins[j]) ** 2
    assert abs(alloy.energy(x) - expected) < 1e-13 * abs(expected)


def coherent(s, z):
    """Return the probabilities of m = s, s - 1, ..., -s in the coherent state at the height z."""
    n = round(2 * s)
    k = np.arange(n + 1)
    binomial = np.array([float(np.prod([(n - i) / (i + 1) for i in range(j)])) for j in k])
    return binomial * ((1 - z) / 2) ** k * ((1 + z) / 2) ** (n - k)


@pytest.mark.parametrize("s", [2, 5 / 2, 7 / 2])
def test_quantum_factors_of_the_docstring(s):
    """Operators O_20, O_40, O_60 have in coherent states the classical values times the stated factors."""
    m, X = s - np.arange(round(2 * s) + 1), s * (s + 1)
    operators = {
        2: 3 * m**2 - X,
        4: 35 * m**4 - (30 * X - 25) * m**2 + 3 * X**2 - 6 * X,
        6: 231 * m**6 - (315 * X - 735) * m**4 + (105 * X**2 - 525 * X + 294) * m**2 - 5 * X**3 + 40 * X**2 - 60 * X,
    }
    free = co.spins.crystal(lattice=(1, 1, 1.2, 90, 90, 90), sites={"Gd": (0, 0, 0)}, space_group="P 1")
    for degree, values in operators.items():
        ion = co.systems.spins(free, (1, 1, 1), spin=s).single_ion("Gd", {f"B{degree}0": 1.0})
        factor = np.prod([1 - j / (2 * s) for j in range(1, degree)])
        for z in (0.9, 0.3, -0.6):
            expected = coherent(s, z) @ values
            found = factor * ion.energy([np.sqrt(1 - z * z), 0, z])
            assert abs(found - expected) <= 1e-11 * np.abs(values).max()


@pytest.mark.parametrize("degree", [2, 4, 6])
def test_all_stevens_functions(degree):
    """They are harmonic and orthogonal, turn with m about z, and have a positive leading term."""
    free = co.spins.crystal(lattice=(1, 1, 1.2, 90, 90, 90), sites={"Gd": (0, 0, 0)}, space_group="P 1")
    nodes, _ = np.polynomial.legendre.leggauss(8)
    turns = 2 * np.pi * np.arange(16) / 16
    r = np.sqrt(1 - nodes**2)[:, None]
    points = np.stack(np.broadcast_arrays(r * np.cos(turns), r * np.sin(turns), nodes[:, None]), axis=-1)
    for m in range(-degree, degree + 1):
        ion = co.systems.spins(free, (1, 1, 1)).single_ion("Gd", {f"B{degree}{m}": 1.0})
        values = ion.hamiltonian(points.reshape(-1, 3)).reshape(8, 16)
        n, phase = abs(m), np.cos(m * turns) if m >= 0 else np.sin(-m * turns)
        along = values @ phase / (phase @ phase)
        assert np.abs(values - along[:, None] * phase).max() < 1e-12 * np.abs(values).max()
        # P(z) is a multiple of the derivative of Legendre's polynomial, with whole coefficients without a common factor
        polynomial = np.polynomial.legendre.Legendre.basis(degree).deriv(n).convert(kind=np.polynomial.Polynomial)
        shape = polynomial(nodes) * r[:, 0] ** n
        scale = along @ shape / (shape @ shape)
        assert scale > 0 and np.abs(along - scale * shape).max() < 1e-12 * np.abs(along).max()
        coefficients = scale * polynomial.coef[degree - n :: -2] if n < degree else scale * polynomial.coef
        whole = np.round(coefficients).astype(int)
        assert np.abs(coefficients - whole).max() < 1e-9 and np.gcd.reduce(whole) == 1


def test_symmetry_propagates_and_refuses():
    """Sites of a cell get functions turned to their frames; what the site forbids is refused with the allowed ones."""
    mn = co.spins.crystal(co.spins.structure("MnF2")).subcrystal("Mn")
    for given in ({"B44": 1.0, "B4-2": 0.3, "B64": 0.2}, {"B4-2": 0.5, "B6-2": 0.1}):
        ions = co.systems.spins(mn, (1, 1, 1)).single_ion("Mn", given)
        a, b = start(1, 3), np.array([0.0, 0.0, 1.0])
        x, y, z = a
        one = ions.energy(np.concatenate([a, b])) - ions.energy(np.concatenate([b, b]))
        quarter = [np.concatenate([b, turned]) for turned in ((-y, x, z), (y, -x, z))]
        others = [ions.energy(each) - ions.energy(np.concatenate([b, b])) for each in quarter]
        assert np.abs(np.array(others) - one).max() < 1e-12
    cubic = co.spins.crystal(lattice=(1, 1, 1, 90, 90, 90), sites={"Fe": (0, 0, 0)}, space_group="P m -3 m")
    ions = co.systems.spins(cubic, (1, 1, 1)).single_ion("Fe", {"B40": 0.1, "B44": 0.5})
    x, y, z = a = start(1, 5)
    assert np.abs([ions.energy(v) - ions.energy(a) for v in ((y, z, x), (-x, z, y), (z, -y, -x))]).max() < 1e-13
    assert abs(ions.energy(a) - ions.energy([0, 0, 1]) - 2.0 * (x**4 + y**4 + z**4 - 1)) < 1e-13
    with refused(ValueError, "Fe 0", "B40", "B44"):
        co.systems.spins(cubic, (1, 1, 1)).single_ion("Fe", {"B40": 0.1})
    trigonal = co.spins.crystal(co.spins.structure("FeI2")).subcrystal("Fe")
    ions = co.systems.spins(trigonal, (1, 1, 1)).single_ion("Fe", {"B40": 0.1, "B4-3": 0.2, "B66": 0.1})
    third = np.array([[-0.5, -np.sqrt(0.75), 0], [np.sqrt(0.75), -0.5, 0], [0, 0, 1]])
    assert abs(ions.energy(third @ a) - ions.energy(a)) < 1e-13
    with refused(ValueError, "Fe 0", "B4-3"):
        co.systems.spins(trigonal, (1, 1, 1)).single_ion("Fe", {"B44": 0.2})


def test_sites_without_symmetry_get_functions_turned_by_their_rotations():
    """In P 3 a general site allows everything, and the functions of the others are turned by 120 degrees, not back."""
    crystal = co.spins.crystal(lattice=(4, 4, 5, 90, 90, 120), sites={"Fe": (0.2, 0.1, 0.3)}, space_group="P 3")
    given = {"B21": 0.3, "B43": 0.5, "B4-1": 0.2, "B62": -0.1}
    ions = co.systems.spins(crystal, (1, 1, 1), periodic=False).single_ion(0, given)
    third = np.array([[-0.5, -np.sqrt(0.75), 0], [np.sqrt(0.75), -0.5, 0], [0, 0, 1]])
    places = crystal.positions @ crystal.lattice
    n, rest = start(1, 8), np.tile([0.0, 0.0, 1.0], 3)

    def energy(site, direction):
        x = rest.copy()
        x[3 * site : 3 * site + 3] = direction
        return ions.energy(x) - ions.energy(rest)

    moved = third @ places[0] - places
    steps = moved @ np.linalg.inv(crystal.lattice)
    (image,) = np.flatnonzero(np.abs(steps - np.round(steps)).max(axis=1) < 1e-9)
    assert image != 0 and abs(energy(image, third @ n) - energy(0, n)) < 1e-13
    assert abs(energy(image, third.T @ n) - energy(0, n)) > 1e-3


def test_temperature_and_equilibrium():
    """Energies in thermal states, also with baths, are quadratures; the easy axes of a cube are its diagonals."""
    kT = 0.5

    def mean(f):
        return quad(lambda u: f(u) * np.exp(-f(u) / kT), -1, 1)[0] / quad(lambda u: np.exp(-f(u) / kT), -1, 1)[0]

    pair = co.systems.spins(TETRAGONAL, (2, 1, 1), periodic=False).exchange(BOND, 0.4).biquadratic(BOND, -1.0)
    ion = co.systems.spins(TETRAGONAL, (1, 1, 1), spin=S).single_ion("Mn", {"B20": -0.1, "B40": 0.05})
    alone = co.systems.spins(TETRAGONAL, (2, 1, 1), periodic=False).biquadratic(BOND, -1.0)
    cases = (
        (pair, mean(lambda u: 0.4 * u - u * u)),
        (alone, mean(lambda u: -u * u)),  # without exchange on its bond
        (ion, mean(lambda z: -0.1 * S**2 * (3 * z * z - 1) + 0.05 * S**4 * (35 * z**4 - 30 * z * z + 3))),
    )
    for system, expected in cases:
        for method, extra in (("heat bath", 1), ("Metropolis", 0)):
            states = co.thermal_states(
                system, kT, 1000, seed=1, sweeps=120, method=method, over_relaxation=extra if system is ion else 0
            )
            energies = states.energy[40:].mean(axis=0)
            assert abs(energies.mean() - expected) < 4 * energies.std() / 1000**0.5
            assert np.abs(states.energy[-1] - system.hamiltonian(states.x)).max() < 1e-13
        bath = system.with_forces(co.forces.HeatBath(0.5, temperature=kT, seed=2))
        sol = co.integrate(bath, states.x[:400], (0, 5), 0.02, co.Splitting(order=2), save_every=25)
        energies = sol.energy.mean(axis=0)
        assert abs(energies.mean() - expected) < 4 * energies.std() / 400**0.5 + 2e-3  # order two in the step
    assert np.array_equal(
        co.thermal_states(pair, kT, 1, seed=4, sweeps=5).x[0], co.thermal_states(pair, kT, 3, seed=4, sweeps=5).x[0]
    )
    cubic = co.spins.crystal(lattice=(1, 1, 1, 90, 90, 90), sites={"Fe": (0, 0, 0)}, space_group="P m -3 m")
    iron = co.systems.spins(cubic, (1, 1, 1)).single_ion("Fe", {"B40": 0.1, "B44": 0.5})
    found = co.equilibrium(iron, start(1, 7))
    assert np.abs(np.abs(found.x) - 3**-0.5).max() < 1e-7 and found.stability == "stable"


def test_what_is_refused():
    plain = co.systems.spins(TETRAGONAL, (4, 4, 1), periodic=(True, True, False))
    with refused(ValueError, "1", "biquadratic", "once"):
        plain.biquadratic(BOND, 1.0).biquadratic(BOND, 1.0)
    with refused(ValueError, "Mn 0", "Stevens", "once"):
        plain.single_ion("Mn", {"B40": 1.0}).single_ion("Mn", {"B60": 1.0})
    both = plain.single_ion("Mn", {"B40": 1.0}).single_ion("Mn", np.diag([0, 0, 1.0]))
    assert "B40" in str(both) and "A =" in str(both)
    for name in ("B30", "B45", "B4", "b40", "B407", 4):
        with refused(ValueError, str(name), "B20"):
            plain.single_ion("Mn", {name: 1.0})
    with refused(ValueError, "Stevens", "empty"):
        plain.single_ion("Mn", {})
    with refused(TypeError, "B40"):
        plain.single_ion("Mn", {"B40": "1"})
    with refused(TypeError, "K"):
        plain.biquadratic(BOND, [1.0])
    with refused(ValueError, "bond 1", "3 cells"):
        co.systems.spins(TETRAGONAL, (2, 4, 1), periodic=(True, True, False)).biquadratic(BOND, 1.0)
