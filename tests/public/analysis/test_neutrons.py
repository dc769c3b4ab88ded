"""What neutrons measure of spins: factors by hand, sum rules, planes, powders, domains and resolution."""

import numpy as np
import pytest

import coadjoint as co

MN = co.spins.crystal(co.spins.structure("MnF2")).subcrystal("Mn")
OBLIQUE = co.spins.crystal(
    lattice=(3, 4, 5, 80, 95, 105), sites={"Fe": (0.1, 0.2, 0.3), "Ni": (0.45, 0.7, 0.85)}, space_group="P 1"
)
PATH = [(0, 0, 0), (1 / 2, -1 / 3, 1), (1, 2 / 3, 0), (-1 / 2, 1 / 3, -1)]
MEV = {"k_B": 0.08617333262145179, "hbar": 0.6582119569509067}
# P. J. Brown, International Tables for Crystallography C, tables 4.4.5.1 and 4.4.5.2.
J0 = {
    "Mn2+": (0.4220, 17.6840, 0.5948, 6.0050, 0.0043, -0.6090, -0.0219),
    "Fe2+": (0.0263, 34.9597, 0.3668, 15.9435, 0.6188, 5.5935, -0.0119),
    "Ni2+": (0.0163, 35.8826, 0.3916, 13.2233, 0.6052, 4.3388, -0.0133),
    "Er3+": (0.0586, 17.9802, 0.3540, 7.0964, 0.6126, 2.7482, -0.0251),
}
J2 = {
    "Fe2+": (1.6490, 16.559, 1.9064, 6.133, 0.5206, 2.137, 0.0035),
    "Ni2+": (1.7080, 11.016, 1.2147, 4.103, 0.3150, 1.533, 0.0018),
    "Er3+": (0.1710, 18.534, 0.9879, 6.625, 0.9044, 2.100, 0.0278),
}


def gaussians(coefficients, q):
    A, a, B, b, C, c, D = coefficients
    s = (np.asarray(q) / (4 * np.pi)) ** 2
    return A * np.exp(-a * s) + B * np.exp(-b * s) + C * np.exp(-c * s) + D


def by_table(ion, q, c2):
    return gaussians(J0[ion], q) + (c2 * (np.asarray(q) / (4 * np.pi)) ** 2 * gaussians(J2[ion], q) if c2 else 0.0)


def coupled():
    model = co.systems.spins(OBLIQUE, (2, 3, 2), spin={"Fe": 2, "Ni": 1}, g={"Fe": 2.2, "Ni": 2.0}, units="meV")
    return model.exchange(OBLIQUE.bonds(4)["1"], 0.3).field((1, 2, 5.0))


