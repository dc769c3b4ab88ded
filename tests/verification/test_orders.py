"""Every scheme has the order that it declares, on every kind of system: slopes against an independent reference."""

import pytest

from .measures import measured_order
from .schemes_under_test import concrete_schemes, pairs, schemes, schemes_in_steps
from .systems_under_test import all_cases

pytestmark = pytest.mark.thinned(6)

DECLARED = {
    "Splitting 1": 1,
    "Splitting 1 adjoint": 1,
    "Splitting 2": 2,
    "Splitting 2 coordinates": 2,
    "Splitting 2 compensated": 2,
    "Splitting 4": 4,
    "Splitting yoshida4": 4,
    "Splitting suzuki4": 4,
    "Composition of Splitting": 4,
    "Composition of GaussLegendre": 4,
    "runge2": 2,
    "rk4": 4,
    **{f"GaussLegendre {s}": 2 * s for s in (1, 2, 3, 4)},
    **{f"Modified {s} {freeze}": 2 * s for s in (1, 2, 3) for freeze in ("structure", "gradient")},
    **{f"Iterated {s}": 2 * s for s in (1, 2, 3)},
    **{f"RadauEnergy {s}": 2 * s - 1 for s in (1, 2, 3)},
    **{f"Taylor {p}": p for p in (1, 2, 3, 5, 6)},
    **{f"Taylor {p} alone": p for p in (2, 5)},
}


def test_every_scheme_of_the_library_is_measured():
    # Of steps of its own a scheme's own tests measure the order.
    expected = concrete_schemes() - {"ReversibleSteps"} | schemes_in_steps()
    assert {type(method).__name__ for method in schemes().values()} >= expected


@pytest.mark.parametrize("name", DECLARED)
def test_declared_order_is_the_one_of_the_literature(name):
    assert schemes()[name].order == DECLARED[name]


# A free body alone has no error, and no order.
EXACT = {(f"Splitting {order} free body", case) for order in (2, 4) for case in all_cases() if case.startswith("so(3)")}


@pytest.mark.thinned(26)
@pytest.mark.parametrize(("scheme", "case"), [pair for pair in pairs(all_cases()) if pair not in EXACT])
def test_order(scheme, case):
    found = measured_order(schemes()[scheme], case)
    # A scheme that is new is held to what it declares itself.
    assert found.agrees_with(DECLARED.get(scheme, schemes()[scheme].order)), found
