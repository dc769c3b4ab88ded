"""Checks of a case: lines that define `found`, `expected` and `allowed`, which is 0 for equal bits."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import coadjoint as co

from .cases import MEMBERS, STEPS, Case, execute, matrices, value_of
from .schemes import SLOW

Check = Callable[[Case, dict[str, Any]], Iterator[str]]
AT_STEPS = "[0, 2, 3, 5]", "[0, 3, 6, 12]"
"""Among the times of a case those of steps, and the numbers of these steps."""
BY_DIFFERENCES = "e = 2.0**-10\n", "(8.0 * (c - b) - (d - a)) / (12.0 * e)"
"""The derivative along a tenth of a state by differences of order 4 of `a` to `d`, at -2, -1, 1 and 2 times e."""
NEARER = "e = 2.0**-13\n"
ACCURATE = "1e-7 * np.abs(expected).max() + 1e-9"
"""What they may be off: their truncation is e^4 / 30 of the fifth derivative, which is 1e-13 where that is of the size
of a tenth of a state, and less than this where it is 1e5 times as large; rounding of a run is below 1e-12 / e.
"""
DRAWN = 8
"""One of so many cases is drawn where a check takes long."""
COUNTS = (17, 31, 32, 33, 67)
"""Numbers of members: below, at and above whole rows of lanes."""
TAME = (1.0, 0.9, 1.1, 0.95)
WILD = (1.0, 1e-300, 30.0, 1.1, 1e3, 1e-8, 0.0, 0.9, 1e60, 1e6, 0.95)
"""Sizes of members relative to the states of a case."""
PART = 0.17
"""The largest part of the time of a motion that a step takes (`step_for`): what a scheme neglects is its power."""


def same(found: str, expected: str = "numbers(sol)", lines: str = "") -> str:
    """Return a check that two expressions have the same bits."""
    return f"{lines}found, expected, allowed = {found}, {expected}, 0.0\n"


def refusal(call: str, *names: str) -> str:
    """Return a check that a call is refused by a message with these names."""
    lines = f"try:\n    {call}\n    found = False\n"
    lines += f"except (TypeError, ValueError) as error:\n    found = all(name in str(error) for name in {names})\n"
    return f"{lines}expected, allowed = True, 0.0\n"


def bits_of_members(case: Case, space: dict[str, Any]) -> Iterator[str]:
    """A member has the bits that it has alone, among others, on any number of threads, and in any order."""
    many = case.chosen["members"] != "one"
    noise = case.chosen["forces"] == "noise"
    yield same("numbers(run(threads=3))")
    for m in range(1 if noise else MEMBERS) if many else ():
        what = f"systems[{m}]" if case.chosen["members"] == "batch" else "system"
        yield same(f"numbers(sol, {m})", f"numbers(run({what}, x0[{m}]))")
    if many and not noise:
        what = "co.batch(systems[::-1])" if case.chosen["members"] == "batch" else "system"
        yield same("numbers(run(what, x0[::-1]), 0)", f"numbers(sol, {MEMBERS - 1})", f"what = {what}\n")


def bits_of_lanes(case: Case, space: dict[str, Any]) -> Iterator[str]:
    """Among so many members that rows of lanes are full, and some left over, each has the bits that it has alone.

    Some are at rest, far away or failing; schemes that choose their steps would take too many there.
    """
    if case.chosen["members"] == "one" or case.chosen["forces"] == "noise" or case.method in SLOW:
        return
    count, batch = COUNTS[len(str(case)) % len(COUNTS)], case.chosen["members"] == "batch"
    what = "co.batch([systems[m % 3] for m in range(count)])" if batch else "system"
    yield same(
        "[numbers(together, m) for m in chosen]",
        f"[numbers(tried({'systems[m % 3]' if batch else 'system'}, many[m])) for m in chosen]",
        f"count, sizes = {count}, {TAME if space['method'].own_steps else WILD}\n"
        "chosen, sizes = (0, 1, 7, count // 2, count - 2, count - 1), np.resize(sizes, count)\n"
        "many = np.einsum('m,m...->m...', sizes, x0[np.arange(count) % 3])\n"
        f"many = fixed(system, many, 1.0)\n"
        "def tried(*what):\n    try:\n        return run(*what)\n"
        "    except co.IntegrationError as error:\n        return error.partial\n"
        f"together = tried({what}, many)\n",
    )


def bits_of_saved_states(case: Case, space: dict[str, Any]) -> Iterator[str]:
    """What is saved, watched, observed, searched for or computed beside it does not change the states."""
    chosen, plain = case.chosen, "followed=False"
    if chosen["saved"] == "third":
        yield same("rows(numbers(sol), slice(None))", "rows(numbers(run(save_every=1)), slice(None, None, 3))")
    if chosen["saved"] == "times":
        at, steps = AT_STEPS
        if chosen["events"] != "terminal":
            every = "every = run(t_eval=None, save_every=1)\n"
            yield same(f"rows(numbers(sol, {plain}), {at})", f"rows(numbers(every, {plain}), {steps})", every)
        times = "some = run(t_eval=options['t_eval'][:3])\n"
        yield same(f"rows(numbers(some, {plain}), slice(2))", f"rows(numbers(sol, {plain}), slice(2))", times)
    one, other = f"rows(numbers(other, {plain}), slice(None))", f"rows(numbers(sol, {plain}), slice(None))"
    yield same(one, other, f"other = run(watch={chosen['watch'] != 'watched'})\n")
    for name, without in (("attitude", "False"), ("observe", "None"), ("events", "None")):
        if chosen[name] not in ("none", "terminal"):
            lines = f"other = numbers(run({name}={without}), {plain})\n"
            yield same("other", "shared(numbers(sol, followed=False), other)", lines)


def bits_of_prepared_runs(case: Case, space: dict[str, Any]) -> Iterator[str]:
    """A prepared run, before and after other calls, its `end`, and one with inputs equal runs of new systems."""
    chosen = case.chosen
    passed = "".join(
        f", {key}=options[{key!r}]" for key in ("t_eval", "save_every", "events") if key in space["options"]
    )
    if chosen["inputs"] == "none":
        yield same(f"numbers(ready.run(x0, span{passed}))")
        back = "" if chosen["forces"] == "noise" else "[::-1]"
        lines = f"try:\n    ready.run(fixed(system, 0.95 * x0, 1.0), span{back})\n"
        lines += "except (co.IntegrationError, ValueError):\n    pass  # the motion, or a force, has no past\n"
        yield same(f"numbers(ready.run(x0, span{passed}))", lines=lines)
        yield same("ready.end(x0, span)", "ready.run(x0, span).x[-1]")
        return
    name = {"linear": "linear", "torque": "pushed"}[chosen["inputs"]]
    shape = "x0[0].shape" if chosen["members"] == "many" and matrices(value_of(case.system)) else "x0.shape"
    given = f"0.1 * np.sin(1.0 + np.arange(np.prod({shape}))).reshape({shape})"
    if matrices(value_of(case.system)):
        given = f"0.1 * system.algebra.projected({given} * (0.5 + 0.5j))"
    elif name == "pushed":
        given += " * momenta(system)"
    lines = f"own = ready.run(x0, span{passed}, {name}={given})\n"
    every = [lines]
    if "'coordinates'" not in case.method:  # there, a part is left out where a coefficient of the system is zero
        every.append(f"own = ready.run(x0, span{passed})\n")
    for each in every:
        yield same("numbers(own)", "numbers(co.integrate(own.system, x0, span, h, own.method, **options))", each)
    yield same(f"ready.end(x0, span, {name}={given})", f"ready.run(x0, span, {name}={given}).x[-1]")
    if chosen["members"] == "batch" and chosen["forces"] != "noise" and "'coordinates'" not in case.method:
        passing = case.lines.partition("ready = co.prepare(system, ")[2].partition("\n")[0]
        each = f"co.prepare(systems[m], own.{passing}.run(x0[m], span{passed}, {name}=given[m])"
        yield same(
            "[numbers(own, m) for m in (0, 2)]", f"[numbers({each}) for m in (0, 2)]", f"given = {given}\n{lines}"
        )


def bits_of_archives(case: Case, space: dict[str, Any]) -> Iterator[str]:
    """An archived run that is ended early, continued, stopped and continued again."""
    # A scheme that is not registered cannot be found again; times between the steps are not archived.
    if case.chosen["saved"] == "times" or "user." in case.method or len(str(case)) % 5:
        return
    cut = 2 + len(str(case)) % (STEPS - 3)
    yield (
        "import tempfile\n"
        "given = {'system': system, 'observe': options.get('observe'), 'events': options.get('events')}\n"
        "with tempfile.TemporaryDirectory() as folder:\n"
        "    path = f'{folder}/run.zarr'\n"
        f"    early = span[0] + (span[1] - span[0]) / {STEPS} * {cut}\n"
        "    begun, wanted = co.integrate(system, x0, (span[0], early), h, method, archive=path, **options), run()\n"
        "    if begun.t_span == begun.asked_span:\n"
        f"        co.resume(path, span[1], until={(cut + STEPS + 1) // 2}, **given)\n"
        "    else:  # an event has ended it, and there is no later end\n"
        "        wanted = co.integrate(system, x0, (span[0], early), h, method, **options)\n"
        "    found, expected, allowed = numbers(co.resume(path, **given)), numbers(wanted), 0.0\n"
    )


def bits_of_single_steps(case: Case, space: dict[str, Any]) -> Iterator[str]:
    """The first step of a run is that of a stepper, and the formula of the scheme to round-off."""
    if case.chosen["members"] != "one" or space["method"].own_steps or case.chosen["forces"] == "noise":
        return
    first = "way = h if span[1] > span[0] else -h\n"
    first += "one = co.integrate(system, x0, (span[0], span[0] + way), h, method).x[-1]\n"
    if not matrices(value_of(case.system)):
        yield same("co.stepper(system, method, way)(x0, span[0])", "one", first)
        if forces_in(case):
            yield (
                f"{first}{BY_DIFFERENCES[0]}step = co.stepper(system, method, way)\n"
                "move = fixed(system, 0.1 * x0[::-1], 0.0)\n"
                "a, b, c, d = (step(x0 + k * e * move, span[0]) for k in (-2, -1, 1, 2))\n"
                f"found, expected = step.tangent(x0, span[0]) @ move, {BY_DIFFERENCES[1]}\nallowed = {ACCURATE}\n"
            )
    scheme = "method" if not forces_in(case) else "co.methods.Forced(method)"
    # A step has less than 1e5 operations, each of which rounds by u.
    yield (
        f"{first}found, expected = {scheme}.step(system, x0, span[0], way), one\nallowed = 1e-11 * np.abs(x0).max()\n"
    )


def forces_in(case: Case) -> bool:
    return ".with_forces(" in case.lines


def order(case: Case, space: dict[str, Any]) -> Iterator[str]:
    """Errors against SciPy fall with the declared order, or are small at once; so do those of group elements."""
    method, chosen = space["method"], case.chosen
    if chosen["forces"] == "noise" or (matrices(value_of(case.system)) and "f.damped" in case.lines):
        return
    one, _ = one_and_properties(case, space)
    lines = f"{one}from matrix.references import convergence, convergence_of_attitude, exact_end, run_of\n"
    lines += "states = np.stack([x, *(fixed(one, k * x, 1.0) for k in (0.95, 1.05))])\n"
    if method.own_steps:
        # A tolerance of 1e-9 for each of less than a hundred steps; a stride of 0.2 of a scheme of order 2 with forces.
        allowed = 1e-7 if "tolerance" in case.method and not forces_in(case) else 0.2**2
        lines += f"found, expected = run_of(one, method, states, *span, {STEPS}).x[-1], exact_end(one, states, *span)\n"
        yield f"{lines}allowed = {allowed} * (np.linalg.norm(states) + np.linalg.norm(expected))\n"
        return
    expected = min(method.order, 2) if forces_in(case) else method.order
    power = 2 if method.symmetric and not forces_in(case) else 1
    yield f"{lines}found, expected, allowed = convergence(one, method, states, span, {expected}, {power})\n"
    if chosen["attitude"] != "none" and method.order <= 6:
        given = f"x, span, {expected}, {power}, options['attitude']"
        yield f"{lines}found, expected, allowed = convergence_of_attitude(one, method, {given})\n"


def invariants(case: Case, space: dict[str, Any]) -> Iterator[str]:
    """What is declared to be preserved stays within the rounding of a longer run."""
    one, properties = one_and_properties(case, space)
    if forces_in(case):
        yield from drift(case, f"{one}one = one.unforced\n", "method")
    yield from drift(case, one, properties)


def drift(case: Case, one: str, properties: str) -> Iterator[str]:
    """Yield the check for one system."""
    lines = f"{one}from matrix.references import largest_changes, preserved, rounding_of\n"
    steps = 24 if forces_in(case) or "algebras" in case.system else 60 if matrices(value_of(case.system)) else 400
    lines += f"end = span[0] + (span[1] - span[0]) / {STEPS} * {steps}\n"
    lines += "long = attempted(one, x, (span[0], end), h, method, save_every=5)\n"
    lines += f"names = preserved(one, {properties}.properties(one))\n"
    # Beyond a thousand times its first size a motion is not followed.
    yield (
        f"{lines}changes, rounding = largest_changes(long), rounding_of(long)\n"
        "found = {name: changes[name] for name in names}\n"
        "expected, allowed = dict.fromkeys(names, 0.0), {name: rounding[name] for name in names}\n"
    )


def one_and_properties(case: Case, space: dict[str, Any]) -> tuple[str, str]:
    """Return lines that define one system and state, and the text of the scheme that runs."""
    batch, single = case.chosen["members"] == "batch", case.chosen["members"] == "one"
    lines = f"one, x = {'systems[0]' if batch else 'system'}, x0{'' if single else '[0]'}\n"
    return lines, "co.methods.Forced(method)" if forces_in(case) else "method"


def geometry(case: Case, space: dict[str, Any]) -> Iterator[str]:
    """A step that is declared a Poisson map, symmetric, or to carry group elements, is."""
    lines, scheme = one_and_properties(case, space)
    one = space["systems"][0] if case.chosen["members"] == "batch" else space["system"]
    declares = execute(f"import coadjoint as co\nfound = {scheme}.properties(one)", space | {"one": one})["found"]
    if not matrices(value_of(case.system)) and not space["method"].own_steps and case.chosen["forces"] != "noise":
        lines += "way = h if span[1] > span[0] else -h\nfrom matrix.references import poisson_defect\n"
        lines += "work = co.integrate(one, x, (span[0], span[0] + way), h, method).stats.evaluations\n"
        lines += "there, back = (co.stepper(one, method, by) for by in (way, -way))\n"
        if declares.poisson:
            yield f"{lines}found, allowed = poisson_defect(there, x, work)\nexpected = 0.0\n"
        if space["method"].symmetric and (not forces_in(case) or one.reversible):
            yield (
                f"{lines}P = there.tangent(x, span[0])\n"
                "size = np.linalg.norm(np.linalg.inv(P)) * np.linalg.norm(P) * np.linalg.norm(x)\n"
                "found, expected = back(there(x, span[0]), span[0] + way), x\n"
                # The flow of a torque of the state is a step of a Runge-Kutta method: it has no exact inverse.
                "moved = [F.flow(one, F.flow(one, x, span[0], way), span[0] + way, -way) - x for F in one.forces]\n"
                "allowed = (8 * len(x) * (work + 1) * 2.0**-53 + np.linalg.norm(moved)) * size\n"
            )
    if case.chosen["attitude"] == "coadjoint" and declares.attitude in ("every representation", "coadjoint"):
        if forces_in(case) or case.chosen["events"] == "terminal":
            return
        yield (
            "from matrix.references import rounding_of_group\n"
            "back = np.einsum('...ij,...j->...i', sol.attitude, sol.x)\n"
            "found, expected = back, np.broadcast_to(back[0], back.shape)\n"
            "size = np.nanmax(np.linalg.norm(sol.attitude, axis=(-2, -1)) * np.linalg.norm(sol.x, axis=-1))\n"
            "allowed = rounding_of_group(sol, size)\n"
        )


def located(case: Case, space: dict[str, Any]) -> Iterator[str]:
    """Events are where an independent run has a zero, and go the way of the derivative along the field."""
    chosen = case.chosen
    if chosen["events"] == "none" or matrices(value_of(case.system)) or space["sol"].events is None:
        return
    many = chosen["members"] != "one"
    if chosen["events"] == "terminal" and many:
        return  # each member ends at a time of its own
    if chosen["forces"] != "noise" and not space["method"].own_steps and space["sol"].step_error() > 0.5:
        return  # a step so long may jump from one solution of its equations to another, and g with it
    which = "systems[m]" if chosen["members"] == "batch" else "system"
    for m in range(MEMBERS if many else 1):
        yield (
            "from matrix.references import misplaced\n"
            f"m, own = {m}, sol.events{f'.of({m})' if many else ''}\n"
            "changed = {'events': None, 't_eval': None, 'save_every': 1}\n"
            f"along = run({which}, {'x0[m]' if many else 'x0'}, **changed)\n"
            f"found = misplaced({which}, options['events'], own, along, sol.t_span[1])\n"
            "expected, allowed = dict.fromkeys(found, 0.0), {'values': 1e3 * 2.0**-53, 'directions': 0, 'missing': 0}\n"
        )


def blocks(case: Case, space: dict[str, Any]) -> Iterator[str]:
    """Members in blocks, here or on worker processes, have the bits of one run."""
    chosen = case.chosen
    if chosen["blocks"] == "none" or chosen["members"] == "one":
        return
    call = "co.integrate_ensemble(system, x0, span, h, method"
    if "t_eval" in space["options"]:
        yield refusal(f"{call}, t_eval=options['t_eval'])", "t_eval")
    lines = "given = {key: value for key, value in options.items() if key != 't_eval'}\n"
    workers = ", workers=1" if chosen["blocks"] == "workers" else ""
    yield same(
        "numbers(found)",
        "numbers(run(t_eval=None))",
        f"{lines}found = {call}, members_per_block=2{workers}, **given)\n",
    )


def accuracy(case: Case, space: dict[str, Any]) -> Iterator[str]:
    """A step that is chosen for an accuracy reaches it and, if given, has the same bits; else a message says why."""
    if case.chosen["step"] == "given":
        return
    # Each order gives another digit, so that schemes of low order take few steps.
    wanted = 10.0 ** -min(2 + space["method"].order, 9)
    call = f"co.integrate({{}}, span, method=method, accuracy={wanted}, **options)"
    many, others = case.chosen["members"] == "batch", call.format("system, x0")
    if matrices(value_of(case.system)) or "ReversibleSteps" in case.method:
        yield refusal(others, *([] if many or forces_in(case) else ["give step="]))
        return
    if forces_in(case):
        yield refusal(others, "forces")
    if forces_in(case) and len(str(case)) % 4:  # without forces, which would need longer
        return
    begin = f"{one_and_properties(case, space)[0]}from matrix.references import blows_up, exact_end\n"
    what = "one, x"
    if many:
        what = "many, np.broadcast_to(x0, (len(many), many.dim))"
        begin += "many = co.batch([member.unforced for member in system])\n"
    yield (
        f"{begin}one, options = one.unforced, options | {{'events': None}}\ntry:\n"
        f"    chosen = {call.format(what)}\n"
        f"    again = co.integrate({what}, span, chosen.step, chosen.method, **options)\n"
        "    assert_agree(numbers(again), numbers(chosen))\n"
        f"    members = {'enumerate(many)' if many else '[(..., one)]'}\n"
        "    sizes = np.linalg.norm(chosen.x, axis=-1).max(axis=0)\n"
        "    exact = [exact_end(member, chosen.x[0, m], *span) for m, member in members]\n"
        "    found = np.max(np.linalg.norm(chosen.x[-1] - np.squeeze(exact), axis=-1) / sizes)\n"
        "except ValueError as refused:\n"
        f"    right = 'reaches the accuracy {wanted:g}' in str(refused)\n"
        f"    pairs = {'zip(many, np.broadcast_to(x0, (len(many), many.dim)))' if many else '[(one, x)]'}\n"
        "    right = right or 'blows up' in str(refused) and any(blows_up(*pair, *span) for pair in pairs)\n"
        "    found = 0.0 if right else np.inf\n"
        f"expected, allowed = 0.0, {wanted}\n"
    )


def corrected(case: Case, space: dict[str, Any]) -> Iterator[str]:
    """A corrector is an invertible Poisson map, or a message says why there is none."""
    if case.chosen["output"] == "plain":
        return
    one, _ = one_and_properties(case, space)
    call = f"{one[:-1]}; co.make_corrector(one, method, x)"
    plain, method = value_of(case.system), space["method"]
    if forces_in(case):
        yield refusal(call, "forces")
        call = call.replace("(one,", "(one.unforced,")
        one += "one = one.unforced\n"
    if not isinstance(plain, co.LiePoissonSystem):
        yield refusal(call, "LiePoissonSystem")
        return
    kernel = re.sub(r"co\.(Composition|methods\.even_order)\((base=)?", "", case.method)
    innermost = method
    while isinstance(innermost, co.Composition):
        innermost = innermost.base
    if not isinstance(innermost, co.methods.FlowMethod):
        yield refusal(call, "order" if "tolerance" in kernel else "Splitting")
        return
    if not isinstance(plain.hamiltonian, co.Quadratic | co.Polynomial) or method.order * plain.dim > 24:
        return  # the fit of many monomials takes seconds
    yield (
        # Over so short a way that it moves little: as a step of order 4 it is a Poisson map up to a small term.
        f"{one}way = (span[1] - span[0]) / abs(span[1] - span[0]) * min(h, 0.25)\n"
        "better, size = co.make_corrector(one, method, x), np.linalg.norm(x)\n"
        "while np.linalg.norm(better.inverse(x, way) - x) > 0.05 * size:\n    way /= 2\n"
        "start = better.inverse(x, way)\n"
        "P = np.stack([(8 * (better(start + e, way) - better(start - e, way)) - better(start + 2 * e, way)"
        " + better(start - 2 * e, way)) / (12 * 2.0**-9) for e in 2.0**-9 * np.eye(len(x))], 1)\n"
        "J = one.structure_matrix\n"
        "found = {'back': better(start, way), 'bracket': P @ J(start) @ P.T}\n"
        "expected = {'back': x, 'bracket': J(better(start, way))}\n"
        "allowed = {'back': 1e-13 * size, 'bracket': 1e-7 * size}\n"
    )


def derivatives(case: Case, space: dict[str, Any]) -> Iterator[str]:
    """Tangents agree with gradients to round-off, and with differences."""
    chosen = case.chosen
    if space["method"].own_steps and (forces_in(case) or chosen["inputs"] != "none"):
        yield refusal("ready.jvp(x0, span, {'x0': x0})", "steps")
        return
    turned = chosen["attitude"] != "none"
    steps = STEPS if compiled_derivatives(case) else 1
    times = ", t_eval=options['t_eval']" if steps == STEPS and "t_eval" in space["options"] else ""
    lines = "x = x0[0]\n" if chosen["members"] == "many" and steps == 1 else "x = x0\n"
    lines += f"few = (span[0], span[0] + (span[1] - span[0]) / {STEPS} * {steps})\n"
    moved = "system.algebra.projected(x @ x)" if matrices(value_of(case.system)) else "x[..., ::-1]"
    lines += f"move = fixed(system, 0.1 * {moved}, 0.0)\n"
    key = {"none": "", "linear": "linear", "torque": "pushed"}[chosen["inputs"]]
    if matrices(value_of(case.system)):
        key = ""
    value = f", {key}=value" if key else ""
    if key:
        taken = " * momenta(system)" if key == "pushed" else ""
        lines += f"value, push = 0.2 * move{taken}, 0.1 * np.cos(x){taken}\n"
        lines += "value, push = (value[0], push[0]) if value.ndim == 2 else (value, push)\n"
    # Rounding of twelve steps of about a thousand operations, and that of differences of order 8.
    names = ["x", "energy", "attitude"] if turned else ["x", "energy"]
    duality = (
        "rng = np.random.default_rng(7)\n"
        "along = {name: rng.normal(size=np.shape(value)) for name, value in ready.parameters.items()}\n"
        "along['x0'] = move\n"
    )
    if turned:
        duality += "along['attitude0'] = rng.normal(size=sol.attitude.shape[sol.attitude.ndim - x.ndim - 1 :])\n"
    inputs = f", 'inputs': {{{key!r}: push}}" if key else ""
    duality += (
        f"_, tangents = ready.jvp(x, few, {{**along{inputs}}}{times}{value})\n"
        f"_, pullback = ready.vjp(x, few{times}{value})\n"
        f"parts = {{name: getattr(tangents, name) for name in {names}}}\n"
        "weights = {name: np.cos(1.0 + np.arange(v.size)).reshape(v.shape) for name, v in parts.items()}\n"
        "gradient = pullback(**weights)\n"
        "pairs = [(gradient[name], along[name]) for name in along]\n"
        + (f"pairs += [(gradient['inputs'][{key!r}], push)]\n" if key else "")
        + "found = sum(np.vdot(weights[name], parts[name]).real for name in parts)\n"
        "expected = sum(np.vdot(one, other).real for one, other in pairs)\n"
        "size = sum(np.abs(weights[name] * parts[name]).sum() for name in parts)\n"
        "size += sum(np.abs(one * other).sum() for one, other in pairs)\n"
        "allowed = (1e-9 if 'differences' in str(tangents.rule) else 1e-12) * size\n"
    )
    # In Python each entry of a parameter takes sixteen steps, there and back: of cases with many, a part is drawn.
    entries = sum(np.size(value) for value in space["ready"].parameters.values())
    if compiled_derivatives(case) or entries < 8 or len(case.lines) % DRAWN == 1:
        yield lines + duality
    if compiled_derivatives(case) and chosen["members"] != "one" and not key:
        passing = case.lines.partition("ready = co.prepare(system, ")[2].partition("\n")[0]
        one = f"co.prepare({'systems[m]' if chosen['members'] == 'batch' else 'system'}, {passing}"
        yield same(
            "[[tangents.x[:, m], gradient['x0'][m]] for m in (0, 2)]",
            "[[alone.jvp(x[m], few, {'x0': move[m]}" + times + ")[1].x,"
            " alone.vjp(x[m], few" + times + ")[1](weights['x'][:, m])['x0']] for m, alone in ones]",
            f"{lines}ones = [(m, {one}) for m in (0, 2)]\n"
            f"_, tangents = ready.jvp(x, few, {{'x0': move}}{times})\n"
            f"sol, pullback = ready.vjp(x, few{times})\n"
            "weights = {'x': np.cos(1.0 + np.arange(sol.x.size)).reshape(sol.x.shape)}\n"
            "gradient = pullback(**weights)\n",
        )
    if space["method"].own_steps:
        return  # the derivatives are those of steps of fixed lengths
    plain = f"ready.run(x + k * e * move, few{times}{f', {key}=value + k * e * push' if key else ''})"
    changes, other = changed_parameters(case, space)
    given = case.lines.partition("ready = co.prepare(system, ")[2].partition("\n")[0]
    moved = plain.replace("ready", f"co.prepare({other}, {given}", 1) if other else plain
    # By parameters on which the form of the parts depends, it is the derivative of another scheme of the same order; so
    # it is where parts were chosen for inputs, or change there, and steps are not compiled. Each has such an error.
    bound = f"2 * {PART} ** {min(space['method'].order, 2) if forces_in(case) else space['method'].order}"
    fixed = "'differences' in str(tangents.rule)" if other and "Splitting" in case.method else "False"
    for text, steps_of in {moved: changes, plain: {}}.items() if compiled_derivatives(case) else [(moved, changes)]:
        directions = ", ".join(["'x0': move", *(f"{name!r}: {step}" for name, step in steps_of.items())])
        yield (
            f"{lines}{BY_DIFFERENCES[0]}whole = getattr(system, 'unforced', system)\n"
            f"moved = [{text} for k in (-2, -1, 1, 2)]\n"
            f"_, tangents = ready.jvp(x, few, {{{directions}{inputs}}}{times}{value})\n"
            "found, wanted, allowed = {}, {}, {}\n"
            f"for name in {names}:\n    a, b, c, d = (getattr(one, name) for one in moved)\n"
            f"    found[name], expected = getattr(tangents, name), {BY_DIFFERENCES[1]}\n"
            f"    part = {bound} if 'added part' in str(tangents.rule) or {fixed} else 0.0\n"
            f"    wanted[name], allowed[name] = expected, part * np.abs(expected).max() + {ACCURATE}\n"
            "expected = wanted\n"
        )


def compiled_derivatives(case: Case) -> bool:
    """Return whether derivatives are not those of steps in Python, one by one, which take longer."""
    return case.method.startswith(("co.Splitting", "co.GaussLegendre", "user.Flows")) and not forces_in(case)


def changed_parameters(case: Case, space: dict[str, Any]) -> tuple[dict[str, str], str]:
    """Return steps of parameters of the forces and of one of the system, and the system with k e times these steps."""
    known = space["ready"].parameters
    if case.chosen["members"] == "batch" or matrices(value_of(case.system)):
        return {}, ""
    changes, own = {}, case.system
    acting = case.lines.partition(".with_forces(")[2].partition("\n")[0] if forces_in(case) else ""
    for key in (key for key in known if "." in key):
        force, _, parameter = key.partition(".")
        if acting.count(f"{force}({parameter}=") == 1:
            moved = known[key] != 0.0 if parameter == "torque" else np.ones(np.shape(known[key]))  # momenta alone
            changes[key] = str((0.1 * moved).tolist())
            acting = acting.replace(f"{force}({parameter}=", f"{force}({parameter}=k * e * np.array({changes[key]}) + ")
    name = case.system.removeprefix("co.systems.").partition("(")[0]
    if case.system.startswith("co.systems."):
        for key in [k for k in known if k in value_of(case.system).parameters][:1]:
            value = np.asarray(known[key])
            step = np.round(0.1 * value * np.cos(1.0 + np.arange(value.size).reshape(value.shape)), 6)
            changes[key] = str(step.tolist())
            moved = f"np.asarray(whole.parameters[{key!r}]) + k * e * np.array({changes[key]})"
            own = f"co.systems.{name}(**dict(whole.parameters, {key}={moved}))"
    return changes, f"{own}{f'.with_forces({acting}' if acting else ''}" if changes else ""


CHECKS: tuple[Check, ...] = (
    bits_of_members,
    bits_of_lanes,
    bits_of_saved_states,
    bits_of_prepared_runs,
    bits_of_archives,
    bits_of_single_steps,
    order,
    invariants,
    geometry,
    located,
    blocks,
    accuracy,
    corrected,
    derivatives,
)
