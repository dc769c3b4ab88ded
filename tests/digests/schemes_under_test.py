"""All schemes with all options that change their steps, and the systems that they support."""

from __future__ import annotations

from functools import cache

import coadjoint as co

from .systems_under_test import Case, all_cases, cases

C1 = 1 / (2 - 2 ** (1 / 3))
TRIPLE_JUMP = (C1, 1 - 2 * C1, C1)
EXAMPLES = [method for name in co.methods.names() for method in co.methods.registry.scheme(name).examples()]
"""Every registered scheme with the options of its examples."""
COMPOSED = [co.Composition(method, (0.75, -0.5, 0.75)) for method in EXAMPLES if method.symmetric]


@cache
def schemes() -> dict[str, co.methods.Method]:
    """Return the schemes by name, without those of variable steps."""
    found = {
        "Splitting 1": co.Splitting(order=1),
        "Splitting 1 adjoint": co.Splitting(order=1, adjoint=True),
        "Splitting 2": co.Splitting(order=2),
        "Splitting 2 coordinates": co.Splitting(order=2, parts="coordinates"),
        "Splitting 2 compensated": co.Splitting(order=2, compensated=True),
        "Splitting 2 free body": co.Splitting(order=2, parts="free_body"),
        "Splitting 4": co.Splitting(order=4),
        "Splitting 4 free body": co.Splitting(order=4, parts="free_body"),
        "Splitting yoshida4": co.Splitting(scheme="yoshida4"),
        "Splitting suzuki4": co.Splitting(scheme="suzuki4"),
        "Composition of Splitting": co.Composition(co.Splitting(order=2), TRIPLE_JUMP),
        "Composition of GaussLegendre": co.Composition(co.GaussLegendre(1), TRIPLE_JUMP),
    }
    found |= {f"GaussLegendre {s}": co.GaussLegendre(s) for s in (1, 2, 3, 4)}
    found |= {
        f"Modified {s} {freeze}": co.ModifiedGaussLegendre(s, freeze=freeze)
        for s in (1, 2, 3)
        for freeze in ("structure", "gradient")
    }
    found |= {f"Iterated {s}": co.IteratedGaussLegendre(s) for s in (1, 2, 3)}
    found |= {name: co.ExplicitRungeKutta(name) for name in ("runge2", "rk4")}
    found |= {f"RadauEnergy {s}": co.RadauEnergy(s) for s in (1, 2, 3)}
    found |= {f"Taylor {p}": co.Taylor(p) for p in (1, 2, 3, 5, 6)}
    found |= {f"Taylor {p} alone": co.Taylor(p, projected=False) for p in (2, 5)}
    for name in co.methods.names():
        scheme = co.methods.registry.scheme(name)
        if not any(type(method) is scheme for method in found.values()):
            found |= {str(method): method for method in scheme.examples() if not method.own_steps}
    return found


def serves(method: co.methods.Method, system: object) -> bool:
    """Return whether the scheme supports the system; a refusal must be one sentence."""
    try:
        method.properties(system)
    except ValueError as refusal:
        assert len(str(refusal)) > 20 and str(refusal).count("\n") == 0
        return False
    return True


def witnesses(method: co.methods.Method, *names: str) -> list[Case]:
    """Return the named systems that a scheme supports, or another one."""
    named = [cases()[name] for name in names]
    others = [case for case in all_cases().values() if serves(method, case.system)]
    return [case for case in named if serves(method, case.system)] or others[:1]
