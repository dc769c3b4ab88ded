"""Options of choices, steps, sections and exponents in pairs: each has its effect, or both are named."""

import inspect
import os
from functools import cache
from itertools import combinations_with_replacement

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import coadjoint as co
from argument_cases import STEP, WORLDS
from coadjoint.analysis import lyapunov
from coadjoint.choosing import accuracy
from coadjoint.program.parts.chosen_parts import ChosenParts
from coadjoint.runs import prepared_run
from coadjoint.runs.loops import execution
from coadjoint.runs.stepper import Stepper

SPAN = (1.0, 13.0)
SINGLE = [name for name, world in WORLDS.items() if len(world.systems) == 1]


def pairs(options):
    return [set(pair) for pair in combinations_with_replacement(options, 2)]


def optional(function, *others):
    """Return the names of the arguments of a function, except `others`."""
    return set(inspect.signature(function).parameters) - set(others)


CHOICES = {"attitude": "coadjoint", "methods": [co.Splitting(order=4), co.GaussLegendre(3)], "processed": True}


@pytest.mark.parametrize("world", SINGLE)
def test_options_of_choices(monkeypatch, world):
    """An attitude costs more, given schemes are used, processed schemes are candidates."""
    system, x0 = WORLDS[world].systems[0], WORLDS[world].x0[:2]
    assert optional(co.choose, "system", "x0", "t_span", "accuracy") == set(CHOICES)
    among, fits = [], accuracy._first_trials

    def recorded(pilot, candidates, wanted):
        among[:] = [one.method for one in candidates]
        return fits(pilot, candidates, wanted)

    monkeypatch.setattr(accuracy, "_first_trials", recorded)

    def chosen(names):
        return co.choose(system, x0, (0.0, 5.0), 1e-4, **{name: CHOICES[name] for name in names})

    costs = {frozenset(names): chosen(names).cost for names in ([], ["methods"], ["processed"])}
    for pair in pairs(CHOICES):
        if pair == {"methods", "processed"}:
            with pytest.raises(TypeError, match="methods and processed"):
                chosen(pair)
            continue
        choice = chosen(pair)
        assert ("methods" in pair) == (among == CHOICES["methods"])
        assert ("processed" in pair) == any("blanes_casas" in str(one) for one in among)
        assert ("attitude" in pair) == (choice.cost > costs[frozenset(pair - {"attitude"})])
        assert choice.method in among or choice.method.own_steps


def test_choices_refuse_schemes_without_the_attitude():
    world = WORLDS["so(4)"]
    given = {"methods": [co.RadauEnergy(2)], "attitude": True}
    with pytest.raises(ValueError, match="no group element"):
        co.choose(world.system, world.x0, (0.0, 5.0), 1e-4, **given)


OPTIONS = {"order": 1, "compensated": True, "rotation": "rational", "scheme": "strang", "adjoint": True}


@pytest.mark.thinned(5)
@pytest.mark.parametrize("pair", pairs(OPTIONS), ids=lambda pair: " and ".join(sorted(pair)))
def test_options_of_tuned_splittings(pair):
    """Options that exclude each other are named."""
    assert optional(co.Splitting) - {"parts"} == set(OPTIONS)
    body, x0 = co.systems.rigid_body((1.0, 2.0, 2.5)), WORLDS["so(3)"].x0[0]
    given = {name: OPTIONS[name] for name in pair}
    if ("adjoint" in pair and "order" not in pair) or pair == {"order", "scheme"}:
        with pytest.raises(ValueError, match="order"):
            co.Splitting.tuned(body, x0, **given)
        return
    found, wanted = co.Splitting.tuned(body, x0, **given), co.Splitting(**given)
    assert isinstance(found.parts, ChosenParts)
    assert all(getattr(found, name) == getattr(wanted, name) for name in OPTIONS)


def test_tuned_takes_no_parts():
    with pytest.raises(TypeError, match="parts"):
        co.Splitting.tuned(co.systems.rigid_body((1.0, 2.0, 2.5)), (1.0, 0.2, 0.1), parts="auto")


