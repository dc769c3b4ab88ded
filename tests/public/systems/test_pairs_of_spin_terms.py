"""What spins on crystals have together: terms of degree four, twists and SU(N) in loops, barriers, averages, modes."""

import importlib.util

import numpy as np
import pytest
from scipy.integrate import quad

import coadjoint as co
from refusals import refused

pytestmark = [
    pytest.mark.skipif(importlib.util.find_spec(name) is None, reason=f"{name} is not installed")
    for name in ("gemmi", "spglib")
]

CUBE = co.spins.crystal(lattice=(1, 1, 1, 90, 90, 90), sites={"Fe": (0, 0, 0)}, space_group="P m -3 m")
CHAIN = co.spins.crystal(lattice=(1, 2, 2, 90, 90, 90), sites={"Ni": (0, 0, 0)}, space_group="P 1")
BOND = CHAIN.bonds(1)["1"]
UP = np.array([0.0, 0.0, 1.0])


def cubic(K1, spin=1.5, g=2.0):
    """Return an ion with K1 (x^2 y^2 + y^2 z^2 + z^2 x^2), of directions: B44 = 5 B40 = -K1 / (8 S^4)."""
    b = -K1 / (40 * spin**4)
    return co.systems.spins(CUBE, (1, 1, 1), spin=spin, g=g).single_ion("Fe", {"B40": b, "B44": 5 * b})


@pytest.mark.parametrize(("K1", "axis", "factor"), [(0.8, (0, 0, 1), 2.0), (-0.8, (1, 1, 1), 4 / 3)])
def test_loops_of_cubic_anisotropy(K1, axis, factor):
    """The field of instability against an easy axis: 2 K1 / M along <001>, 4 |K1| / (3 M) along <111>."""
    n = np.array(axis) / np.linalg.norm(axis)
    expected = factor * abs(K1) / 3.0  # M = g S
    fields = np.linspace(1.5, -1.5, 5)[:, None] * expected * n
    loop = co.spins.hysteresis(cubic(K1), fields, n)
    (switching,) = loop.switching_fields
    assert np.allclose(switching, -expected * n, atol=2e-3 * expected)
    assert abs(loop.magnetization[0] @ n - 1) < 1e-9 and abs(loop.magnetization[-1] @ n + 1) < 1e-9


@pytest.mark.parametrize(
    ("K1", "start", "end", "saddle", "barrier"),
    [(0.8, (0, 0, 1), (1, 0, 0), (1, 0, 1), 0.8 / 4), (-0.8, (1, 1, 1), (1, 1, -1), (1, 1, 0), 0.8 / 12)],
)
@pytest.mark.parametrize("unit", [1e-7, 1e30])
def test_barriers_of_cubic_anisotropy(K1, start, end, saddle, barrier, unit):
    ends = [np.array(n) / np.linalg.norm(n) for n in (start, end)]
    path = co.spins.minimum_energy_path(cubic(K1 * unit), *ends, images=9)
    assert abs(path.barrier / (barrier * unit) - 1) < 1e-9
    assert np.allclose(path.saddle / np.linalg.norm(path.saddle), saddle / np.linalg.norm(saddle), atol=1e-6)
    # Curvatures of the minimum: 2 K1 in both directions along <001>, 4/3 |K1| along <111>; S' has hbar S.
    curvature = 2 * K1 if K1 > 0 else -4 / 3 * K1
    assert abs(path.attempt_frequency * 2 * np.pi * 1.5 / (curvature * unit) - 1) < 1e-6


