"""A flow that goes far is a series in many substeps: as many as are of use, and no more where it has overflowed."""

import numpy as np
import pytest
import scipy.linalg

import coadjoint as co
from coadjoint.program.blocks import MOST_SUBSTEPS, Kind
from coadjoint.program.interpreter import Interpreter
from coadjoint.program.table import build_program

TURNS = scipy.linalg.block_diag([[0, 1], [-1, 0]], [[0, 2], [-2, 0]])
GROWS = scipy.linalg.block_diag([[0, 1], [1, 0]], [[0, 2], [-2, 0]])
BASIS = np.eye(4, dtype=int) + np.eye(4, k=1, dtype=int) + np.eye(4, k=3, dtype=int)
X0 = np.array([0.5, 1.0, -0.3, 0.2, 0.7])


def moved_by(matrix):
    """H = x1 where e1 acts by a matrix on four commuting elements, in a basis in which no block is simpler."""
    D = np.rint(np.linalg.inv(BASIS) @ matrix @ BASIS).astype(int)
    rows = [(0, 1 + i, 1 + j, float(D[i, j])) for i in range(4) for j in range(4) if D[i, j]]
    algebra = co.LieAlgebra(rows, dim=5, name="acted on")
    return co.LiePoissonSystem(algebra, co.Quadratic(0.0, linear=[1.0, 0.0, 0.0, 0.0, 0.0]))


def norm_of(system):
    """The time in which the series goes one substep far is its inverse."""
    action = build_program(system, co.Splitting(order=1)).state
    assert action.kind.tolist() == [int(Kind.SERIES)]
    return float(action.constants[action.constant[0]])


@pytest.mark.thinned(4)
@pytest.mark.parametrize("members", [1, 7])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_up_to_the_limit_a_flow_is_exact_and_beyond_it_is_refused(members, direction):
    system = moved_by(TURNS)
    limit = MOST_SUBSTEPS / norm_of(system)
    x0 = X0 * (1.0 + 0.1 * np.arange(members)[:, None])
    read = Interpreter(build_program(system, co.Splitting(order=1)))

    near = limit * (1.0 - 2.0**-30)
    found = co.integrate(system, x0, (0.0, direction * near), near, co.Splitting(order=1)).x[-1]
    generator = np.array([system.structure_matrix(e) @ [1.0, 0, 0, 0, 0] for e in np.eye(5)]).T
    # A multiple of the period is left out: 20 roundings in each substep are what the series loses.
    exact = x0 @ scipy.linalg.expm(np.fmod(direction * near, 2.0 * np.pi) * generator).T
    scale = np.linalg.norm(BASIS, 1) * np.linalg.norm(np.linalg.inv(BASIS), 1)
    tolerance = 20 * MOST_SUBSTEPS * 2.0**-53 * scale**2 * np.abs(x0).max()
    assert np.abs(found - exact).max() < tolerance
    assert np.abs(read.steps(x0[0], direction * near, 1) - exact[0]).max() < tolerance

    far = limit * (1.0 + 2.0**-30)
    with pytest.raises(co.IntegrationError, match="overflowed"):
        co.integrate(system, x0, (0.0, direction * far), far, co.Splitting(order=1))
    with pytest.raises(ValueError, match="at most 4096 are allowed; take a smaller step"):
        read.steps(x0[0], direction * far, 1)


def test_members_that_overflow_on_the_way_leave_the_others_their_bits():
    system = moved_by(GROWS)
    step = 0.9 * MOST_SUBSTEPS / norm_of(system)
    alone = co.integrate(system, X0, (0.0, step), step, co.Splitting(order=1))
    wild = 1e250 * X0  # grows by exp(step), which is about 1e114
    states = np.array([wild, X0, -wild, X0])
    with pytest.raises(co.IntegrationError, match="overflowed for 2 of 4 members") as raised:
        co.integrate(system, states, (0.0, step), step, co.Splitting(order=1))
    assert raised.value.partial.failed.tolist() == [True, False, True, False]
    assert np.array_equal(raised.value.partial.x[:, 1], alone.x)
    assert np.array_equal(raised.value.partial.x[:, 3], alone.x)
