"""Schemes as text: examples of the registry, wrapped schemes, and those of users."""

from __future__ import annotations

import re
from functools import cache

import coadjoint as co
from digests.schemes_under_test import EXAMPLES

OTHERS = (
    "co.Splitting(order=2, parts='free_body')",
    "co.Splitting(order=2, rotation='rational')",
    "co.Splitting(order=4, compensated=True)",
    "co.Splitting(order=6)",
    "co.Splitting(scheme='blanes_casas_murua6')",
    "co.GaussLegendre(1)",
    "co.GaussLegendre(3)",
    "co.ModifiedGaussLegendre(2, freeze='gradient')",
    "co.IteratedGaussLegendre(1)",
    "co.IteratedGaussLegendre(3)",
    "co.ExplicitRungeKutta('runge2')",
    "co.RadauEnergy(1)",
    "co.RadauEnergy(3)",
    "co.Taylor(12)",
    "co.Taylor(tolerance=1e-09)",
    "co.Composition(co.Splitting(order=2, compensated=True), (0.25, 0.5, 0.25))",
    "co.Composition(co.SphericalMidpoint(), (0.3, 0.4, 0.3))",
    "co.Projected(co.GaussLegendre(2))",
    "co.ReversibleSteps(co.Splitting(order=4), 0.2)",
    "co.methods.even_order(co.Splitting(order=2), 4)",
    "co.methods.even_order(co.GaussLegendre(1), 4, 'suzuki')",
    "co.methods.even_order(co.LineSplitting(order=2), 4)",
    "user.Heun()",
    "user.RungeKutta()",
    "user.Kutta()",
    "user.Flows()",
    "user.Compiled()",
    "co.Composition(user.Flows(), (0.25, 0.5, 0.25))",
)
SLOW = ("user.RungeKutta()",)
"""Schemes that are compiled again for each system."""
DEFAULTS = (
    r", (?:parts='auto'|compensated=None|rotation='exact'|adjoint=False|scheme=None|tolerance=None|iterations=None"
    r"|speed=None)(?=[,)])"
)


def text_of(method: co.methods.Method) -> str:
    """Return a scheme as an expression; of named coefficients the order is not given."""

    def qualified(found: re.Match[str]) -> str:
        return f"co.{found[1]}(" if found[1] in dir(co) else f'co.methods.registry.scheme("{found[1]}")('

    shown = re.sub(DEFAULTS, "", repr(method))
    shown = re.sub(r"order=\d+, (scheme=)", r"\1", shown)
    return re.sub(r"\b([A-Z]\w*)\(", qualified, shown)


@cache
def schemes() -> tuple[str, ...]:
    """Return every example of every registered scheme, and the others."""
    return (*map(text_of, EXAMPLES), *OTHERS)