def test_biquadratic_pairs_in_loops_and_on_paths():
    """Between parallel and opposite spins is the barrier |K| S^4; K > 0 and a field have a cubic magnetization."""
    pair = co.systems.spins(CHAIN, (2, 1, 1), spin=1.5, periodic=False)
    path = co.spins.minimum_energy_path(pair.biquadratic(BOND, -0.2), np.tile(UP, 2), np.array([0, 0, 1, 0, 0, -1.0]))
    assert abs(path.barrier - 0.2 * 1.5**4) < 1e-9
    # Spins at +-phi to the field, m = cos(phi): g S B = 4 K S^4 m (2 m^2 - 1) up to saturation.
    K, saturation = 0.2, 4 * 0.2 * 1.5**4 / 3.0
    fields = np.linspace(1.2, 0.0, 9)[:, None] * saturation * np.array([1.0, 0, 0])
    loop = co.spins.hysteresis(pair.biquadratic(BOND, K), fields, np.tile([1.0, 0, 0], 2))
    m, B = loop.magnetization[:, 0], loop.fields[:, 0]
    free = B < 0.99 * saturation
    assert np.allclose(m[~free], 1.0) and free.sum() > 5
    np.testing.assert_allclose(4 * K * 1.5**4 * m[free] * (2 * m[free] ** 2 - 1), 3.0 * B[free], atol=1e-6)


def moments_of(energy, kT):
    """Return the mean and the heat capacity of an energy of u, uniform between -1 and 1."""
    Z, E, square = (quad(lambda u, n=n: energy(u) ** n * np.exp(-energy(u) / kT), -1, 1)[0] for n in range(3))
    return E / Z, (square / Z - (E / Z) ** 2) / kT**2


@pytest.mark.parametrize("kind", ["biquadratic", "Stevens", "SU(3)", "SU(2)"])
def test_averages_of_all_kinds_of_terms(kind):
    """Energies and heat capacities by quadrature, or by integrals over pure states."""
    kT = 0.6
    if kind == "biquadratic":
        model = co.systems.spins(CHAIN, (2, 1, 1), periodic=False).exchange(BOND, 0.4).biquadratic(BOND, -1.0)
        expected = [value / 2 for value in moments_of(lambda u: 0.4 * u - u * u, kT)]
    elif kind == "Stevens":
        model = co.systems.spins(CHAIN, (2, 1, 1), periodic=False).single_ion("Ni", {"B20": -0.2, "B40": 0.03})
        expected = moments_of(lambda z: -0.2 * (3 * z * z - 1) + 0.03 * (35 * z**4 - 30 * z * z + 3), kT)
    else:
        S, D, B = (1.0, 0.9, 0.0) if kind == "SU(3)" else (0.5, 0.0, 0.7)
        Sz = co.spins.operators(S)[2]
        model = co.systems.spins(CHAIN, (2, 1, 1), spin=S, periodic=False, mode="SU(N)").field((0, 0, B))
        model = model.single_ion("Ni", D * Sz @ Sz) if D else model
        # Probabilities of the levels are uniform on a simplex: of the state m = 0 (1 - p) dp, of one of two dp.
        weight = (lambda p: 1 - p) if D else (lambda p: 1.0)
        energy = (lambda p: D * (1 - p)) if D else (lambda p: -B * (2 * p - 1))  # g = 2, <Sz> = p - 1/2
        Z, E, square = (
            quad(lambda p, n=n: weight(p) * energy(p) ** n * np.exp(-energy(p) / kT), 0, 1)[0] for n in range(3)
        )
        expected = E / Z, (square / Z - (E / Z) ** 2) / kT**2
    found = co.spins.thermal_averages(model, kT, seed=2, members=100, sweeps=160, start=20)
    for (value, error), exact in zip((found.energy, found.heat_capacity), expected, strict=True):
        assert abs(value - exact) < 4 * error < 0.03 + 0.1 * abs(exact)
    if kind == "SU(2)":  # is a vector of length 1/2
        vectors = co.systems.spins(CHAIN, (2, 1, 1), spin=0.5, periodic=False).field((0, 0, 0.7))
        other = co.spins.thermal_averages(vectors, kT, seed=3, members=100, sweeps=160, start=20)
        for name in ("magnetization", "susceptibility", "binder"):
            (a, da), (b, db) = getattr(found, name), getattr(other, name)
            assert abs(a - b) < 4 * np.hypot(da, db) < 0.1 * abs(b)


