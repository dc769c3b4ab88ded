"""Forces on fluids mode by mode: rates by their formulas, and the noise deviate by deviate."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.systems.forces import random_forcing

N = 5
FLUIDS = {"sphere": co.systems.sphere_euler(N=N), "torus": co.systems.torus_euler(N=N)}
CASES = [  # system, the fluid of its modes, layer
    (FLUIDS["sphere"], "sphere", "vorticity"),
    (co.systems.sphere_euler(N=N, rotation=0.8), "sphere", "vorticity"),
    (FLUIDS["torus"], "torus", "vorticity"),
    (co.systems.reduced_mhd(N=N), "sphere", "vorticity"),
    (co.systems.reduced_mhd(N=N), "sphere", "carried"),
    (co.systems.reduced_mhd(N=N, surface="torus"), "torus", "vorticity"),
    (co.systems.reduced_mhd(N=N, surface="torus"), "torus", "carried"),
    (co.systems.passive_scalar(N=N), "sphere", "carried"),
    (co.systems.passive_scalar(N=N, surface="torus"), "torus", "carried"),
]
IDS = [f"{s.name} {surface} {layer} {getattr(s, 'rotation', '')}" for s, surface, layer in CASES]
on_fields = pytest.mark.parametrize(("s", "surface", "layer"), CASES, ids=IDS)


def random_matrix(seed):
    drawn = np.random.default_rng(seed).standard_normal((2, N, N))
    return FLUIDS["sphere"].algebra.projected(drawn[0] + 1j * drawn[1])


def planetary(s):
    return getattr(s, "planetary", np.zeros((N, N)))


def layers_of(s, x):
    """The carried field, if there is one, and the vorticity relative to the frame."""
    state = s.from_vector(x)
    return {"vorticity": state - planetary(s)} if state.ndim == 2 else {"carried": state[0], "vorticity": state[1]}


def state_of(s, layers):
    W = layers["vorticity"] + planetary(s)
    return s.to_vector(W if len(s.shape) == 2 else np.stack([layers["carried"], W]))


def forces(layer, surface):
    """Each force with its rate, a function of (n1, scale, eigenvalue), the scale l or |n|."""
    spared = 2.0 if surface == "sphere" and layer == "vorticity" else 0.0
    some = co.forces
    return [
        (some.Viscosity(0.03, layer=layer), lambda n1, k, e: 0.03 * (e - spared)),
        (some.Viscosity(0.002, power=3, layer=layer), lambda n1, k, e: 0.002 * (e - spared) ** 3),
        (some.Viscosity(0.03, power=2, rotation=True, layer=layer), lambda n1, k, e: 0.03 * e**2),
        (some.Friction(0.2, layer=layer), lambda n1, k, e: 0.2 + 0 * e),
        (some.Friction(lambda k: 0.1 * k if k < 2.9 else 0.0, layer), lambda n1, k, e: np.where(k < 2.9, 0.1 * k, 0)),
        *([(some.BetaPlane(1.7), lambda n1, k, e: -1.7j * n1 / np.maximum(e, 1))] if surface == "torus" else []),
    ]


@pytest.mark.thinned(1)
@on_fields
@pytest.mark.parametrize("tau", [0.75, -0.5])
def test_each_mode_of_the_layer_decays_by_its_own_rate_and_nothing_else_moves(s, surface, layer, tau):
    fluid = FLUIDS[surface]
    layers = {name: random_matrix(k) for k, name in enumerate(("carried", "vorticity"))}
    x = state_of(s, layers)
    e, n1 = fluid.eigenvalues, np.fft.fftfreq(N, 1 / N)[:, None]
    scale = np.sqrt(e) if surface == "torus" else fluid.degrees
    for force, rate in forces(layer, surface):
        if isinstance(force, co.forces.BetaPlane) and layer == "carried":
            continue
        force.check(s)
        late = layers_of(s, force.flow(s, x, 0.4, tau))
        for name, W in layers_of(s, x).items():
            factor = np.exp(-tau * rate(n1, scale, e)) if name == layer else 1.0
            wanted = fluid.mode_array(W) * factor
            # Sums of at most N^2 products, in the way there and back.
            tolerance = 64 * N**2 * 2.0**-53 * np.abs(wanted).max()
            assert np.abs(fluid.mode_array(late[name]) - wanted).max() < tolerance, (force, name)
        field = s.from_vector(force.field(s, x, 0.4))
        W, moved = layers_of(s, x)[layer], field if field.ndim == 2 else field[1 if layer == "vorticity" else 0]
        wanted = -rate(n1, scale, e) * fluid.mode_array(W)
        assert np.abs(fluid.mode_array(moved) - wanted).max() < 64 * N**2 * 2.0**-53 * max(1.0, np.abs(wanted).max())


BANDS = {  # the eigenvalues of all real modes inside, by hand
    "sphere": {(1, 1): [2] * 3, (2, 3): [6] * 5 + [12] * 7, (2.5, 4): [12] * 7 + [20] * 9, (4, 9): [20] * 9},
    "torus": {(1, 1): [1] * 4, (2, 2): [4] * 4, (1.2, 2.3): [2] * 4 + [4] * 4 + [5] * 8, (2.5, 3): [8] * 4},
}


@pytest.mark.thinned(6)
@on_fields
@pytest.mark.parametrize("rate", [0.6, 2.5])
def test_the_noise_feeds_in_its_rate_and_each_mode_has_the_same_share(s, surface, layer, rate, monkeypatch):
    """The energy is a square: its mean is the sum over the deviates, one at a time."""
    fluid, tau = FLUIDS[surface], 0.25
    if s.name == "passive_scalar":
        with pytest.raises(ValueError, match="the carried field of passive_scalar has no energy; force the vorticity"):
            s.with_forces(co.forces.RandomForcing(rate, (1, 2), seed=3, layer=layer))
        return
    still = {"carried": np.zeros((N, N)), "vorticity": np.zeros((N, N))}
    x = state_of(s, still)
    for band, eigenvalues in BANDS[surface].items():
        force = co.forces.RandomForcing(rate, band, seed=3, layer=layer)
        force.check(s)
        asked = []
        monkeypatch.setattr(
            random_forcing, "normal_deviates", lambda *a, asked=asked: asked.append(a) or np.zeros(a[-1])
        )
        np.testing.assert_array_equal(force.flow(s, x, 0.5, tau), x)
        ((seed, stream, moment, part, count),) = asked
        assert (seed, stream, moment, part) == (3, 0, 0.5, 0)
        energy, squares, inside = 0.0, np.zeros(fluid.degrees.shape), np.zeros(fluid.degrees.shape, bool)
        for unit in np.eye(count):
            monkeypatch.setattr(random_forcing, "normal_deviates", lambda *a, unit=unit: unit)
            late = layers_of(s, force.flow(s, x, 0.5, tau))
            for name, W in late.items():
                assert name == layer or not W.any()
            c = fluid.mode_array(late[layer])
            squares += np.abs(c) ** 2 * fluid.squares
            inside |= np.abs(c) > 1e-12 * np.abs(c).max(initial=0.0)
        e = fluid.eigenvalues
        weights = squares * (e if layer == "carried" else np.divide(1.0, e, out=0 * e, where=e > 0)) / 2
        # Traces are integrals times this factor.
        energy = weights.sum() * (fluid.scale**2 if surface == "sphere" else N**3 / (4 * np.pi) ** 2 / (4 * np.pi**2))
        assert energy == pytest.approx(rate * tau, rel=1e-12), band
        for eigenvalue in set(eigenvalues):
            share = weights[np.abs(e - eigenvalue) < 1e-9].sum() / weights.sum()
            assert share == pytest.approx(eigenvalues.count(eigenvalue) / len(eigenvalues), rel=1e-12), band
        found = inside & (fluid.squares > 0)
        assert set(e[found]) == set(eigenvalues)
    with pytest.raises(ValueError, match="does not run backward"):
        force.flow(s, x, 0.5, -tau)
