"""Checks of a case: lines that define `found`, `expected` and `allowed`, which is 0 for equal bits."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import coadjoint as co

from .cases import MEMBERS, STEPS, Case, matrices, value_of
from .references import errors_of, slope_of

Check = Callable[[Case, dict[str, Any]], Iterator[str]]
DEVIATING = {("decorated_particles", "weights")}  # derivatives that are not those of runs with other values
AT_STEPS = "[0, 2, 3, 5]", "[0, 3, 6, 12]"
"""Among the times of a case those of steps, and the numbers of these steps."""


def same(found: str, expected: str = "numbers(sol)", lines: str = "") -> str:
    """Return a check that two expressions have the same bits."""
    return f"{lines}found, expected, allowed = {found}, {expected}, 0.0\n"


def refusal(call: str, *names: str) -> str:
    """Return a check that a call is refused by a message with these names."""
    lines = f"try:\n    {call}\n    found = 'not refused'\n"
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
        yield same(f"numbers(ready.run(x0, span{passed}))", lines="ready.run(0.5 * x0, span)\n")
        yield same("ready.end(x0, span)", "ready.run(x0, span).x[-1]")
        return
    name = {"linear": "linear", "torque": "pushed"}[chosen["inputs"]]
    shape = "x0.shape" if chosen["members"] == "many" and not matrices(value_of(case.system)) else "x0[0].shape"
    shape = "x0.shape" if chosen["members"] == "one" else shape
    given = f"0.1 * np.sin(1.0 + np.arange(np.prod({shape}))).reshape({shape})"
    if matrices(value_of(case.system)):
        given = f"0.1 * system.algebra.projected({given} * (0.5 + 0.5j))"
    lines = f"own = ready.run(x0, span{passed}, {name}={given})\n"
    every = [lines]
    if "'coordinates'" not in case.method:  # there, a part is left out where a coefficient of the system is zero
        every.append(f"own = ready.run(x0, span{passed})\n")
    for each in every:
        yield same("numbers(own)", "numbers(co.integrate(own.system, x0, span, h, own.method, **options))", each)


def bits_of_archives(case: Case, space: dict[str, Any]) -> Iterator[str]:
    """An archived run that is ended early, continued, stopped and continued again."""
    # A scheme that is not registered cannot be found again; times between the steps are not archived.
    if case.chosen["saved"] == "times" or "user." in case.method or len(str(case)) % 3:
        return
    cut = 2 + len(str(case)) % (STEPS - 3)
    yield (
        "import tempfile\n"
        "plain = {key: value for key, value in options.items() if key != 'events'}\n"
        "given = {'system': system, 'observe': options.get('observe')}\n"
        "with tempfile.TemporaryDirectory() as folder:\n"
        "    path = f'{folder}/run.zarr'\n"
        f"    early = span[0] + (span[1] - span[0]) / {STEPS} * {cut}\n"
        "    co.integrate(system, x0, (span[0], early), h, method, archive=path, **plain)\n"
        f"    co.resume(path, span[1], until={(cut + STEPS + 1) // 2}, **given)\n"
        "    found = numbers(co.resume(path, **given))\n"
        "expected, allowed = numbers(run(events=None)), 0.0\n"
    )


def bits_of_single_steps(case: Case, space: dict[str, Any]) -> Iterator[str]:
    """The first step of a run is that of a stepper, and the formula of the scheme to round-off."""
    if case.chosen["members"] != "one" or space["method"].own_steps or case.chosen["forces"] == "noise":
        return
    first = "way = h if span[1] > span[0] else -h\n"
    first += "one = co.integrate(system, x0, (span[0], span[0] + way), h, method).x[-1]\n"
    if not matrices(value_of(case.system)):
        yield same("co.stepper(system, method, way)(x0, span[0])", "one", first)
    scheme = "method" if not forces_in(case) else "co.methods.Forced(method)"
    yield (
        f"{first}found, expected = {scheme}.step(system, x0, span[0], way), one\nallowed = 1e-11 * np.abs(x0).max()\n"
    )


def forces_in(case: Case) -> list[str]:
    """Return the forces of a case."""
    return [".with_forces("] if ".with_forces(" in case.lines else []


def one_error(steps: int) -> str:
    """Return the line that computes the error with this number of steps."""
    return f"(found,) = errors_of(one, method, states, *span, [{steps}])\n"


def order(case: Case, space: dict[str, Any]) -> Iterator[str]:
    """Errors against SciPy fall with the declared order, or are small at once."""
    method, chosen = space["method"], case.chosen
    if chosen["forces"] == "noise" or (matrices(value_of(case.system)) and "f.damped" in case.lines):
        return
    one = space["systems"][0] if chosen["members"] == "batch" else space["system"]
    expected = min(method.order, 2) if forces_in(case) else method.order
    x, (start, end) = space["x0"], space["span"]
    x = x if chosen["members"] == "one" else x[0]
    states = np.stack([x, 0.95 * x, 1.05 * x])
    lines = "from matrix.references import errors_of, slope_of\n"
    lines += f"one, x = {'systems[0]' if chosen['members'] == 'batch' else 'system'}, "
    lines += f"x0{'' if chosen['members'] == 'one' else '[0]'}\nstates = np.stack([x, 0.95 * x, 1.05 * x])\n"
    size = float(np.linalg.norm(states))
    if method.own_steps:
        allowed = 1e-7 if "tolerance" in case.method and not forces_in(case) else 0.02
        yield f"{lines}{one_error(STEPS)}expected, allowed = 0.0, {allowed * size}\n"
        return
    finest, ratio = (256, 2.0) if expected <= 2 else (96, 2**0.5) if expected < 7 else (48, 2**0.25)
    counts = sorted({round(finest / ratio**k) for k in range(12) if finest / ratio**k >= 3})
    errors = dict(zip(counts, errors_of(one, method, states, start, end, counts), strict=True))
    usable = [n for n in counts if errors[n] > 1e-10 * size][-5:]
    if len(usable) < 5:
        if counts[-1] not in usable:
            yield f"{lines}{one_error(counts[-1])}expected, allowed = 0.0, {1e-9 * size}\n"
        return
    # With error = C h^p (1 + a h^q + ...) the deviation from p falls as h^q from the larger to the smaller steps.
    own = [errors[n] for n in usable]
    change = abs(slope_of(usable, own) - slope_of(usable[:3], own[:3]))
    power = 2 if method.symmetric and not forces_in(case) else 1
    allowed = 0.075 + change / ((usable[3] / usable[1]) ** power - 1.0)
    if allowed < 0.45:
        measured = "slope_of(counts, errors_of(one, method, states, *span, counts))"
        yield (
            f"{lines}counts = {usable}\nfound = min({expected}, {measured})\n"
            f"expected, allowed = {expected}, {allowed:.3f}\n"
        )


def invariants(case: Case, space: dict[str, Any]) -> Iterator[str]:
    """What is declared to be preserved stays within the rounding of a longer run."""
    one, properties = one_and_properties(case, space)
    if forces_in(case):
        yield from drift(case, f"{one}one = one.system\n", "method")
    yield from drift(case, one, properties)


def drift(case: Case, one: str, properties: str) -> Iterator[str]:
    """Yield the check for one system."""
    lines = f"{one}from matrix.references import largest_changes, preserved, rounding_of\n"
    steps = 24 if forces_in(case) or "algebras" in case.system else 60 if matrices(value_of(case.system)) else 400
    lines += f"end = span[0] + (span[1] - span[0]) / {STEPS} * {steps}\n"
    lines += "long = attempted(one, x, (span[0], end), h, method, save_every=5)\n"
    lines += f"names = preserved(one, {properties}.properties(one))\n"
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
    one, _ = one_and_properties(case, space)
    system = value_of(case.system)
    declares = execute_properties(case, space)
    way = "way = h if span[1] > span[0] else -h\n"
    if not matrices(system) and not space["method"].own_steps and case.chosen["forces"] != "noise":
        if declares.poisson:
            lines = f"{one}{way}from matrix.references import poisson_defect\n"
            lines += "work = co.integrate(one, x, (span[0], span[0] + way), h, method).stats.evaluations\n"
            yield f"{lines}found, allowed = poisson_defect(co.stepper(one, method, way), x, work)\nexpected = 0.0\n"
        if space["method"].symmetric and not (forces_in(case) and not reversible(space)):
            lines = f"{one}{way}there, back = co.stepper(one, method, way), co.stepper(one, method, -way)\n"
            lines += "P = there.tangent(x, span[0])\n"
            lines += "size = np.linalg.norm(np.linalg.inv(P)) * np.linalg.norm(P) * np.linalg.norm(x)\n"
            lines += "work = co.integrate(one, x, (span[0], span[0] + way), h, method).stats.evaluations\n"
            yield (
                f"{lines}found, expected = back(there(x, span[0]), span[0] + way), x\n"
                "allowed = 8 * len(x) * (work + 1) * 2.0**-53 * size\n"
            )
    if case.chosen["attitude"] in ("coadjoint",) and declares.attitude in ("every representation", "coadjoint"):
        if forces_in(case) or case.chosen["events"] == "terminal":
            return
        yield (
            "from matrix.references import rounding_of_group\n"
            "back = np.einsum('...ij,...j->...i', sol.attitude, sol.x)\n"
            "found, expected = back, np.broadcast_to(back[0], back.shape)\n"
            "size = np.nanmax(np.linalg.norm(sol.attitude, axis=(-2, -1)) * np.linalg.norm(sol.x, axis=-1))\n"
            "allowed = rounding_of_group(sol, size)\n"
        )


def execute_properties(case: Case, space: dict[str, Any]) -> Any:
    """Return what the scheme of a case declares."""
    one = space["systems"][0] if case.chosen["members"] == "batch" else space["system"]
    return (co.methods.Forced(space["method"]) if forces_in(case) else space["method"]).properties(one)


def reversible(space: dict[str, Any]) -> bool:
    one = space["systems"][0] if "systems" in space else space["system"]
    return bool(one.reversible)


def derivatives(case: Case, space: dict[str, Any]) -> Iterator[str]:
    """Tangents agree with gradients to round-off, and with differences."""
    chosen = case.chosen
    if chosen["members"] == "batch":
        return
    if space["method"].own_steps and (forces_in(case) or chosen["inputs"] != "none"):
        yield refusal("ready.jvp(x0, span, {'x0': x0})", "steps")
        return
    turned = chosen["attitude"] != "none"
    steps = STEPS if compiled_derivatives(case) else 1
    times = ", t_eval=options['t_eval']" if steps == STEPS and "t_eval" in space["options"] else ""
    lines = "x = x0[0]\n" if chosen["members"] == "many" and steps == 1 else "x = x0\n"
    lines += f"few = (span[0], span[0] + (span[1] - span[0]) / {STEPS} * {steps})\n"
    moved = "system.algebra.projected(x @ x)" if matrices(value_of(case.system)) else "x[..., ::-1]"
    lines += f"move = 0.1 * {moved}\n"
    duality = (
        "rng = np.random.default_rng(7)\n"
        "along = {name: rng.normal(size=np.shape(value)) for name, value in ready.parameters.items()}\n"
        "along['x0'] = move\n"
    )
    if turned:
        duality += "along['attitude0'] = rng.normal(size=sol.attitude.shape[sol.attitude.ndim - x.ndim - 1 :])\n"
    names = ["x", "energy", "attitude"] if turned else ["x", "energy"]
    duality += (
        f"_, tangents = ready.jvp(x, few, along{times})\n"
        f"_, pullback = ready.vjp(x, few{times})\n"
        f"parts = {{name: getattr(tangents, name) for name in {names}}}\n"
        "weights = {name: np.cos(1.0 + np.arange(v.size)).reshape(v.shape) for name, v in parts.items()}\n"
        "gradient = pullback(**weights)\n"
        "found = sum(np.vdot(weights[name], parts[name]).real for name in parts)\n"
        "expected = sum(np.vdot(gradient[name], along[name]).real for name in along)\n"
        "size = sum(np.abs(weights[name] * parts[name]).sum() for name in parts)\n"
        "size += sum(np.abs(gradient[name] * along[name]).sum() for name in along)\n"
        "allowed = (1e-6 if 'differences' in tangents.rule.values() else 1e-12) * size\n"
    )
    yield lines + duality
    if space["method"].own_steps:
        return  # the derivatives are those of steps of fixed lengths
    yield lines + (
        "e = 2.0**-9\n"
        f"moved = [ready.run(x + k * e * move, few{times}) for k in (-2, -1, 1, 2)]\n"
        f"_, tangents = ready.jvp(x, few, {{'x0': move}}{times})\n"
        f"names = {names}\n"
        "def by_differences(name):\n"
        "    a, b, c, d = (getattr(one, name) for one in moved)\n"
        "    return (8.0 * (c - b) - (d - a)) / (12.0 * e)\n"
        "found, expected = {n: getattr(tangents, n) for n in names}, {n: by_differences(n) for n in names}\n"
        "allowed = {n: 1e-7 * np.abs(expected[n]).max() + 1e-9 for n in names}\n"
    )
    yield from by_parameters(case, space, lines, times)


def compiled_derivatives(case: Case) -> bool:
    """Return whether derivatives are not those of steps in Python, one by one, which take longer."""
    return case.method.startswith(("co.Splitting", "co.GaussLegendre", "user.Flows")) and not forces_in(case)


def by_parameters(case: Case, space: dict[str, Any], before: str, times: str) -> Iterator[str]:
    """Derivatives by parameters and inputs against differences of new systems."""
    name = case.system.removeprefix("co.systems.").partition("(")[0]
    if not case.system.startswith("co.systems.") or case.chosen["inputs"] != "none":
        return
    known = [
        key
        for key in space["ready"].parameters
        if key in value_of(case.system).parameters and (name, key) not in DEVIATING
    ]
    acting = case.lines.partition(".with_forces(")[2].partition("\n")[0] if forces_in(case) else ""
    for key in known[:1]:
        value = np.asarray(space["ready"].parameters[key])
        change = np.round(0.1 * value * np.cos(1.0 + np.arange(value.size).reshape(value.shape)), 6)
        yield (
            f"{before}e, step = 2.0**-7, np.array({change.tolist()})\n"
            f"whole = getattr(system, 'system', system)\n"
            f"def moved(k):\n"
            f"    changed = dict(whole.parameters, {key}=np.asarray(whole.parameters[{key!r}]) + k * e * step)\n"
            f"    other = co.systems.{name}(**changed){f'.with_forces({acting}' if acting else ''}\n"
            f"    return co.integrate(other, x, few, h, ready.run(x, few).method{times}).x\n"
            f"_, tangents = ready.jvp(x, few, {{{key!r}: step}}{times})\n"
            "found = tangents.x\n"
            "expected = (8.0 * (moved(1) - moved(-1)) - (moved(2) - moved(-2))) / (12.0 * e)\n"
            f"rule = tangents.rule[{key!r}]\n"
            f"allowed = (1e-6 if rule != 'added part' else 0.05) * np.abs(expected).max() + 1e-11\n"
        )


CHECKS: tuple[Check, ...] = (
    bits_of_members,
    bits_of_saved_states,
    bits_of_prepared_runs,
    bits_of_archives,
    bits_of_single_steps,
    order,
    invariants,
    geometry,
    derivatives,
)