@pytest.mark.parametrize("order", ["parallel", "opposite"])
def test_modes_of_bilinear_biquadratic_chains(order):
    """J +- 2 K S^2 takes the place of J; Stevens functions have the gap 2 S (-3 B20 - 40 S^2 B40)."""
    S, K, B20, B40 = 1.5, -0.05, -0.04, -0.002
    sign = 1 if order == "parallel" else -1
    J, gap = -0.6 * sign, 2 * S * (-3 * B20 - 40 * S**2 * B40)
    model = co.systems.spins(CHAIN, (4, 1, 1), spin=S).exchange(BOND, J).biquadratic(BOND, K)
    model = model.single_ion("Ni", {"B20": B20, "B40": B40})
    state = (sign ** np.arange(4)[:, None] * UP).ravel()
    modes = co.spectra.linear_modes(model, state, [(0, 0, 0), (1, 0, 0)], points=12)
    strength, cos = 2 * S * abs(J + sign * 2 * K * S**2), np.cos(2 * np.pi * modes.q[:, 0])
    ferro, antiferro = strength * (1 - cos) + gap, np.sqrt((strength + gap) ** 2 - (strength * cos) ** 2)
    expected = ferro if sign > 0 else antiferro
    np.testing.assert_allclose(modes.energies.T, [expected] * len(modes.energies.T), rtol=1e-9)
    # The lines of a cold run are there.
    states = co.thermal_states(model, temperature=1e-3, seed=2, sweeps=60, x0=state)
    sol = co.integrate(model, states.x, (1, 41), 0.04, co.GaussLegendre(2), save_every=5)
    S_run = co.spectra.structure_factor(sol, [(0, 0, 0), (1, 0, 0)])
    positive = S_run.omega > 0.1
    lines = S_run.omega[positive][S_run.components[0][:, positive].argmax(axis=1)]
    assert np.all(np.abs(lines - expected[::3]) < S_run.omega[1] - S_run.omega[0])


def test_modes_of_a_biquadratic_chain_of_su3():
    """About S^z = 1: magnons 2 |J| (1 - cos q), and pairs 4 |J| + 2 K (1 + cos q), which hop by K alone."""
    J, K = -0.7, 0.15
    model = co.systems.spins(CHAIN, (4, 1, 1), spin=1, mode="SU(N)").exchange(BOND, J).biquadratic(BOND, K)
    modes = co.spectra.linear_modes(model, model.coherent(UP), [(0, 0, 0), (1, 0, 0)], points=12)
    cos = np.cos(2 * np.pi * modes.q[:, 0])
    expected = np.sort([2 * abs(J) * (1 - cos), 4 * abs(J) + 2 * K * (1 + cos)], axis=0)
    np.testing.assert_allclose(modes.energies.T, expected, rtol=1e-9, atol=1e-9)


