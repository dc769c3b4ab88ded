"""Schemes that wrap another one: each member of the protocol follows from the base, or is listed here as different.

Wrappers are found among the subclasses of `Method`, members on `Method` and its capabilities, fields on `Properties`,
and bases in the registry, so that a new one of each is compared without a change here.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from functools import cache
from typing import Any, ClassVar

import numpy as np
import pytest

import coadjoint as co
from coadjoint.analysis.checks.poisson import _carried
from coadjoint.analysis.end_error import finer_run
from coadjoint.kernels.tables.tangents import Frame
from coadjoint.methods import FlowMethod, Properties, RungeKuttaMethod
from coadjoint.methods.forced import TANGENT_METHODS, Forced
from coadjoint.methods.formal.formal_numbers import is_short
from coadjoint.methods.numerics.projection import casimirs_restored, polynomial_casimirs
from coadjoint.methods.protocol.automatic_choices import settled, with_compensation
from coadjoint.methods.protocol.composed import ComposedFlows, Substeps
from coadjoint.methods.protocol.composing import Composable
from coadjoint.methods.protocol.flow_method import flows_of
from coadjoint.methods.protocol.formal_step import FormalStep
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.protocol.newton import took_newton
from coadjoint.methods.protocol.own_steps import OwnSteps
from coadjoint.methods.protocol.restored import RestoresInvariants, restored
from coadjoint.methods.protocol.substep_method import SubstepMethod
from coadjoint.methods.protocol.tangents import CompiledTangents, VariedTangents, tangent_by, tangent_loop
from coadjoint.methods.symmetrized import PairOfFlows, PairOfTableaux
from coadjoint.rounding import UNIT_ROUNDOFF
from verification.systems_under_test import Case, all_cases, cases

pytestmark = pytest.mark.thinned(6)

H = 0.0625
EXACT, ROUNDED = (0.25, 0.5, 0.25), (0.3, 0.4, 0.3)
STRIDE = 0.15
DAMPED = (co.forces.LinearDamping(0.1), co.forces.DoubleBracketDamping(0.05))


@dataclasses.dataclass(frozen=True)
class Limited(co.GaussLegendre):
    """A scheme with values that no built-in scheme has, so that a wrapper cannot agree by its defaults."""

    failures: ClassVar[dict[str, str]] = {"UNDEFINED": "there is no such step"}
    largest: ClassVar[float] = 30.0
    offered: ClassVar[bool] = False


@cache
def bases() -> dict[str, Method]:
    """Return every example of the registry, with wrappers of wrappers, by its description."""
    listed = [each for name in co.methods.names() for each in co.methods.registry.scheme(name).examples()]
    nested = [
        co.Composition(co.Splitting(order=2, compensated=True), ROUNDED),
        co.Composition(Limited(2), EXACT),
        co.Projected(co.GaussLegendre(2)),
        co.ReversibleSteps(co.SphericalMidpoint(), 0.2),
    ]
    return {str(each): each for each in [*listed, *nested, Limited(1), co.Taylor(tolerance=1e-6)]}


BUILT: dict[type[Method], Any] = {
    co.Composition: lambda base: co.Composition(base, ROUNDED),
    ComposedFlows: lambda base: ComposedFlows(base, EXACT),
    Substeps: lambda base: Substeps(base, ROUNDED),
    PairOfFlows: PairOfFlows,
    PairOfTableaux: PairOfTableaux,
    co.Projected: co.Projected,
    co.ReversibleSteps: lambda base: co.ReversibleSteps(base, STRIDE),
    Forced: Forced,
}


def takes(wrapper: type[Method], base: Method) -> bool:
    """Return whether a wrapper takes a base, from what its documentation says."""
    if wrapper is co.Composition:
        return base.symmetric
    if wrapper is co.ReversibleSteps:
        return base.symmetric and not base.own_steps
    if wrapper is ComposedFlows:
        return isinstance(base, FlowMethod)
    if wrapper is Substeps:
        return isinstance(base, SubstepMethod) and not base.own_steps
    if wrapper is PairOfFlows:
        return isinstance(base, FlowMethod)
    if wrapper is PairOfTableaux:
        return isinstance(base, RungeKuttaMethod) and base.solver in ("explicit", "implicit")
    return True


PAIRS = [(w, b) for w in BUILT for b, base in bases().items() if takes(w, base)]
ids = [f"{w.__name__} of {b}" for w, b in PAIRS]
each_pair = pytest.mark.parametrize(("wrapper", "name"), PAIRS, ids=ids)


def subclasses(kind: type) -> Iterator[type]:
    for each in kind.__subclasses__():
        yield each
        yield from subclasses(each)


def test_every_scheme_around_a_base_is_compared():
    """A dataclass of the library with a field `base` is a wrapper; a composition of flows is found twice."""
    found = {
        kind
        for kind in subclasses(Method)
        if kind.__module__.startswith("coadjoint.methods.")
        and dataclasses.is_dataclass(kind)
        and any(field.name == "base" for field in dataclasses.fields(kind))
    }
    assert found == set(BUILT)
    assert {w for w, _ in PAIRS} == set(BUILT)


# Members whose values follow from the base by a rule; all others are functions of a step, which have tests of their own
# below or elsewhere, or are listed as different.
BY_RULE = {
    "failures", "largest", "compensates", "order", "explicit", "symmetric", "offered", "own_steps", "known_to",
    "fractions", "restored", "tangent_by", "finer", "properties", "work",
}  # fmt: skip
BY_NUMBERS = {"step", "tangent", "tangent_loop", "formal_step", "loop", "compiled", "program", "expanded"}
DIFFERENT = {
    "fixed_steps": "tests/runs/test_derivatives_of_own_steps.py",
    "next_length": "tests/runs/test_derivatives_of_own_steps.py",
    "instead": "names what to compose in place of a base; a wrapper is composed inside",
    "tables_of_any_step": "tables of a wrapper are made for each step anew",
    "symmetrized": "a wrapper is symmetrized inside",
    "composed": "tests/methods/test_composition.py",
    "reaching": "a wrapper has no tolerance of its own",
    "field_with_poles": "tests/runs/test_passed_poles.py; only the steps of compositions are those of the base",
    "examples": "belongs to the class",
}


def test_every_member_of_the_protocol_is_compared_or_listed():
    kinds = (Method, CompiledTangents, VariedTangents, FormalStep, OwnSteps, Composable, RestoresInvariants)
    public = {name for kind in kinds for name in vars(kind) if not name.startswith("_")}
    assert public == BY_RULE | BY_NUMBERS | DIFFERENT.keys()


def expected(wrapper: type[Method], base: Method) -> dict[str, Any]:
    """Return the members of a wrapped base that are no functions."""
    same = ("failures", "largest", "compensates", "order", "explicit", "symmetric", "own_steps")
    found = {name: getattr(base, name) for name in same}
    series = base.expanded if isinstance(base.expanded, FormalStep) else None
    if series is not None:
        found["known_to"] = series.known_to
    found |= {"fractions": (1.0,), "offered": False}
    even = base.order + base.order % 2
    if wrapper in (co.Composition, ComposedFlows, Substeps):
        fractions = EXACT if wrapper is ComposedFlows else ROUNDED
        own = 0.0 if all(map(is_short, fractions)) else UNIT_ROUNDOFF
        found["fractions"] = tuple(outer * inner for outer in fractions for inner in base.fractions)
        found["offered"] = wrapper is co.Composition
        if series is not None:
            found["known_to"] = max(own, series.known_to)
    elif wrapper is PairOfFlows:
        found |= {"order": even, "symmetric": True}
    elif wrapper is PairOfTableaux:
        # Collocation is exact as a polynomial; the pair has a tableau, whose roots are rounded to many digits.
        found |= {"order": even, "symmetric": True, "explicit": False, "known_to": base._rational[1]}
    elif wrapper is co.Projected:
        found |= {"explicit": False, "symmetric": False, "compensates": False, "own_steps": False}
        found |= {"offered": True}
    elif wrapper is co.ReversibleSteps:
        no_step = {"UNDEFINED": co.methods.reversible_steps.NO_STEP_MESSAGE}
        found |= {"failures": no_step | dict(base.failures), "own_steps": True, "offered": True}
        found |= {"symmetric": False, "compensates": False}
    elif wrapper is Forced:
        found |= {"order": min(2, base.order), "compensates": False, "own_steps": False}
    if wrapper in (co.Projected, co.ReversibleSteps, Forced):
        found.pop("known_to", None)  # their steps are no power series
    return found


@each_pair
def test_what_a_wrapper_says_of_itself_follows_from_the_base(wrapper, name):
    base = bases()[name]
    scheme = BUILT[wrapper](base)
    wanted = expected(wrapper, base)
    assert {key: getattr(scheme, key) for key in wanted} == wanted
    assert hasattr(scheme, "known_to") == (wrapper not in (co.Projected, co.ReversibleSteps, Forced))


@cache
def served(method: Method, system: Any) -> Properties | None:
    try:
        return method.properties(system)
    except ValueError:
        return None


@cache
def witness(method: Method) -> Case:
    """Return a system with full coefficients that a scheme serves."""
    preferred = ("so(3), full, axes turned", "A3,7, full", "e(3), heavy top")
    found = [*(cases()[name] for name in preferred), *all_cases().values()]
    return next(case for case in found if served(method, case.system))


def properties_expected(wrapper: type[Method], base: Properties, system: Any) -> Properties:
    if wrapper is PairOfTableaux:
        return dataclasses.replace(base, attitude="none")
    if wrapper is co.Projected:
        kept = casimirs_restored(system)
        return dataclasses.replace(base, poisson=False, energy=True, casimirs=kept, attitude="none", reversible=False)
    if wrapper is co.ReversibleSteps:
        return dataclasses.replace(base, poisson=False, reversible=True)
    return base


@each_pair
def test_properties_are_those_of_the_base_on_every_system(wrapper, name):
    base = bases()[name]
    scheme, seen = BUILT[wrapper](base), 0
    for case in all_cases().values():
        if wrapper is Forced:
            break
        of_base, found = served(base, case.system), served(scheme, case.system)
        if of_base is None:
            assert found is None, "what the base refuses, no wrapper serves"
        if found is not None:
            wanted = properties_expected(wrapper, of_base, case.system)
            for field in dataclasses.fields(Properties):
                assert getattr(found, field.name) == getattr(wanted, field.name), (case.system.name, field.name)
            seen += 1
        elif wrapper is co.ReversibleSteps and isinstance(case.system, co.MatrixSystem):
            seen += 1  # it serves no matrices
        elif wrapper not in (co.Projected, co.ReversibleSteps):
            assert of_base is None, f"{scheme} refuses {case.system.name}, which its base serves"
    if wrapper is Forced:
        seen = forced_properties(base)
    assert seen


def forced_properties(base: Method) -> int:
    seen = 0
    for case in cases().values():
        inner = served(base, case.system)
        if inner is None or case.system.hamiltonian.timed:
            continue
        for forces in ((), (0,), (1,), (0, 1), (1, 0)):
            chosen = [DAMPED[i] for i in forces]
            if not chosen:
                continue
            forced = case.system.with_forces(*chosen)
            breaking = [type(force).__name__ for force in chosen if not force.casimirs]
            every = [type(force).__name__ for force in chosen]
            said = [("Poisson map", inner.poisson, every), ("energy", inner.energy, every)]
            said += [("Casimirs", inner.casimirs != "none", breaking)]
            wanted = Properties(
                poisson=False,
                energy=False,
                casimirs="none" if breaking else inner.casimirs,
                attitude=inner.attitude,
                broken_by=tuple(f"{what}: {', '.join(by)}" for what, had, by in said if had and by),
            )
            assert Forced(base).properties(forced) == wanted
            seen += 1
    return max(seen, int(not any(served(base, case.system) for case in cases().values())))


def test_open_compensation_is_taken_inside_of_schemes_of_flows():
    """To any depth; a choice that was made stays."""
    for depth in (1, 2):
        for first in (co.Composition, ComposedFlows, PairOfFlows, co.Projected, Forced):
            for second in (ComposedFlows, PairOfFlows)[: 2 if depth == 2 else 1]:

                def made(compensated, first=first, second=second, depth=depth):
                    base = co.Splitting(order=2, compensated=compensated)
                    return BUILT[first](BUILT[second](base) if depth == 2 else base)

                closes = first not in (co.Projected, Forced)
                assert with_compensation(made(None)) == (made(True) if closes else None)
                assert with_compensation(made(True)) is None and with_compensation(made(False)) is None


@pytest.mark.thinned(24)
@each_pair
def test_what_depends_on_a_system_follows_from_the_base(wrapper, name):
    base = bases()[name]
    scheme = BUILT[wrapper](base)
    system = witness(base).system
    own = system.with_forces(DAMPED[0]) if wrapper is Forced else system
    if served(scheme, own) is None:
        return
    invariants = restored(scheme, own)
    if wrapper in (co.Composition, ComposedFlows, Substeps):
        assert invariants == restored(base, system)
    elif wrapper is co.Projected:
        assert invariants == polynomial_casimirs(system)
    else:
        assert invariants is None
    for memory in (np.zeros((2, 6)), np.ones((2, 6)), np.eye(6)[1:3]):
        if wrapper in (co.Composition, Substeps):
            assert took_newton(scheme, memory) == took_newton(base, memory)
        elif wrapper is PairOfTableaux:
            assert took_newton(scheme, memory) == bool(memory[:, 0].any())
        else:
            assert not took_newton(scheme, memory), "each step of the base begins anew, or there are no iterations"
    better = with_compensation(scheme)
    if wrapper in (co.Composition, ComposedFlows, PairOfFlows):
        inner = with_compensation(base)
        assert better == (None if inner is None else dataclasses.replace(scheme, base=inner))
    else:
        assert better is None
    coordinates = [0, system.dim - 1]
    try:
        fixed = settled(base, system, coordinates)
    except TypeError:
        with pytest.raises(TypeError):
            settled(scheme, system, coordinates)
    else:
        assert settled(scheme, system, coordinates) == dataclasses.replace(scheme, base=fixed)
    for steps, times in ((7, 1.5), (400, 3.5)):
        finer = finer_run(scheme, steps, times)
        if wrapper is co.ReversibleSteps:
            assert finer.method == co.ReversibleSteps(base, STRIDE / times)
            assert finer.steps >= steps and finer.left == pytest.approx(times**-scheme.order, rel=1e-12)
        else:
            assert finer.method == scheme and finer.steps >= times * steps
            assert finer.left == pytest.approx((steps / finer.steps) ** scheme.order, rel=1e-12)


@each_pair
def test_work_is_that_of_the_base_as_often_as_it_is_taken(wrapper, name):
    base = bases()[name]
    scheme = BUILT[wrapper](base)
    several_parts = cases()["e(3), heavy top"].system
    system = several_parts if served(base, several_parts) else witness(base).system
    own = system.with_forces(DAMPED[0]) if wrapper is Forced else system
    if served(scheme, own) is None:
        return
    one, found = base.work(system), scheme.work(own)
    rounds, evaluations = 4.0, 12.0
    cost = one.cost(rounds, evaluations)
    if wrapper is Forced or wrapper is co.ReversibleSteps:
        assert found.cost(rounds, evaluations) == cost
        assert (found.flows, found.in_lanes) == (one.flows, one.in_lanes)
    elif wrapper is co.Projected:
        # A way back to each invariant: of energy and Casimirs, at least a quarter of a rotation for each.
        back = found.cost(rounds, evaluations) - cost
        assert 0.25 * (1 + len(restored(scheme, system))) <= back <= 4.0 * (1 + len(restored(scheme, system)))
    else:
        # Neighbouring flows are merged, and a fixed part of a step is counted once.
        times = 2 if wrapper in (PairOfFlows, PairOfTableaux) else 3
        several = found.cost(times * rounds, times * evaluations)
        assert 1.1 * cost < several <= times * cost * (1.0 + 1e-12) + (wrapper is PairOfTableaux) * several
        assert (found.flows > one.flows) == bool(one.flows)
        assert found.in_lanes == one.in_lanes
        assert (found.compensated is None) == (one.compensated is None)
        if found.compensated is not None:
            assert found.compensated().cost(1.0, 1.0) == with_compensation(scheme).work(system).cost(1.0, 1.0)


WHOLE = [b for b, base in bases().items() if base.symmetric]


def same(found: Any, wanted: Any) -> None:
    np.testing.assert_array_equal(np.asarray(found), np.asarray(wanted))


@pytest.mark.parametrize("name", WHOLE)
def test_a_composition_of_one_whole_step_is_the_base_to_the_bit(name):
    base = bases()[name]
    scheme = co.Composition(base, (1.0,))
    system, x0, _ = witness(base)
    x0 = np.asarray(x0, dtype=np.float64)
    same(scheme.step(system, x0, 0.5, H), base.step(system, x0, 0.5, H))
    for found, wanted in zip(scheme.tangent(system, x0, 0.5, H), base.tangent(system, x0, 0.5, H), strict=True):
        same(found, wanted)
    vectors = np.linspace(-1.0, 1.0, 2 * len(x0)).reshape(len(x0), 2)
    size = np.abs(base.tangent(system, x0, 0.5, H)[1]).max() * np.abs(vectors).max()
    bound = 64 * len(x0) * UNIT_ROUNDOFF * size  # products of matrices in another order
    for method in (scheme, base):
        along = _carried(method, system, x0, 0.5, H, vectors)
        np.testing.assert_allclose(along, base.tangent(system, x0, 0.5, H)[1] @ vectors, rtol=0, atol=bound)
    assert tangent_by(scheme, system, x0, 0.5, H) == tangent_by(base, system, x0, 0.5, H)
    attitude = False if base.properties(system).attitude == "none" else "coadjoint"
    runs = [co.integrate(system, x0, (0.5, 2.0), H, each, attitude=attitude) for each in (scheme, base)]
    for part in ("x", "energy", "attitude"):
        if getattr(runs[1], part) is not None:
            same(getattr(runs[0], part), getattr(runs[1], part))
    assert runs[0].drift() == runs[1].drift()
    assert (runs[0].stats.evaluations, runs[0].stats.iterations) == (
        runs[1].stats.evaluations,
        runs[1].stats.iterations,
    )
    frame = Frame(np.eye(system.dim)[:2].copy(), 4)
    assert (tangent_loop(scheme, system, H, frame) is None) == (tangent_loop(base, system, H, frame) is None)
    try:
        wanted_program = base.program(system)
    except TypeError:
        for ask in (lambda: flows_of(scheme), lambda: scheme.program(system)):
            with pytest.raises(TypeError):
                ask()
    else:
        for found, wanted in zip(scheme.program(system).rows, wanted_program.rows, strict=True):
            same(found, wanted)
        assert list(flows_of(scheme).sweeps()) == list(flows_of(base).sweeps())


@pytest.mark.parametrize("name", WHOLE)
def test_a_composition_is_its_substeps(name):
    """To rounding: neighbouring flows are merged."""
    base = bases()[name]
    scheme = co.Composition(base, ROUNDED)
    system, x0, _ = witness(base)
    t, x, P = 0.5, np.asarray(x0, dtype=np.float64), np.eye(system.dim)
    for fraction in ROUNDED:
        y, own = base.tangent(system, x, t, fraction * H)
        x, P, t = y, own @ P, t + fraction * H
    size = np.abs(x0).max()
    tolerance = 1e-13 if tangent_by(base, system, x0, 0.5, H) != "differences" else 1e-7
    np.testing.assert_allclose(scheme.step(system, np.asarray(x0), 0.5, H), x, rtol=0, atol=1e-13 * size)
    np.testing.assert_allclose(scheme.tangent(system, np.asarray(x0), 0.5, H)[1], P, rtol=0, atol=tolerance)


@dataclasses.dataclass(frozen=True)
class Varied(co.GaussLegendre, VariedTangents):
    """A scheme whose derivative is computed in a given way."""

    way: str = ""
    offered: ClassVar[bool] = False

    def tangent_by(self, system, x, t, h):
        return self.way


@pytest.mark.parametrize("way", TANGENT_METHODS)
def test_the_least_exact_factor_names_the_derivative_of_a_forced_step(way):
    system, x0, _ = cases()["so(3), diagonal"]
    base = Varied(2, way=way)
    forced = system.with_forces(DAMPED[0])
    own = tangent_by(Forced(base), forced, x0, 0.0, H)
    force = co.methods.forced.Forced(base)._with_tangent(forced, x0, 0.0, H)[2]
    assert TANGENT_METHODS.index(own) == max(map(TANGENT_METHODS.index, force)) >= TANGENT_METHODS.index(way)


@pytest.mark.parametrize("wrapper", [co.Projected, co.ReversibleSteps])
@pytest.mark.parametrize("way", TANGENT_METHODS)
def test_how_a_derivative_is_found_passes_through(wrapper, way):
    system, x0, _ = cases()["so(3), diagonal"]
    base = Varied(2, way=way)
    found = tangent_by(BUILT[wrapper](base), system, x0, 0.0, H)
    # Reversible steps have lengths that depend on the state; of iterated stages no complex step can be taken.
    assert found == (way if wrapper is co.Projected else "differences")
    assert tangent_by(co.Composition(base, EXACT), system, x0, 0.0, H) == way


@pytest.mark.parametrize("name", [b for b, base in bases().items() if not base.own_steps])
def test_forces_of_size_zero_leave_the_motion_of_the_base(name):
    """Not to the bit: each step of the base begins anew, so that implicit stages start elsewhere."""
    base = bases()[name]
    system, x0, _ = witness(base)
    matrices = hasattr(system, "matrices")
    if matrices or not hasattr(system, "with_forces"):
        return
    try:
        still = system.with_forces(co.forces.LinearDamping(0.0))
    except (TypeError, ValueError):
        return
    plain, forced = (co.integrate(each, x0, (0.5, 1.5), H, base) for each in (system, still))
    size = np.abs(plain.x).max()
    np.testing.assert_allclose(forced.x, plain.x, rtol=0, atol=200 * UNIT_ROUNDOFF * size * 16)
    assert not np.any(forced.work["LinearDamping"]["energy"])
    assert sorted(forced.balance()) == sorted(plain.drift())
