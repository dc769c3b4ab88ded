"""Formulas of docstrings as LaTeX on the site."""

import inspect
import re

import pytest
from formulas import in_markdown, in_restructured_text, latex

import coadjoint as co

SET = {
    "x' = sign * J(x) grad H(x)": r"x' = \mathtt{sign} J(x) \nabla H(x)",
    "Omega = I^-1 x": r"\Omega = I^{-1} x",
    "m' = m cross Omega + gamma cross lever": r"m' = m \times \Omega + \gamma \times \mathtt{lever}",
    "x_new = x + h sum_i b_i f(X_i)": r"x_{\mathrm{new}} = x + h \sum_{i} b_{i} f(X_{i})",
    "rho_(n+1) = rho_n + stride Q'/Q": r"\rho_{n+1} = \rho_{n} + \mathtt{stride} \,Q'/Q",
    "a_i = sqrt(A beta / m) / 2": r"a_{i} = \sqrt{A \beta / m} / 2",
    "<A, B> = Re tr(A* B)": r"\langle A, B\rangle = \operatorname{Re} \operatorname{tr}(A^* B)",
    "x02/2 + w_a x20_b": r"x_{02}/2 + w_{a} x_{20,b}",
    "sum over i and t of w(t) S_a,i(t)": r"\sum_{i,t} w(t) S_{a,i}(t)",
    "a_i <= b_i": r"a_{i} \le b_{i}",
    "I1 = I2 = 4 I3": r"I_{1} = I_{2} = 4 I_{3}",
    "P~ - 1/|x|^2": r"\tilde{P} - 1/|x|^{2}",
    "sign * (D_(grad H) + J(x) H'')": r"\mathtt{sign} (D_{\nabla H} + J(x) H'')",
}
CODE = (
    "exact(x0, t)", "sol.x", "stages=1", "x0", "grad", "run_failed", "casimir_<name>", "(H_i, dH_i)", "dim - rank",
    "constants[i, j, k]", "y = x[coordinates]", '"|x|^2"', "A = g[:3, :3]", "casimirs(max_degree)",
    "integrate(..., t_eval=times)", "sqrt", "^",
)  # fmt: skip


@pytest.mark.parametrize("text", SET)
def test_formulas(text):
    assert " ".join(latex(text)).replace(" {} ", " ") == SET[text]


@pytest.mark.parametrize("text", CODE)
def test_code_is_left(text):
    assert latex(text) is None


def test_long_formulas_may_break_between_terms():
    pieces = latex("H = L . I^-1 L / 2 + |p|^2 / (2 mass) + V(r)")
    assert pieces == [r"H = L \cdot I^{-1} L / 2", r"{} + |p|^{2} / (2 \,\mathtt{mass}) + V(r)"]


def test_text_of_docstrings():
    lines = ["Of a group, X^T S + S X = 0 with mu_ij = a_ij /", "b_j, for t_end and `x_0`; x' = ``sol.x``."]
    assert in_restructured_text(lines) == [
        "Of a group, :math:`X^{T} S + S X = 0` with "
        r":math:`\mu_{ij} = a_{ij} / b_{j}`, for t_end and `x_0`; x' = ``sol.x``."
    ]
    assert in_markdown("The sum ``x^2`` of ``sol.x``") == "The sum $x^{2}$ of `sol.x`"


def test_examples_are_left():
    lines = ["The square, x^2.", "", "Examples", "--------", ">>> 2 ** 2  # x^2"]
    assert in_restructured_text(lines)[1:] == lines[1:]


def test_braces_of_all_public_docstrings_are_balanced():
    values = [
        getattr(space, name)
        for space in (co, co.methods, co.systems, co.forces, co.analysis, co.algebras)
        for name in dir(space)
    ]
    texts = {inspect.getdoc(value) or "" for value in values if callable(value)}
    pages = ["\n".join(in_restructured_text(text.split("\n"))) for text in texts]
    found = [piece for page in pages for piece in re.findall(":math:`([^`]*)`", page)]
    assert len(found) > 200
    for piece in found:
        bare = piece.replace("\\{", "").replace("\\}", "")
        assert bare.count("{") == bare.count("}"), piece
