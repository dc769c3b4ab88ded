"""Steps that an estimate of the error would choose are refused by name, with what to take instead."""

import copy
import pickle

import pytest

import coadjoint as co

BODY, X0 = co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.5)


@pytest.mark.parametrize("name", ("tolerance", "rtol", "atol"))
@pytest.mark.parametrize("scheme", (co.Splitting, co.GaussLegendre, co.ExplicitRungeKutta))
def test_a_scheme_without_a_tolerance_says_what_to_take(scheme, name):
    with pytest.raises(TypeError, match=f"{scheme.__name__} has no {name}: .* accuracy=.*Taylor.*ReversibleSteps"):
        scheme(**{name: 1e-6})


@pytest.mark.parametrize("name", ("rtol", "atol"))
def test_a_run_without_a_tolerance_says_what_to_take(name):
    with pytest.raises(TypeError, match=f"integrate has no {name}: .* accuracy="):
        co.integrate(BODY, X0, (0, 1), 0.1, **{name: 1e-6})


def test_other_parameters_are_refused_as_ever_and_copies_are_made():
    with pytest.raises(TypeError, match="Splitting has no tol; it takes order, "):
        co.Splitting(tol=1e-6)
    for method in (co.Splitting(order=4), co.Composition(co.Splitting(), (0.5, 0.5))):
        assert pickle.loads(pickle.dumps(method)) == copy.deepcopy(method) == method
