"""Domains of the parameters of schemes and events, as documented."""

from __future__ import annotations

import math

import numpy as np

import coadjoint as co
from domains.kinds import Case, Domain, choice, flag, instance, one_of, optional, positive, real, title, vector, whole
from domains.of_parts import BODY, SQUARE, of_nothing, value

BASE = instance(co.Splitting(), co.GaussLegendre(1))
ORDERS = one_of(2, 4, 6, 8, 10).but_called(r"\borders?\b")
STAGES = whole(1, usual=2)
SCHEMES = {
    "CommutatorFree": Case(co.CommutatorFree, {"order": one_of(2, 3, 4)}),
    "Composition": Case(co.Composition, {
        "base": BASE.plus(outside=(co.Splitting(order=1), co.ExplicitRungeKutta(), co.Splitting)),
        "coefficients": vector((0.25, 0.5, 0.25), real(), (1.0,), any_length=True).plus(outside=((0.5, 0.25), (1.0,
            1.0))),
    }),
    "ExplicitRungeKutta": Case(co.ExplicitRungeKutta, {
        "name": choice("runge2", "rk4").but_called("\\bname\\b|Runge-Kutta method"),
    }),
    "GaussLegendre": Case(co.GaussLegendre, {"stages": STAGES}),
    "IsospectralGauss": Case(co.IsospectralGauss, {"stages": whole(1, 8)}),
    "IteratedGaussLegendre": Case(co.IteratedGaussLegendre, {"stages": STAGES, "iterations": optional(whole(1))}),
    "Kahan": Case(co.Kahan, {}),
    "LineSplitting": Case(co.LineSplitting, {"order": ORDERS}),
    "ModifiedGaussLegendre": Case(co.ModifiedGaussLegendre, {
        "stages": STAGES,
        "iterations": optional(whole(1)),
        "freeze": choice("structure", "gradient"),
    }),
    "Projected": Case(co.Projected, {"base": BASE.plus(co.ExplicitRungeKutta(), outside=(co.Splitting,))}),
    "RadauEnergy": Case(co.RadauEnergy, {"stages": STAGES}),
    "ReversibleSteps": Case(co.ReversibleSteps, {
        "base": BASE.plus(outside=(co.Splitting(order=1), co.ExplicitRungeKutta(), co.Splitting)),
        "stride": positive(),
        "speed": Domain((None, co.Quadratic(1.0), SQUARE, [[1.0, [2, 0, 0]]]), (1.0, True, "", "fast", 1j, math.nan,
            value, [[1.0, [-1, 0, 0]]], [[math.nan, [2, 0, 0]]], [[1.0]], [1.0], {})),
    }),
    "SphericalMidpoint": Case(co.SphericalMidpoint, {}),
    "Splitting": Case(co.Splitting, {
        "order": one_of(2, 1, 4, 6, 8, 10).but_called("\\borders?\\b"),
        "parts": Domain(("auto", "coordinates", "free_body", "bonds", ((0,), (1,), (2,)), [[0, 1], [2]]), ("",
            "autox", "Auto", None, 1.0, True, 1j, [[-1], [0]], [[0, 0]], [[0.5]], [["a"]], [[True]], [0, 1], {})),
        "compensated": optional(flag()),
        "rotation": choice("exact", "rational"),
        "scheme": optional(choice("strang", "yoshida4", "suzuki4")),
        "adjoint": flag().first(False),
    }, usual={"scheme": None}),
    "Splitting.tuned": Case(co.Splitting.tuned, {
        "system": instance(BODY).plus(outside=(co.batch([BODY]), co.systems.toda_ring(3).with_forces)),
        "x0": vector((0.5, 1.0, -0.25), real()).first((0.5, 1.0, -0.25), np.ones((2, 3))),
        "order": one_of(1, 2, 4, 6, 8, 10).first(2, 1).but_called("\\borders?\\b"),
    }),
    "Taylor": Case(co.Taylor, {
        "order": optional(whole(1, 64)),
        "projected": flag(),
        "tolerance": optional(positive(1e-06, least=1e-18, most=0.1)),
    }),
    "Forced": Case(co.methods.Forced, {"base": BASE.plus(outside=(co.Splitting,))}),
    "even_order": Case(co.methods.even_order, {
        "base": instance(co.Splitting(order=1), co.Splitting()).plus(outside=(co.Splitting,)),
        "order": one_of(2, 4, 6, 8, 10, 12),
        "jump": choice("triple", "suzuki"),
    }),
    "Properties": Case(co.methods.Properties, {
        "poisson": flag(),
        "energy": flag(),
        "casimirs": choice("all", "polynomial", "quadratic", "none").but_called("Casimirs"),
        "attitude": choice("every representation", "coadjoint", "group", "integrated", "none"),
        "broken_by": Domain(((), ("energy: LinearDamping",)), (None, "energy", 1.0, True, (1.0,), 1j)),
        "reversible": flag(),
    }),
}  # fmt: skip

EVENTS = {
    "Event": Case(co.Event, {
        "g": Domain((0, 2, "m1", SQUARE, co.Quadratic(1.0), value, np.int64(1)), (-1, 0.5, True, None, 1j, math.nan,
            [], {}, (0, 1), of_nothing), "\\bg\\b|coordinate of an event"),
        "direction": one_of(0, 1, -1),
        "count": optional(whole(1)),
        "terminal": flag(),
        "name": optional(title("turn")),
    }),
}  # fmt: skip