def a_run(model, members=2, span=(0, 2), seed=1):
    x = np.random.default_rng(seed).standard_normal((members, model.dim // 3, 3))
    x /= np.linalg.norm(x, axis=2, keepdims=True)
    return co.integrate(model, x.reshape(members, -1), span, 0.05, save_every=2)


RUN = a_run(coupled())
UP = np.tile([0.6, 0.0, 0.8], 32)


def by_hand(sol, model, q, omega, factors, polarized=True):
    """Return S (k, m) by sums over sites and times, with moments times factors (k, sites)."""
    cartesian = 2 * np.pi * np.linalg.solve(model.crystal.lattice, q.T).T
    e = cartesian / np.maximum(np.linalg.norm(cartesian, axis=1), 1e-300)[:, None]
    tensor = np.eye(3) - e[:, :, None] * e[:, None, :] if polarized else np.broadcast_to(np.eye(3), (len(q), 3, 3))
    if polarized:
        tensor[np.linalg.norm(cartesian, axis=1) < 1e-12] = 2 / 3 * np.eye(3)
    result = np.zeros((len(q), len(omega)))
    for member in range(sol.x.shape[1]):
        spins = sol.x[:, member].reshape(len(sol.t), -1, 3)
        phases = factors * np.exp(-1j * cartesian @ model.positions.T)
        sums = np.einsum("tia,ki,tm->akm", spins, phases, np.exp(1j * np.outer(sol.t, omega)))
        result += np.einsum("kab,akm,bkm->km", tensor, sums, sums.conj()).real
    step, count = abs(sol.t[1] - sol.t[0]), len(sol.t)
    return result * step / (2 * np.pi * spins.shape[1] * count * sol.x.shape[1])


def lengths_of(q, crystal=OBLIQUE):
    return np.linalg.norm(2 * np.pi * np.linalg.solve(crystal.lattice, q.T), axis=0)


@pytest.mark.parametrize(
    ("ion", "g", "c2"),
    [("Mn2+", 2.0, 0.0), ("Fe2+", -2.2, 1 - 2 / 2.2), ("Ni2+", 2.0, 0.0), ("Er3+", 1.2, 2 / 1.2 - 1)],
)
def test_form_factors_are_those_of_the_international_tables(ion, g, c2):
    q = np.linspace(0, 8, 9)
    found = co.spectra.Neutrons().form_factor(ion, q, g)
    np.testing.assert_allclose(found, by_table(ion, q, c2), rtol=1e-5, atol=1e-6)
    if ion in J2:
        given = co.spectra.Neutrons().form_factor((ion, 0.3), q, g)
        np.testing.assert_allclose(given, by_table(ion, q, 0.3), rtol=1e-5, atol=1e-6)
    assert abs(found[0] - 1) < 2e-3


@pytest.mark.parametrize("ions", [None, {"Fe": "Fe2+", "Ni": lambda q: np.exp(-q / 5)}])
def test_spectra_by_hand(ions):
    """Moments g F S, and the components across q."""
    model = coupled()
    S = co.spectra.structure_factor(RUN, PATH, None, co.spectra.Neutrons(ions))
    moments = np.where(model.sites == 0, 2.2 * 2, 2.0)
    assert np.allclose(moments, model.moments)
    factors = np.broadcast_to(moments, (len(S.q), len(moments)))
    if ions:
        lengths = lengths_of(S.q)
        F = np.stack([by_table("Fe2+", lengths, 1 - 2 / 2.2), np.exp(-lengths / 5)], axis=1)
        factors = factors * F[:, model.sites]
    expected = by_hand(RUN, model, S.q, S.omega, factors)
    np.testing.assert_allclose(S.intensity, expected, rtol=1e-5, atol=1e-6 * expected.max())
    components = by_hand(RUN, model, S.q, S.omega, factors, False)
    np.testing.assert_allclose(S.components.sum(axis=0), components, rtol=1e-5, atol=1e-6 * components.max())
    assert np.allclose(S.energies, MEV["hbar"] * S.omega, rtol=1e-12)


def test_members_with_vacancies_and_other_ions_backward():
    """Moments of substituted ions, sites without spins, and members of other couplings, from t = 3 to 1."""
    models = [coupled().substitute("Fe", 0.3, seed=seed, spin=1.5, g=2.5).vacancies(0.25, seed=seed) for seed in (1, 2)]
    x = np.random.default_rng(2).standard_normal((2, models[0].dim // 3, 3))
    x /= np.linalg.norm(x, axis=2, keepdims=True)
    sol = co.integrate(co.batch(models), x.reshape(2, -1), (3, 1), 0.05, save_every=2)
    S = co.spectra.structure_factor(sol, PATH, None, co.spectra.Neutrons())
    each = []
    for member, model in enumerate(models):
        alone = co.integrate(model, x[member : member + 1].reshape(1, -1), (3, 1), 0.05, save_every=2)
        assert set(model.moments) == {2.5 * 1.5, 2.2 * 2, 2.0}
        each.append(by_hand(alone, model, S.q, S.omega, np.tile(model.moments, (len(S.q), 1))))
    # Of a backward run |sum over t| is that of the times in order.
    np.testing.assert_allclose(S.intensity, np.mean(each, axis=0), rtol=1e-8, atol=1e-9 * np.max(each))


@pytest.mark.parametrize("neutrons", [None, co.spectra.Neutrons(), co.spectra.Neutrons({"Fe": "Fe2+", "Ni": "Ni2+"})])
@pytest.mark.parametrize(
    "where", [PATH, co.spectra.Plane((0, 0, 0), (1, 0, 0), (0, 1, 1)), co.spectra.Powder([0, 1.5, 2.5])]
)
def test_sum_rules(neutrons, where):
    S = co.spectra.structure_factor(RUN, where, "hann", neutrons)
    total = S.intensity.sum(axis=1) * (S.omega[1] - S.omega[0])
    np.testing.assert_allclose(total, S.static, rtol=1e-12)
    np.testing.assert_allclose(S.integrated(S.energies[0], S.energies[-1]), total, rtol=0.2)


def test_temperature_gives_detailed_balance():
    path, T = [(-1, 0, 0), (1, 0, 0)], 20.0
    plain = co.spectra.structure_factor(RUN, path, None, co.spectra.Neutrons())
    S = co.spectra.structure_factor(RUN, path, None, co.spectra.Neutrons(temperature=T))
    x = MEV["hbar"] * S.omega / (MEV["k_B"] * T)
    factor = np.where(x == 0, 1, x / np.where(x == 0, 1, -np.expm1(-x)))
    np.testing.assert_allclose(S.intensity, plain.intensity * factor, rtol=1e-12)
    np.testing.assert_allclose(S.error, plain.error * factor, rtol=1e-12)
    np.testing.assert_allclose(S.components, plain.components * factor, rtol=1e-12)
    assert np.array_equal(S.static, plain.static)
    kept = slice(1, None) if len(S.omega) % 2 == 0 else slice(None)
    loss, gain = S.intensity[:, kept], S.intensity[::-1, kept][:, ::-1]
    np.testing.assert_allclose(gain, loss * np.exp(-x[kept]), rtol=1e-9)
    # Far below the energies the factor is x, and zero on the other side, without overflow.
    cold = co.spectra.structure_factor(RUN, path, None, co.spectra.Neutrons(temperature=1e-6))
    assert np.isfinite(cold.intensity).all() and np.all(cold.intensity[:, S.omega < 0] == 0.0)


def tetragonal(size=(4, 4, 2)):
    crystal = co.spins.crystal(lattice=(2, 2, 3, 90, 90, 90), sites={"Mn": (0, 0, 0)})
    bonds = crystal.bonds(3)
    return co.systems.spins(crystal, size, units="meV").exchange(bonds["1"], -0.5).field((3, 0, 4.0))


def test_domains_are_means_over_rotated_wave_vectors():
    model = tetragonal()
    sol = a_run(model, span=(0, 1))
    turns = [np.eye(3), [[0, -1, 0], [1, 0, 0], [0, 0, 1]]]  # the second takes x to y
    corners = [(1 / 4, 0, 0), (1, 0, 1 / 2), (1 / 2, 1 / 4, 0)]
    S = co.spectra.structure_factor(sol, corners, None, co.spectra.Neutrons(domains=turns))
    # The domain that is turned from x to y scatters at q as the other does at q turned from y to x.
    back = [(h, k, l) if d == 0 else (k, -h, l) for h, k, l in S.q for d in (0, 1)]
    apart = np.array([co.spectra.structure_factor(sol, [q], None, co.spectra.Neutrons()).intensity[0] for q in back])
    np.testing.assert_allclose(S.intensity, apart.reshape(len(S.q), 2, -1).mean(axis=1), rtol=1e-11)
    np.testing.assert_allclose(S.intensity.sum(axis=1) * (S.omega[1] - S.omega[0]), S.static, rtol=1e-12)
    # All domains of the crystal make the intensity as symmetric as it.
    symmetric = co.spectra.Neutrons(domains="symmetry")
    one, other = (
        co.spectra.structure_factor(sol, [q], None, symmetric) for q in ((1 / 4, 1 / 2, 1), (-1 / 2, 1 / 4, -1))
    )
    np.testing.assert_allclose(one.intensity, other.intensity, rtol=1e-11)
    # Modes of the same domains.
    modes = co.spectra.linear_modes(model, UP, corners, 8, co.spectra.Neutrons(domains=turns))
    each = [
        co.spectra.linear_modes(model, UP, [q], 1, co.spectra.Neutrons())
        for q in [(1 / 2, 1 / 4, 0), (1 / 4, -1 / 2, 0)]
    ]
    assert np.allclose(modes.frequencies[-1], [one.frequencies[0, 0] for one in each])
    assert np.allclose(modes.intensity[-1], [one.intensity[0, 0] / 2 for one in each])


def test_planes_have_the_wave_vectors_of_their_grid():
    plane = co.spectra.Plane((0, 0, 0), (1, 0, 1), (0, 2 / 3, 0))
    S = co.spectra.structure_factor(RUN, plane, None)
    assert S.shape == (3, 3) and S.corners.tolist() == [0, 2, 6, 8]
    assert np.allclose(S.q.reshape(3, 3, 3)[2, 1], (1, 1 / 3, 1))
    single = co.spectra.structure_factor(RUN, [(1 / 2, 2 / 3, 1 / 2)], None)
    np.testing.assert_allclose(S.intensity.reshape(3, 3, -1)[1, 2], single.intensity[0], rtol=1e-11)
    modes = co.spectra.linear_modes(tetragonal(), UP, co.spectra.Plane((0, 0, 0), (1, 0, 0), (0, 1, 0)), 6)
    h, k, _ = modes.q.T
    assert modes.shape == (7, 7)
    wave = 2 * 0.5 * (2 - np.cos(2 * np.pi * h) - np.cos(2 * np.pi * k)) + 2 * 0.057883817982 * 5
    np.testing.assert_allclose(modes.energies[:, 0], wave, rtol=1e-9)


def test_powders_are_means_over_shells():
    model, edges = coupled(), [0.4, 1.0, 1.4, 1.9]
    S = co.spectra.structure_factor(RUN, co.spectra.Powder(edges), None, co.spectra.Neutrons())
    grid = np.stack(np.meshgrid(*(np.arange(-9, 10) for _ in range(3)), indexing="ij"), axis=-1).reshape(-1, 3) / (
        2,
        3,
        2,
    )
    lengths = lengths_of(grid)
    for shell in range(3):
        q = grid[(lengths >= edges[shell]) & (lengths < edges[shell + 1])]
        expected = by_hand(RUN, model, q, S.omega, np.broadcast_to(model.moments, (len(q), 24))).mean(axis=0)
        np.testing.assert_allclose(S.intensity[shell], expected, rtol=1e-8, atol=1e-9 * expected.max())
    assert np.allclose(S.distance, [0.7, 1.2, 1.65]) and S.q.shape == (3, 1)
    # A density over the energies of the axis: its integral is the equal-time structure factor.
    np.testing.assert_allclose(S.density.sum(axis=1) * np.diff(S.energies)[0], S.static, rtol=1e-10)
    assert S.hbar < 1 and S.plot().axes[0].child_axes[0].get_ylabel().endswith("[1/meV]")


def test_shells_of_a_very_oblique_lattice_are_whole():
    """h reaches |a| q / (2 pi), whatever the height of the cell across the other edges."""
    crystal = co.spins.crystal(lattice=(2, 2, 3, 90, 90, 150), sites={"Fe": (0, 0, 0)}, space_group="P 1")
    model = co.systems.spins(crystal, (4, 4, 1), units="meV").field((0, 0, 2.0))
    sol, edges = a_run(model, members=1, span=(0, 1)), (1.0, 2.5, 4.0)
    S = co.spectra.structure_factor(sol, co.spectra.Powder(edges), None)
    h = np.stack(np.meshgrid(*(np.arange(-12, 13),) * 3, indexing="ij"), axis=-1).reshape(-1, 3) / (4, 4, 1)
    lengths = lengths_of(h, crystal)
    for shell in range(2):
        q = h[(lengths >= edges[shell]) & (lengths < edges[shell + 1])]
        expected = by_hand(sol, model, q, S.omega, np.ones((len(q), 16)), polarized=False).mean(axis=0)
        np.testing.assert_allclose(S.intensity[shell], expected, rtol=1e-8, atol=1e-9 * expected.max())


def test_powders_of_modes_have_all_directions():
    """The polarization factor (1 + e_z^2) / 2 of spins along z has the mean 2/3, and the moments g S."""
    crystal = co.spins.crystal(lattice=(2, 3, 4, 75, 80, 110), sites={"Mn": (0, 0, 0)})
    model = co.systems.spins(crystal, (3, 1, 1), spin=5 / 2, g=1.9, units="meV").exchange(crystal.bonds(2)["1"], -0.4)
    model, up = model.field((0, 0, 2.0)), np.tile([0, 0, 1.0], 3)
    T, points = 30.0, 200
    cold = co.spectra.linear_modes(model, up, co.spectra.Powder([0.5, 1, 2]), points, co.spectra.Neutrons())
    assert cold.frequencies.shape == (2, points) and np.allclose(cold.distance, [0.75, 1.5])
    np.testing.assert_allclose(cold.intensity.sum(axis=1), 2 / 3 * 1.9**2 * 5 / 2, rtol=1e-4)
    warm = co.spectra.linear_modes(
        model, up, co.spectra.Powder([0.5, 1, 2]), points, co.spectra.Neutrons(temperature=T)
    )
    bosons = 1 / np.expm1(cold.energies / (MEV["k_B"] * T))
    np.testing.assert_allclose(warm.intensity, cold.intensity * (1 + bosons), rtol=1e-10)
    np.testing.assert_allclose(warm.components, cold.components * (1 + bosons), rtol=1e-10)
    spectrum = cold.spectrum(np.linspace(-1, 6, 701), 0.1)
    np.testing.assert_allclose(spectrum.intensity.sum(axis=1) * 0.01 / MEV["hbar"], spectrum.static, rtol=1e-6)
    figure = spectrum.plot()
    assert "q" in figure.axes[0].get_xlabel() and "meV" in figure.axes[0].get_ylabel()


def test_infinite_parts_that_neutrons_do_not_see_are_left_out_of_spectra():
    """Turns in an easy plane that cost no energy move spins along q: their polarization factor is zero."""
    line = co.spins.crystal(lattice=(1, 2, 2, 90, 90, 90), sites={"Cu": (0, 0, 0)}, space_group="P 1")
    model = co.systems.spins(line, (4, 1, 1)).exchange(line.bonds(1)["1"], 1.0).single_ion("Cu", np.diag([0, 0, 0.3]))
    path, energies = [(0.25, 0, 0), (0.5, 0, 0)], np.linspace(0, 4, 41)
    modes = co.spectra.linear_modes(model, [0, 1, 0, 0, -1, 0] * 2, path, 4, co.spectra.Neutrons())
    assert np.isinf(modes.components[0, -1, 0]) and modes.intensity[-1, 0] == 0.0
    S = modes.spectrum(energies, 0.1)
    assert np.isfinite(S.components).all() and np.allclose(S.intensity[-1], S.components[2, -1], rtol=1e-9)


def test_resolution_of_an_instrument():
    """A line of modes has the width and the area of the Gaussian, and of runs every frequency that of its energy."""
    model = tetragonal()
    modes = co.spectra.linear_modes(model, UP, [(0.3, 0.1, 0)], 1)
    energies = np.linspace(0, 4, 4001)
    S = modes.spectrum(energies, lambda energy: 0.2 * energy)
    line, centre = S.intensity[0], modes.energies[0, 0]
    above = energies[line > line.max() / 2]
    assert abs(np.ptp(above) - 0.2 * centre) < 0.003 and abs(energies[line.argmax()] - centre) < 0.001
    assert np.isclose(line.sum() * (S.omega[1] - S.omega[0]), modes.intensity[0, 0], rtol=1e-3)
    plain = co.spectra.structure_factor(RUN, PATH)
    broad = plain.broadened(lambda energy: 0.3 + 0.05 * np.abs(energy))
    np.testing.assert_allclose(broad.intensity.sum(axis=1), plain.intensity.sum(axis=1), rtol=1e-12)
    np.testing.assert_allclose(broad.components.sum(axis=0), broad.intensity, rtol=1e-12)
    assert np.array_equal(broad.static, plain.static) and np.isfinite(broad.error).all()
    inside = slice(len(plain.omega) // 2 - 4, len(plain.omega) // 2 + 5)
    sigma = (0.3 + 0.05 * np.abs(plain.energies)) / np.sqrt(8 * np.log(2))
    weights = np.exp(-0.5 * ((plain.energies[:, None] - plain.energies) / sigma) ** 2)
    expected = plain.intensity @ (weights / weights.sum(axis=0)).T
    np.testing.assert_allclose(broad.intensity[:, inside], expected[:, inside], rtol=1e-12)
    narrow = plain.broadened(1e-9)
    np.testing.assert_allclose(narrow.intensity, plain.intensity, rtol=1e-12)


def test_integrals_over_energies_count_parts_of_frequencies():
    S = co.spectra.structure_factor(RUN, PATH)
    width = S.energies[1] - S.energies[0]
    middle = len(S.omega) // 2
    found = S.integrated(S.energies[middle] - 0.5 * width, S.energies[middle + 1] + 0.25 * width)
    expected = (S.intensity[:, middle] + 0.75 * S.intensity[:, middle + 1]) * width / S.hbar
    np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_pictures():
    model = tetragonal()
    sol = a_run(model, span=(0, 1))
    corners = [(0, 0, 0), (1, 0, 0), (1, 1 / 2, 0)]
    S = co.spectra.structure_factor(sol, corners)
    modes = co.spectra.linear_modes(model, UP, corners)
    axes = S.plot(modes=modes).axes[0]
    line = max(axes.lines, key=lambda one: len(one.get_xdata()))
    assert np.allclose(line.get_ydata(), modes.energies[:, 0]) and np.allclose(line.get_xdata(), modes.distance)
    assert np.isclose(modes.distance[-1], S.distance[-1]) and "meV" in axes.get_ylabel()
    labels = ["(0, 0, 0)", "(1, 0, 0)", "(1, 1/2, 0)"]
    alone = modes.plot().axes[0]
    for drawn in (axes, alone):
        assert [tick.get_text() for tick in drawn.get_xticklabels()] == labels
    areas = alone.collections[0].get_sizes()
    assert np.allclose(areas / areas[0], (modes.intensity / modes.intensity[0, 0]).ravel())
    plane = co.spectra.structure_factor(sol, co.spectra.Plane((0, 0, 0), (1, 0, 0), (0, 1, 0)))
    axes = plane.plot((0.5, 3.0)).axes[0]
    assert axes.collections[0].get_array().shape == (5, 5)
    assert np.allclose(axes.collections[0].get_array().max(), plane.integrated(0.5, 3.0).max())
    assert np.isclose(axes.get_aspect(), 1.0)
    oblique = co.spectra.structure_factor(RUN, co.spectra.Plane((0, 0, 0), (1, 0, 0), (0, 1 / 3, 1)), None)
    drawn = oblique.plot().axes[0]
    marks = drawn.collections[0].get_coordinates()[[0, 0, -1], [0, -1, 0]] * (1.0, drawn.get_aspect())
    edges = 2 * np.pi * np.linalg.solve(OBLIQUE.lattice, np.array([(1, 0, 0), (0, 1 / 3, 1)]).T).T
    angle = edges[0] @ edges[1] / np.linalg.norm(edges[0]) / np.linalg.norm(edges[1])
    first, second = marks[1:] - marks[0]
    assert np.isclose(first @ second / np.linalg.norm(first) / np.linalg.norm(second), angle)
    # Three cells along the first edge, of two steps, and two along the second.
    ratio = np.linalg.norm(2 * edges[1]) / np.linalg.norm(3 / 2 * edges[0])
    assert np.isclose(np.linalg.norm(second) / np.linalg.norm(first), ratio)
    assert "(1, 0, 0)" in axes.get_xlabel() and "(0, 1, 0)" in axes.get_ylabel()
    limited = S.plot((2.0, 10.0)).axes[0]
    low, high = limited.get_ylim()
    width = S.energies[1] - S.energies[0]
    assert 2.0 - width < low < 2.0 + width and 10.0 - width < high < 10.0 + width
    with pytest.raises(ValueError, match="of another path"):
        S.plot(modes=co.spectra.linear_modes(model, UP, corners[:2]))
    with pytest.raises(ValueError, match="of a plane"):
        plane.plot(modes=modes)
    with pytest.raises(ValueError, match="of a plane; give a path"):
        co.spectra.linear_modes(model, UP, co.spectra.Plane((0, 0, 0), (1, 0, 0), (0, 1, 0)), 3).plot()


SPECTRUM = co.spectra.structure_factor(RUN, PATH, None)
MODES = co.spectra.linear_modes(tetragonal(), UP, PATH, 3)
RING = co.integrate(co.systems.spin_lattice("ring", 4), [0, 0, 1] * 4, (0, 1), 0.02)


@pytest.mark.parametrize(
    ("words", "call"),
    [
        (r"form_factors\['Fe'\] is 'Fe7\+', .* tables, which have Fe, Fe1?\+, Fe2\+, Fe3\+, Fe4\+",
         lambda: co.spectra.Neutrons({"Fe": "Fe7+"})),
        (r"'Xx2\+', without a form factor .* Mn, Fe", lambda: co.spectra.Neutrons({"Fe": "Xx2+"})),
        (r"is 'iron'; give an ion such as", lambda: co.spectra.Neutrons({"Fe": "iron"})),
        (r"of which the tables have no <j2>; give \('Pr3\+', 0\)", lambda: co.spectra.Neutrons({"Pr": "Pr3+"})),
        (r"temperature is -3", lambda: co.spectra.Neutrons(temperature=-3)),
        (r"temperature is 0", lambda: co.spectra.Neutrons(temperature=0)),
        (r"domains is 'all'", lambda: co.spectra.Neutrons(domains="all")),
        (r"domains has shape \(3, 3\)", lambda: co.spectra.Neutrons(domains=np.eye(3))),
        (r"domains\[1\] is .* not orthogonal", lambda: co.spectra.Neutrons(domains=[np.eye(3), 2 * np.eye(3)])),
        (r"form_factors has Fe; give each of Fe, Ni once",
         lambda: co.spectra.structure_factor(RUN, PATH, neutrons=co.spectra.Neutrons({"Fe": "Fe2+"}))),
        (r"form_factors is given for a model with substituted ions",
         lambda: co.spectra.linear_modes(
             tetragonal().substitute("Mn", 0.5, seed=1, spin=2.0), UP, PATH, 1, co.spectra.Neutrons({"Mn": "Mn2+"}))),
        (r"unknown label 'Co'; there are: Fe, Ni",
         lambda: co.spectra.structure_factor(RUN, PATH, neutrons=co.spectra.Neutrons({"Fe": "Fe2+", "Co": "Co2+"}))),
        (r"path, turned by a domain, has the corner .*, which does not fit",
         lambda: co.spectra.structure_factor(
             RUN, PATH, neutrons=co.spectra.Neutrons(domains=[np.eye(3), [[0, -1, 0], [1, 0, 0], [0, 0, 1]]]))),
        (r"Powder has the shell from 0.01 to 0.02, where .* no wave vector",
         lambda: co.spectra.structure_factor(RUN, co.spectra.Powder([0.01, 0.02, 1]))),
        (r"edges is \[2, 1\]", lambda: co.spectra.Powder([2, 1])),
        (r"give edges of a plane", lambda: co.spectra.Plane((0, 0, 0), (1, 0, 0), (2, 0, 0))),
        (r"plane has the corner \(0.3, 0.0, 0.0\), which does not fit",
         lambda: co.spectra.structure_factor(RUN, co.spectra.Plane((0, 0, 0), (0.3, 0, 0), (0, 1, 0)))),
        (r"energies is .*, and S has those from -\d.* to 19\.\d", lambda: SPECTRUM.integrated(0, 30)),
        (r"give the lower one first", lambda: SPECTRUM.integrated(2, 1)),
        (r"fwhm is -0.3 at the energy", lambda: SPECTRUM.broadened(-0.3)),
        (r"fwhm returns .*; it must return finite numbers of the shape",
         lambda: SPECTRUM.broadened(lambda energy: np.ones(2))),
        (r"q has the length 30, .* reach 25 per angstrom", lambda: co.spectra.Neutrons().form_factor("Mn2+", [1, 30])),
        (r"energies is \[0, 1, 3\]; give .* equidistant", lambda: MODES.spectrum([0, 1, 3], 0.1)),
        (r"state is no equilibrium of .* moves at the rate 0.*; give co.equilibrium\(system, state\).x",
         lambda: co.spectra.linear_modes(tetragonal(), np.tile([0.0, 0, 1.0], 32), PATH)),
        (r"state has the spin 31 on an orbit of lower dimension",
         lambda: co.spectra.linear_modes(tetragonal(), np.where(np.arange(96) < 93, UP, 0.0), PATH)),
        (r"state has the shape \(2, 96\)", lambda: co.spectra.linear_modes(tetragonal(), [UP, UP], PATH)),
        (r"path has shape \(2,\)", lambda: co.spectra.linear_modes(tetragonal(), UP, [1, 2])),
        (r"path has 1e\+30 reciprocal", lambda: co.spectra.linear_modes(tetragonal(), UP, [(1e30, 0, 0)])),
        (r"path of a model with dipoles.* has the corner \(0.3, 0.0, 0.0\)",
         lambda: co.spectra.linear_modes(magnets(), np.tile([0, 0, 1.0], 4), [(0.3, 0, 0)])),
        (r"neutrons is given for ring", lambda: co.spectra.structure_factor(RING, neutrons=co.spectra.Neutrons())),
    ],
)  # fmt: skip
def test_what_is_refused(words, call):
    with pytest.raises(ValueError, match=words):
        call()


@pytest.mark.parametrize(
    ("words", "call"),
    [
        (r"neutrons is 3; give co.spectra.Neutrons", lambda: co.spectra.structure_factor(RUN, PATH, neutrons=3)),
        (
            r"needs a model on a crystal",
            lambda: co.spectra.linear_modes(co.systems.spin_lattice("ring", 4), [0, 0, 1] * 4, [(0,)]),
        ),
        (r"has forces", lambda: co.spectra.linear_modes(tetragonal().with_forces(co.forces.Gilbert(0.1)), UP, PATH)),
        (r"depends on time", lambda: co.spectra.linear_modes(tetragonal_driven(), UP, PATH)),
        (r"form_factors is 'Fe2\+'", lambda: co.spectra.Neutrons("Fe2+")),
    ],
)
def test_what_is_refused_by_its_type(words, call):
    with pytest.raises(TypeError, match=words):
        call()


def magnets():
    return co.systems.spins(tetragonal().crystal, (2, 2, 1), units="meV").dipolar()


def tetragonal_driven():
    crystal = tetragonal().crystal
    return co.systems.spins(crystal, (4, 4, 2)).field(lambda t: (0.0 * t, 0.0, 1.0 + t))
