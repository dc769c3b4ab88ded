"""Matrices of Gauss steps against the steps themselves."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.experiments.step_matrices import stage_iterates, step_matrix

X = np.array([1.0, 2.0, 0.5])
H = 0.1


@pytest.mark.parametrize("stages", [1, 2, 3])
@pytest.mark.parametrize("freeze", ["structure", "gradient"])
def test_matrix_makes_the_modified_step(stages: int, freeze: str) -> None:
    body = co.systems.paper_rigid_body()
    m = 2 * stages
    frozen = stage_iterates(body, stages, H, X, m - 1)[-1]
    B = step_matrix(body, frozen, H, freeze)
    step = co.stepper(body, co.ModifiedGaussLegendre(stages, m, freeze=freeze), H)(X)
    # 3 s unknowns by elimination.
    assert np.linalg.norm(B @ X - step) <= 64 * 2.0**-53 * 3 * stages * np.linalg.norm(X)


def test_settled_stages_make_the_gauss_step() -> None:
    body = co.systems.paper_rigid_body()
    frozen = stage_iterates(body, 2, H, X, 50)[-1]
    step = co.stepper(body, co.GaussLegendre(2), H)(X)
    for freeze in ("structure", "gradient"):
        assert np.linalg.norm(step_matrix(body, frozen, H, freeze) @ X - step) <= 64 * 2.0**-53 * 6 * np.linalg.norm(X)
