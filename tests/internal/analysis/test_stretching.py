"""Stretches of tangent vectors from the first frame, step by step and in 200 bits; memory."""

import dataclasses
import warnings

import numpy as np
import pytest

import coadjoint as co
from coadjoint import memory
from coadjoint.analysis import lyapunov as stretching
from coadjoint.analysis.lyapunov import frame_of
from refusals import refused

INERTIA, CENTRE = (1.0, 1.75, 2.5), (0.5, 0.25, 1.0)
UPRIGHT = np.array([1.0, 0.5, -0.75, 0.6, 0.0, 0.8])  # of the chaotic region: its exponent is some 0.12
BODY = co.systems.rigid_body(inertia=(1, 2, 3))


def heavy_top(inertia=INERTIA, centre=CENTRE):
    H = co.Quadratic([*(1.0 / np.array(inertia)), 0.0, 0.0, 0.0], linear=[0.0, 0.0, 0.0, *centre])
    return co.LiePoissonSystem(co.algebras.e(3), H, sign=-1)


@dataclasses.dataclass(frozen=True)
class Euler(co.methods.StepMethod):
    order, explicit, symmetric = 1, True, False

    def properties(self, system):
        return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")

    def step(self, system, x, t, h):
        return x + h * system.vector_field(x, t)


@pytest.mark.long
def test_schemes_without_a_loop_go_step_by_step_and_say_so(monkeypatch):
    """They give what products of their tangents give; complex steps and differences have some nine digits at least."""
    monkeypatch.setattr(stretching, "_warned_types", set())
    given = {"t_span": (0.0, 2.0), "step": 0.125, "renormalize_every": 3, "save_every": 8}
    for method, name, by in (
        (co.Taylor(4), "Taylor", ("formula",)),
        (co.RadauEnergy(1), "RadauEnergy", ("formula",)),
        (Euler(), "Euler", ("complex step", "differences")),
    ):
        with pytest.warns(RuntimeWarning, match=f"tangents of {name} are computed in Python"):
            found = co.lyapunov(heavy_top(), UPRIGHT, **given, method=method)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("default", co.LongWait)  # of a busy machine
            ensemble = co.lyapunov(heavy_top(), [0.5 * UPRIGHT, UPRIGHT], **given, method=method, exponents=2)
        assert ensemble.stretches[:, 1].tobytes() == np.ascontiguousarray(found.stretches[:, :2]).tobytes()
        step, product, wanted = co.stepper(heavy_top(), method, 0.125), np.eye(6), []
        for k, x in enumerate(co.integrate(heavy_top(), UPRIGHT, (0, 2), 0.125, method).x[:-1]):
            product = step.tangent(x) @ product
            if k in (7, 15):
                wanted.append(np.log(np.abs(np.diag(np.linalg.qr(product @ frame_of(6, 6).T)[1]))))
        assert found.by in by and np.max(np.abs(found.stretches[1:] - wanted)) < 1e-12


@pytest.mark.thinned(3)
@pytest.mark.parametrize("span", [(3.5, 5.5), (0.0, 2.0), (3.5, 1.5)])  # the first is fast with the first scheme
@pytest.mark.parametrize("method", [Euler(), co.Splitting(order=2), co.GaussLegendre(2)], ids=str)
def test_tangents_of_a_driven_system_are_those_at_the_time_of_each_step(method, span):
    spins = co.systems.spin_lattice("chain", 2, field=lambda t: (np.cos(3.0 * t), np.sin(3.0 * t), 0.2))
    x0, h = np.array([0.6, 0.0, 0.8, 0.0, 0.28, 0.96]), np.copysign(0.125, span[1] - span[0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        found = co.lyapunov(spins, x0, span, 0.125, method, renormalize_every=4, save_every=16)
    step, product = co.stepper(spins, method, h), frame_of(6, 6).T
    for k, x in enumerate(co.integrate(spins, x0, span, 0.125, method).x[:-1]):
        product = step.tangent(x, span[0] + k * h) @ product
    wanted = np.log(np.abs(np.diag(np.linalg.qr(product)[1])))
    assert np.max(np.abs(found.stretches[-1] - wanted)) < 1e-10


def test_memory_is_estimated_first(monkeypatch):
    monkeypatch.setattr(memory, "available", lambda: 10**6)
    monkeypatch.setattr(memory, "UNCHECKED_BYTES", 0)
    with refused(ValueError, "history of 1000001 times needs about", "larger save_every"):
        co.lyapunov(BODY, np.ones(3), (0, 10**6), 1.0, save_every=1)
