"""The named splitting schemes, with coefficients from splitting_schemes.json, exactly as published and refined."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from importlib.resources import files
from typing import Any, NamedTuple

from coadjoint.program.sweeps import Sweep


class SplittingScheme(NamedTuple):
    """A symmetric composition, processed or not; coefficients have 50 digits (40 for a processed scheme)."""

    order: int
    half: tuple[str, ...]
    """The first half of the palindrome of fractions of the step, with the middle one if `of_second_order`."""
    of_second_order: bool
    """Whether it composes the symmetric step of order 2; otherwise the forward sweep and its adjoint, alternating."""
    processor_half: tuple[str, ...]
    """Fractions of the processor P: second-order steps at these and then at their negatives, the first applied last."""
    source: str

    @property
    def processed(self) -> bool:
        """Whether a step is P K P^-1, with output only after the processor P."""
        return bool(self.processor_half)

    def sweeps(self, number: Callable[[Any], Any]) -> list[Sweep]:
        """Return the sweeps of one step (of the kernel K of a processed scheme), first to last."""
        half = [number(c) for c in self.half]
        if self.of_second_order:
            return sweeps_of_steps([*half, *half[-2::-1]], number)
        return _alternating([*half, *half[::-1]], number)

    def processor(self, number: Callable[[Any], Any]) -> list[Sweep]:
        """Return the sweeps of the processor P, first to last; empty without a processor."""
        half = [number(c) for c in self.processor_half]
        return sweeps_of_steps([-c for c in half[::-1]] + half[::-1], number)


def sweeps_of_steps(coefficients: Sequence[Any], number: Callable[[Any], Any]) -> list[Sweep]:
    """Return the sweeps of a composition of second-order steps: each is half a step forward and half its adjoint."""
    sweeps = _alternating([c / 2 for c in coefficients for _ in range(2)], number)
    return [sweep._replace(turn=not sweep.forward) for sweep in sweeps]


def _alternating(coefficients: Sequence[Any], number: Callable[[Any], Any]) -> list[Sweep]:
    """Return forward and backward sweeps in turn: a first-order step and its adjoint.

    The step advances time before the parts, its adjoint after them, so that both are evaluated at the same time.
    """
    sweeps, elapsed = [], number(0)
    for k, coefficient in enumerate(coefficients):
        forward = k % 2 == 0
        sweeps.append(Sweep(forward, coefficient, elapsed + coefficient if forward else elapsed))
        elapsed = elapsed + coefficient
    return sweeps


def _load_schemes() -> dict[str, SplittingScheme]:
    text = files("coadjoint.methods.numerics").joinpath("splitting_schemes.json").read_text(encoding="utf-8")
    return {
        name: SplittingScheme(
            order=entry["order"],
            half=tuple(entry["half"]),
            of_second_order=entry["base"] == "second order",
            processor_half=tuple(entry.get("processor_half", ())),
            source=entry["source"],
        )
        for name, entry in json.loads(text)["schemes"].items()
    }


SCHEMES = _load_schemes()

# Smallest error at equal cost on a rigid body, among schemes without a processor. This depends on the state: on other
# orbits blanes_moan4 halves the error of order 4.
DEFAULT_SCHEMES = {
    2: "strang",
    4: "suzuki4",
    6: "sofroniou_spaletta6",
    8: "sofroniou_spaletta8",
    10: "sofroniou_spaletta10",
}
