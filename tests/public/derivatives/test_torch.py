"""Runs as functions of PyTorch: values, derivatives and refused arguments; `make torch` installs it."""

import re
from pathlib import Path

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

torch = pytest.importorskip("torch")

PAGE = Path(__file__).parents[3] / "docs" / "derivatives.md"
SPAN, EVERY = (0, 10), 50
X0 = np.array([1.0, 0.2, 0.5])
MANY = np.array([X0, 2.0 * X0, X0[::-1]])
INERTIA = np.array([1.1, 2.0, 2.4])
WEIGHTS = np.cos(np.arange(15.0)).reshape(5, 3)


def prepared(inertia=(1.0, 2.0, 2.5), **options):
    return co.prepare(co.systems.rigid_body(inertia=inertia), co.Splitting(order=4), 0.05, **options)


@pytest.fixture
def g():
    return co.torch.solution(prepared(), SPAN, EVERY)


def variable(values):
    return torch.tensor(values, dtype=torch.float64, requires_grad=True)


def test_values_have_the_bits_of_the_run(g):
    assert np.array_equal(g(X0), prepared().run(X0, SPAN, EVERY).x)
    other = prepared(INERTIA).run(MANY, SPAN, EVERY).x
    assert np.array_equal(g(torch.tensor(MANY), inertia=torch.tensor(INERTIA)), other)
    assert np.array_equal(g((1, 0, 1)), g(torch.tensor([1, 0, 1])))  # whole numbers
    x = g(X0)
    x.zero_()
    assert np.array_equal(g(X0), prepared().run(X0, SPAN, EVERY).x)


def test_gradient_is_that_of_the_pullback(g):
    wanted = prepared(INERTIA).vjp(X0, SPAN, EVERY)[1](WEIGHTS)
    x0, inertia = variable(X0), variable(INERTIA)
    (torch.tensor(WEIGHTS) * g(x0, inertia=inertia)).sum().backward()
    assert np.array_equal(x0.grad, wanted["x0"]) and np.array_equal(inertia.grad, wanted["inertia"])
    of_inertia = torch.func.grad(lambda inertia: (torch.tensor(WEIGHTS) * g(X0, inertia=inertia)).sum())
    assert np.array_equal(of_inertia(inertia.detach()), wanted["inertia"])


def test_jvp_is_that_of_the_prepared_run(g):
    wanted = prepared(INERTIA).jvp(X0, SPAN, {"inertia": X0}, EVERY)[1].x
    values, along = torch.tensor(INERTIA), torch.tensor(X0)
    assert np.array_equal(torch.func.jvp(lambda inertia: g(X0, inertia=inertia), (values,), (along,))[1], wanted)


@pytest.mark.parametrize("x0", [X0, MANY], ids=["one", "ensemble"])
def test_derivatives_agree_with_differences(x0):
    g = co.torch.solution(prepared(attitude=True), (0, 1), 20)
    arguments = variable(x0), variable(INERTIA)
    assert torch.autograd.gradcheck(lambda x0, inertia: g(x0, inertia=inertia), arguments, check_forward_ad=True)


def test_attitude_is_returned_and_differentiated():
    ready = prepared(attitude=True)
    g = co.torch.solution(ready, SPAN, EVERY)
    turned = co.integrate(co.systems.rigid_body(inertia=INERTIA), X0, (0, 1), 0.1, attitude=True).attitude[-1]
    sol, pullback = ready.vjp(X0, SPAN, EVERY, attitude=turned)
    A0 = variable(turned)
    x, A = g(X0, attitude0=A0)
    assert np.array_equal(x.detach(), sol.x) and np.array_equal(A.detach(), sol.attitude)
    A[-1, 0, 1].backward()
    weights = np.zeros(sol.attitude.shape)
    weights[-1, 0, 1] = 1.0
    assert np.array_equal(A0.grad, pullback(attitude=weights)["attitude0"])
    # Members share an attitude of shape (d, d).
    A0.grad = None
    g(MANY, attitude0=A0)[1][-1, :, 0, 1].sum().backward()
    assert A0.grad.shape == (3, 3)


@pytest.mark.parametrize(
    ("x0", "values", "error", "named"),
    [
        (X0.astype(np.float32), {}, TypeError, ("x0", "float32", "float64")),
        ("a", {}, TypeError, ("x0", "'a'")),
        (X0[:2], {}, ValueError, ("x0", "(2,)", "(3,)")),
        (X0, {"inertai": INERTIA}, ValueError, ("inertai", "inertia")),
        (X0, {"inertia": -INERTIA}, ValueError, ("inertia",)),
    ],
)
def test_wrong_arguments_are_refused(g, x0, values, error, named):
    with refused(error, *named):
        g(x0, **values)


def test_parameters_by_position_are_refused(g):
    with refused(TypeError, "co.torch.solution", "2 arguments", "x0 alone", "inertia="):
        g(X0, INERTIA)


def test_second_derivatives_are_refused(g):
    x0 = variable(X0)
    (gradient,) = torch.autograd.grad(g(x0)[-1, 0], x0, create_graph=True)
    with refused(NotImplementedError, "first derivatives"):
        gradient.sum().backward()


def test_example_of_the_page_runs():
    (example,) = re.findall(r"```python\n(import torch\n.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    exec(example, {"co": co})
