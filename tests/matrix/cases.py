"""Cases: lines of Python that prepare and run a scheme on a system with options, drawn from a seed."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

import coadjoint as co

from .forces import force_text, is_noise
from .options import BESIDE, NEUTRAL, Options, covering
from .schemes import SLOW, schemes
from .systems import drawn_system, numbers_of, systems, varied

IMPORTS = """\
import numpy as np
import coadjoint as co
import matrix.functions as f
import matrix.user_schemes as user
from matrix.results import assert_agree, attempted, fixed, momenta, numbers, rows, shared
"""
MEMBERS = 3
STEPS = 12
HERE = {"blocks": "here"}
TIMES = "span[0] + (span[1] - span[0]) * np.array([0.0, 0.21, 0.25, 0.5, 0.77, 1.0])"
REFUSALS = (ValueError, TypeError)


class Refused(Exception):
    """Options that the library refuses, with its error as the cause."""


@dataclass(frozen=True)
class Case:
    """A scheme on a system with options; `lines` define `system`, `method`, `x0`, `span`, `h`, `options` and `run`."""

    method: str
    system: str
    options: tuple[tuple[str, str], ...]
    lines: str

    @property
    def chosen(self) -> Options:
        return dict(self.options)

    def __str__(self) -> str:
        shown = [f"{name}={value}" for name, value in self.options if value != NEUTRAL[name]]
        return f"{self.method} on {self.system}" + (f" with {', '.join(shown)}" if shown else "")


def execute(lines: str, space: dict[str, Any] | None = None) -> dict[str, Any]:
    """Execute lines, and return their names."""
    space = dict(space or {})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", co.LargeStepWarning)
        warnings.simplefilter("ignore", co.RoundingWarning)
        warnings.filterwarnings("ignore", "the steps of Heun|.*no body has")
        exec(compile(lines, "<lines of a case>", "exec"), space)
    return space


@cache
def value_of(text: str) -> Any:
    """Return the value of an expression."""
    return execute(f"{IMPORTS}value = {text}")["value"]


@cache
def refusals(method: str, system: str) -> tuple[str, ...]:
    """Return the messages with which the declaration of a scheme and a run refuse a system."""
    scheme, on, found = value_of(method), value_of(system), []
    for call in (lambda: scheme.properties(on), lambda: method in SLOW or co.prepare(on, scheme, 0.125)):
        try:
            call()
        except REFUSALS as error:
            found.append(str(error))
    return tuple(found)


def supported(method: str, system: str) -> bool:
    """Return whether a scheme can be run on a system."""
    return not refusals(method, system)


def matrices(system: Any) -> bool:
    """Return whether states are matrices."""
    return system.has_matrices


def start_text(system: Any, rng: np.random.Generator, members: int) -> str:
    """Return initial states as text."""
    if matrices(system):
        shape = (*((members,) if members else ()), *system.shape)
        weight = "0.5" if str(system.algebra).startswith("so") else "(0.3 + 0.2j)"
        return f"system.algebra.projected({weight} * np.random.default_rng({rng.integers(99)}).normal(size={shape}))"
    n = system.dim
    size = rng.uniform(0.4, 0.9, (members, n) if members else n)
    states = np.round(size * rng.choice([-1.0, 1.0], size.shape), 3)
    basis = list(getattr(system.algebra, "basis", ()))
    if "z" in basis:
        states[..., basis.index("z")] = 1.0  # that of the canonical brackets
    if hasattr(system, "positions"):
        for state in states if members else [states]:
            put_on_orbit(system, state)
    return numbers_of(states)


def put_on_orbit(system: Any, state: np.ndarray) -> None:
    """Move bodies apart, and turn them about each other so that they do not collide, forward nor backward in time."""
    count, masses = len(system.masses), np.array(system.masses)
    apart = np.arange(count) - (count - 1) / 2.0
    positions, momenta = (state[-1 - k * 3 * count : -1 - (k - 1) * 3 * count].reshape(count, 3) for k in (1, 2))
    positions[:] = 0.2 * positions + np.outer(4.0 * apart, [1.0, 0.0, 0.0])
    accelerations = system.vector_field(state)[-1 - 6 * count : -1 - 3 * count].reshape(count, 3) / masses[:, None]
    # On a circle of this radius, the attraction is the centripetal force.
    speed = np.sqrt(np.maximum(0.0, -accelerations[:, 0] * positions[:, 0])) * np.sign(apart)
    momenta[:] = 0.05 * momenta + np.outer(masses * speed, [0.0, 1.0, 0.0])
    state[:] = np.round(state, 3)


def step_for(system: Any, states: np.ndarray) -> float:
    """Return a power of two, of about a tenth of the time in which a state changes by its size."""
    rates = [np.linalg.norm(system.vector_field(x)) / np.linalg.norm(x) for x in states]
    return float(2.0 ** np.clip(np.round(np.log2(0.12 / max(*rates, 0.1))), -10, 0))


def forces_of(system: Any, options: Options, rng: np.random.Generator) -> list[str]:
    """Return forces that the system takes; a torque if one is an input."""
    noisy, wanted = options["forces"] == "noise", {"none": 0, "one": 1, "two": 2, "noise": 2}[options["forces"]]
    found = [force_text("Torque", system)] if options["inputs"] == "torque" else []
    # Sampled forces make states longer.
    fitting = [name for name in co.forces.names() if not issubclass(getattr(co.forces, name), co.forces.Sampled)]
    names = [str(name) for name in rng.permutation(fitting)]
    timed = wanted == 2 or rng.random() < 0.3  # a force of the user depends on time
    for name in sorted(names, key=lambda name: (noisy != is_noise(name), timed and name != "OwnForce")):
        text = force_text(name, system)
        if len(found) < wanted and text not in found and (not is_noise(name) or (noisy and not found)):
            try:
                execute(f"{IMPORTS}system.with_forces({text})", {"system": system})
            except (*REFUSALS, AttributeError):
                continue
            found.append(text)
    return found


def declared(method: str, system: str, forces: list[str]) -> co.methods.Properties:
    """Return what a scheme declares to preserve, with forces or without."""
    if not forces:
        return value_of(method).properties(value_of(system))
    forced = execute(f"{IMPORTS}system = {system}\nsystem = system.with_forces({', '.join(forces)})")["system"]
    return co.methods.Forced(value_of(method)).properties(forced)


def excluded(options: Options, system: Any, attitude: str, without_forces: bool) -> list[str]:
    """Return options that are refused with others, in the order in which they are dropped."""
    noise, batch = options["forces"] == "noise" and not without_forces, options["members"] == "batch"
    own = options["attitude"] == "own" and getattr(system, "representation", None) is None
    refused = {
        "forces": without_forces,
        "direction": noise and options["direction"] == "backward",
        "saved": noise and options["saved"] == "times",
        "events": noise and options["events"] != "none",
        "members": batch and matrices(system),
        "inputs": matrices(system) and options["inputs"] == "linear",
        "attitude": options["attitude"] != "none" and (attitude == "none" or own),
    }
    return [name for name, is_refused in refused.items() if is_refused]


def case_of(method: str, system: str, options: Options, seed: int, slower: float = 1.0) -> tuple[Case, dict[str, Any]]:
    """Return the case and the names that its lines define; raise Refused if the library refuses it."""
    rng = np.random.default_rng(seed)
    plain, count = value_of(system), 0 if options["members"] == "one" else MEMBERS
    states = start_text(plain, rng, count)
    x = execute(f"{IMPORTS}x = {states}", {"system": plain})["x"]
    x = x if count else x[None]
    h, start = step_for(plain, x) / slower, {"zero": 0.0, "later": 1.5}[options["start"]]
    end = start + (h if options["direction"] == "forward" else -h) * STEPS
    acting = ", ".join(forces_of(plain, options, rng))
    forced = [f"{varied(system, m)}{f'.with_forces({acting})' if acting else ''}" for m in range(count or 1)]
    lines = f"system = {system}\n" if matrices(plain) and acting else ""
    batch = options["members"] == "batch"
    lines += f"systems = [{', '.join(forced)}]\nsystem = co.batch(systems)\n" if batch else f"system = {forced[0]}\n"
    lines += f"method = {method}\nx0 = {states}\nspan, h = {(start, end)}, {h}\n"
    given = {"watch": str(options["watch"] == "watched"), "threads": "1"}
    given |= {"every": {}, "third": {"save_every": "3"}, "times": {"t_eval": TIMES}}[options["saved"]]
    if options["attitude"] != "none":
        turned = f"expm(0.4 * {'systems[0]' if batch else 'system'}{'.unforced' if acting else ''}.representation[0])"
        given["attitude"] = {"coadjoint": "'coadjoint'", "own": "True", "turned": turned}[options["attitude"]]
        lines = ("from scipy.linalg import expm\n" if options["attitude"] == "turned" else "") + lines
    if options["events"] != "none":
        level = np.round(x[0].ravel()[1] + 2.4 * (end - start) / STEPS * field_at(plain, x[0], start).ravel()[1], 4)
        event, wave = "co.Event(f.corner_wave, name='level'", "f.corner_wave" if matrices(plain) else "f.wave"
        if not matrices(plain):
            event = f"co.Event(co.Quadratic(0.0, linear=np.eye({x.shape[1]})[1], constant={-level}), name='level'"
        terminal = ", terminal=True" if options["events"] == "terminal" else ""
        given["events"] = f"[{event}{terminal}), co.Event({wave}, direction=1, name='wave')]"
    if options["observe"] != "none":
        prefix = "f.corner_" if matrices(plain) else "f."
        given["observe"] = f"{{'product': {prefix}product, 'clock': {prefix}clock}}"
    lines += f"options = dict({', '.join(f'{key}={value}' for key, value in given.items())})\n"
    # A prepared run does not estimate the error of a step, which takes longer than the run.
    lines += "def run(what=system, x=x0, **changes):\n    given = options | changes\n"
    lines += (
        "    passed = {key: given.pop(key) for key in ('watch', 'observe', 'threads', 'attitude') if key in given}\n"
    )
    lines += "    return co.prepare(what, method, h, **passed).run(x, span, **given)\n"
    lines += prepared_lines(options, given)
    case = Case(
        method,
        system,
        tuple(options.items()),
        f"{IMPORTS}{lines}sol = co.integrate(system, x0, span, h, method, **options)\n",
    )
    try:
        space = execute(case.lines)
        if options["events"] == "terminal":
            execute("run(events=None)\n", space)  # checks compare with it: the motion must not end after the event
        return case, space
    except REFUSALS as refusal:
        raise Refused(case) from refusal


def field_at(system: Any, x: np.ndarray, t: float) -> np.ndarray:
    return np.asarray(system.vector_field(x, t) if not matrices(system) else system.vector_field(x))


def prepared_lines(options: Options, given: dict[str, str]) -> str:
    """Return the line that prepares a run, with the inputs of the case."""
    inputs = {"none": "", "linear": ", inputs=True", "torque": ", inputs={'pushed': 'Torque'}"}[options["inputs"]]
    passed = "".join(f", {name}={given[name]}" for name in ("watch", "observe", "threads", "attitude") if name in given)
    return f"ready = co.prepare(system, method, h{passed}{inputs})\n"


def accepted(method: str, system: str, options: Options, seed: int) -> tuple[Case, dict[str, Any], list[Refused]]:
    """Return the case with as many of the options as the library accepts, its names, and what was refused.

    A motion that leaves the domain of the system or of the scheme is drawn again, more slowly at last.
    """
    refusals: list[Refused] = []
    plain = value_of(system)
    if options["attitude"] == "turned" and getattr(plain, "representation", None) is None:
        options = options | {"attitude": "own"}
    forces = forces_of(plain, options, np.random.default_rng(seed))
    try:
        attitude, without_forces = declared(method, system, forces).attitude, False
    except REFUSALS:  # of order above two, with a force that acts forward only, or in flows of order one
        attitude, without_forces = declared(method, system, []).attitude, True
    for name in excluded(options, plain, attitude, without_forces):
        try:
            return *case_of(method, system, options, seed), refusals
        except Refused as refused:
            refusals.append(refused)
            options = options | {name: NEUTRAL[name]}
        except co.IntegrationError:
            break
    changed = [name for name in options if options[name] != NEUTRAL[name] and name not in BESIDE]
    order = sorted(changed, key=lambda name: name not in ("attitude", "inputs"))
    for count in range(len(order) + 1):
        for dropped in itertools.combinations(order, count):
            for again in range(6):
                try:
                    kept = options | {name: NEUTRAL[name] for name in dropped}
                    return *case_of(method, system, kept, seed + again, 4.0 if again > 2 else 1.0), refusals
                except Refused as refused:
                    refusals.append(refused)
                    break
                except co.IntegrationError:
                    if again == 5:
                        raise
    raise refusals[-1]


@cache
def option_sets(seed: int) -> list[Options]:
    """Return options in which every two values occur together."""
    return covering(np.random.default_rng(seed))


def drawn(
    method: str, seed: int, each: int, catalogue: int = 1, workers: float = 0.0
) -> Iterator[tuple[str, str, Options, int]]:
    """Yield a scheme with some registered systems that it supports, in turn, and drawn ones, with options.

    Worker processes take seconds to start: only this part of the cases with blocks on workers has them.
    """
    place = schemes().index(method)
    rng = np.random.default_rng([seed, place])
    each, catalogue = (1, 0) if method in SLOW else (each, catalogue)
    order = np.random.default_rng(seed).permutation(len(systems()))
    turned = [systems()[order[(each * place + k) % len(order)]] for k in range(len(order))]
    names = [*itertools.islice((name for name in turned if supported(method, name)), each)]
    new = [drawn_system(rng, timed=rng.random() < 0.3) for _ in range(catalogue)]
    options = option_sets(seed)
    for k, system in enumerate([*names, *(name for name in new if supported(method, name))]):
        chosen = options[((each + catalogue) * place + k) % len(options)]
        chosen = chosen | (HERE if rng.random() >= workers and chosen["blocks"] == "workers" else {})
        yield method, system, chosen, int(rng.integers(2**31))


def drawn_on(system: str, seed: int, each: int) -> Iterator[tuple[str, str, Options, int]]:
    """Yield a registered system with some schemes that support it, and options."""
    place = systems().index(system)
    rng = np.random.default_rng([seed, place, 1])
    names = (name for name in map(str, rng.permutation(schemes())) if name not in SLOW and supported(name, system))
    options = option_sets(seed)
    for k, method in enumerate(itertools.islice(names, each)):
        chosen = options[-1 - (each * place + k) % len(options)]
        chosen = chosen | (HERE if chosen["blocks"] == "workers" else {})
        yield method, system, chosen, int(rng.integers(2**31))