RHO = co.algebras.so(4).representation
DIAGONAL, PUSHED = np.linspace(0.5, 1.5, 6), np.eye(6)[1]


def driven():
    """Return a body in four dimensions that is driven about one of its planes."""
    swing = co.Separable({1: (lambda y, t: t * y, lambda y, t: t + 0.0 * y, lambda y, t: 0.0 * y)})
    return co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(DIAGONAL) + swing)


STEPPED = {"g": True, "t": 2.5, "attitude": "coadjoint", "inputs": np.array([0.4, -0.3, 0.6, 0.2, 0.1, -0.5])}


@pytest.mark.thinned(6)
@pytest.mark.parametrize("pair", pairs(STEPPED), ids=lambda pair: " and ".join(sorted(pair)))
def test_options_of_steppers(pair):
    """The motion is x' = J(x) (grad H + inputs) from the given time, with constant spatial momentum."""
    assert optional(Stepper.both, "self", "x") == optional(Stepper.group, "self", "x") | {"g"} == set(STEPPED)
    assert optional(co.stepper, "system", "method", "h") == {"inputs"}
    assert optional(Stepper.__call__, "self", "x") == optional(Stepper.tangent, "self", "x") == {"t", "inputs"}
    system, x = driven(), np.array([0.5, 0.8, -0.4, 0.3, -0.7, 0.6])
    field, t0 = (STEPPED["inputs"] if "inputs" in pair else np.zeros(6)), STEPPED["t"] if "t" in pair else 0.0
    step = co.stepper(system, co.Splitting(order=4), STEP, inputs=True if "inputs" in pair else None)
    plain = {"t": t0} if "t" in pair else {}
    plain |= {"linear": field} if "inputs" in pair else {}
    turned = plain | ({"attitude": "coadjoint"} if "attitude" in pair else {})

    def slope(t, x):
        return system.algebra.structure_matrix(x) @ (DIAGONAL * x + t * PUSHED + field)

    exact = solve_ivp(slope, (t0, t0 + STEP), x, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    generators = np.stack([system.algebra.coadjoint(unit) for unit in np.eye(6)]) if "attitude" in pair else RHO
    start = expm(0.4 * generators[0]) @ expm(0.3 * generators[3]) if "g" in pair else np.eye(len(generators[0]))
    end, g = step.both(x, **({"g": start} if "g" in pair else {}), **turned)

    def spatial(g, x):
        matrix = np.tensordot(x, RHO, axes=1)
        return g @ x if "attitude" in pair else g @ matrix @ g.T

    assert np.abs(end - exact).max() < 1e-4 and np.array_equal(step(x, **plain), end)
    assert g.shape == start.shape and np.abs(spatial(g, end) - spatial(start, x)).max() < 1e-14
    first = step.group(x, **turned)
    assert np.abs(start @ first - g).max() < 1e-14 and np.abs(first - np.eye(len(first))).max() > 0.01
    differences = [(step(x + 1e-5 * e, **plain) - step(x - 1e-5 * e, **plain)) / 2e-5 for e in np.eye(6)]
    assert np.abs(step.tangent(x, **plain) - np.transpose(differences)).max() < 1e-9


CROSSED = {"method": co.GaussLegendre(3), "crossings": 1, "accuracy": 1e-7, "threads": 2, "progress": True}


@pytest.fixture
def threads(monkeypatch):
    """Thread counts of runs; one thread is the default here."""
    found, real = [], execution.sum_in_threads
    monkeypatch.setattr(execution, "sum_in_threads", lambda *given: found.append(given[2]) or real(*given))
    monkeypatch.setattr(prepared_run, "concurrent_members", lambda rows: 1)
    return found


@cache
def crossings(name):
    """Return the times at which each member crosses, from SciPy."""
    world = WORLDS[name]
    given = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-11, "events": lambda t, x: x[world.crossing]}
    return [solve_ivp(lambda t, x: world.system.vector_field(x), SPAN, x0, **given).t_events[0] for x0 in world.x0]