def test_twisted_lattices_in_loops_paths_and_averages():
    """A twist of a whole turn is none; fields are along the axis."""

    def ring(cells, **twist):
        model = co.systems.spins(CHAIN, (cells, 1, 1), periodic=(True, False, False), **twist).exchange(BOND, -1.0)
        return model.biquadratic(BOND, 0.2).single_ion("Ni", np.diag([0, 0, -0.4]))

    turned, plain = ring(3, twist=(2 * np.pi, 0, 0)), ring(3)
    fields = np.array([1.0, 0.0, -1.0])[:, None] * UP
    loops = [co.spins.hysteresis(model, fields, np.tile(UP, 3)) for model in (turned, plain)]
    assert np.allclose(loops[0].switching_fields, loops[1].switching_fields, atol=2e-3)
    barriers = [
        co.spins.minimum_energy_path(m, np.tile(UP, 3), np.tile(-UP, 3), images=5).barrier for m in (turned, plain)
    ]
    assert abs(barriers[0] - barriers[1]) < 1e-9
    states = [co.thermal_states(m, 0.5, seed=1, sweeps=9).x for m in (turned, plain)]
    assert np.allclose(*states, atol=1e-9)
    with refused(ValueError, "field", "axis", "twist"):
        co.spins.hysteresis(ring(3, twist=(0.7, 0, 0)), fields[:, ::-1], np.tile(UP, 3))
    # Two cells turned by pi are half of four; also with vacancies, members, and derivatives.
    half, whole = ring(3, twist=(np.pi, 0, 0)), ring(6)
    x = np.random.default_rng(1).standard_normal((3, 3))
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    both = np.concatenate([x, x * [-1, -1, 1]]).ravel()
    found = co.integrate(co.batch([half, half]), np.array([x.ravel(), -x.ravel()]), (2, 1), 0.02, co.GaussLegendre(2))
    large = co.integrate(whole, both, (2, 1), 0.02, co.GaussLegendre(2))
    assert np.abs(found.x[-1, 0] - large.x[-1, :9]).max() < 1e-12
    empty = ring(3, twist=(0.9, 0, 0)).vacancies(0.34, seed=1)
    assert empty.dim == 6 and np.isfinite(empty.energy(x[:2].ravel()))


def test_what_su_n_has_no_meaning_for(tmp_path):
    half = co.systems.spins(CHAIN, (3, 1, 1), spin=0.5, mode="SU(N)", units="meV").exchange(BOND, -0.2)
    x = half.coherent(UP)
    with refused(TypeError, "hysteresis", 'mode="dipole"'):
        co.spins.hysteresis(half, [UP], x)
    sol = co.integrate(half, x, (0, 1), 0.1)
    with refused(TypeError, "OVF", 'mode="dipole"'):
        sol.to_ovf(tmp_path / "run")
    for write in (co.spins.to_sunny, lambda model: co.spins.to_vampire(model, tmp_path)):
        with refused(TypeError, 'mode="dipole"'):
            write(half)
    for term in ("biquadratic", "Stevens"):
        model = co.systems.spins(CHAIN, (3, 1, 1), units="meV")
        model = model.biquadratic(BOND, 0.1) if term == "biquadratic" else model.single_ion("Ni", {"B40": 0.1})
        for write in (co.spins.to_sunny, lambda model: co.spins.to_vampire(model, tmp_path)):
            with refused(ValueError, "biquadratics" if term == "biquadratic" else "polynomials"):
                write(model)


def test_terms_of_degree_four_on_micromagnetic_models(tmp_path):
    """Cubic anisotropy of a particle, B = 2 Kc1 / Msat, its members, archives that resume, and files."""
    Msat, Kc1, edge = 8e5, 3e4, 5e-9
    plain = co.spins.micromagnetic((1, 1, 1), (edge,) * 3, Msat=Msat, Aex=0)
    b = -Kc1 * edge**3 / 1.602176634e-22 / (40 * plain.spin[0] ** 4)
    model = plain.single_ion(0, {"B40": b, "B44": 5 * b})
    loop = co.spins.hysteresis(model, np.linspace(0.15, -0.15, 5)[:, None] * UP, -UP)
    assert np.allclose(loop.switching_fields, [-2 * Kc1 / Msat * UP], atol=5e-4)
    x0 = np.array([[0.6, 0.0, 0.8], [0.0, 0.6, 0.8]])
    hot = model.with_forces(co.forces.Gilbert(0.1, temperature=300, seed=3))
    whole = co.integrate(hot, x0, (5, 15), 0.02, co.GaussLegendre(1))
    co.integrate(hot, x0, (5, 10), 0.02, co.GaussLegendre(1), archive=tmp_path / "run")
    assert np.array_equal(co.resume(tmp_path / "run", 15.0).x, whole.x)
    sol = co.integrate(model, x0[0], (0, 10), 0.01, co.GaussLegendre(1), save_every=500)
    assert len(sol.to_ovf(tmp_path / "ovf")) == 3