@pytest.mark.thinned(2)
@pytest.mark.parametrize("pair", pairs(CROSSED), ids=lambda pair: " and ".join(sorted(pair)))
def test_options_of_sections(threads, capsys, pair):
    assert optional(co.section, "system", "x0s", "event", "t_span", "step") == set(CROSSED)
    name = SINGLE[pairs(CROSSED).index(pair) % len(SINGLE)]
    world, given = WORLDS[name], {one: CROSSED[one] for one in pair}
    given |= {} if "accuracy" in pair else {"step": STEP}
    found = co.section(world.system, world.x0, co.Event(world.crossing), SPAN, **given)
    assert (set(threads) == {2}) == ("threads" in pair) and ("(100 %)" in capsys.readouterr().err) == (
        "progress" in pair
    )
    off = []
    for m, every in enumerate(crossings(name)):
        times = every[: 1 if "crossings" in pair else None]
        assert found.counts[m] == len(times)
        off.append(np.abs(found.t[m, : len(times)] - times).max(initial=0.0))
    # Splittings of order two are off by more than that.
    assert max(map(len, crossings(name))) > 1 and (max(off) < 1e-5) == bool(pair & {"accuracy", "method"})
    assert max(off) < 0.1


EXPONENTS = {
    "method": co.GaussLegendre(2),
    "exponents": 2,
    "renormalize_every": 4,
    "transient": 2.0,
    "save_every": 5,
    "threads": 2,
}


@pytest.mark.thinned(8)
@pytest.mark.parametrize("pair", pairs(EXPONENTS), ids=lambda pair: " and ".join(sorted(pair)))
def test_options_of_lyapunov_exponents(monkeypatch, threads, pair):
    """Against products of tangent maps, from the end of the transient on."""
    assert optional(co.lyapunov, "system", "x0", "t_span", "step") == set(EXPONENTS)
    world, given = WORLDS["so(4)"], {one: EXPONENTS[one] for one in pair}
    frames, real = [], lyapunov.Frame
    monkeypatch.setattr(
        lyapunov, "Frame", lambda vectors, every: frames.append((vectors, every)) or real(vectors, every)
    )
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    found = co.lyapunov(world.system, world.x0, (1.0, 5.0), STEP, **given)
    assert (set(threads) == {2}) == ("threads" in pair)
    [(vectors, every)] = frames
    assert every == (4 if "renormalize_every" in pair else 10)
    first, steps = (16 if "transient" in pair else 0), 32
    numbers = np.append(np.arange(first, steps, 5 if "save_every" in pair else 1), steps)
    np.testing.assert_allclose(found.t, 1.0 + STEP * numbers, rtol=0, atol=1e-12)
    step = co.stepper(world.system, given.get("method", co.Splitting()), STEP)
    x, logarithms, frame = world.x0[1], [np.zeros(len(vectors))], vectors.T
    for _ in range(steps):
        frame, x = step.tangent(x) @ frame, step(x)
        frame, R = np.linalg.qr(frame)
        logarithms.append(logarithms[-1] + np.log(np.abs(np.diag(R))))
    wanted = np.array(logarithms)[numbers] - logarithms[first]
    assert found.stretches.shape[2] == (2 if "exponents" in pair else 6)
    assert np.abs(found.stretches[:, 1] - wanted).max() < 1e-9


def test_every_public_function_is_tested_or_listed():
    """`resume` continues a run with its own arguments; the others analyse, read or build."""
    runs = {"choose", "integrate_ensemble", "integrate", "lyapunov", "prepare", "poincare_section", "stepper"}
    others = {"batch", "certify", "make_corrector", "frequencies", "load", "modified_field", "modified_hamiltonian"}
    others |= {"equilibrium", "fit", "open_archive", "phase_drift", "predicted_drift", "resume", "suggest_step"}
    others |= {"formula", "identify", "thermal_states"}
    functions = (getattr(co, name) for name in dir(co))
    assert {value.__name__ for value in functions if inspect.isfunction(value)} == runs | others
