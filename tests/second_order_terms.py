"""The h^2 term of the modified Hamiltonian of a splitting, by nested pairs of parts."""

import numpy as np


def second_order_term(algebra, derivatives, points, order=None):
    """Return H2 of ``X1(h/2) ... Xn(h) ... X1(h/2)`` for parts in an order, at points (k, n).

    For a pair, A outside and D inside, H2 = -{A, {A, D}}/24 + {D, {D, A}}/12.
    """
    gradients, hessians = derivatives
    hessians = np.broadcast_to(hessians, (*gradients.shape, points.shape[1]))
    J = np.stack([algebra.structure_matrix(x) for x in points])
    *outer, last = range(len(gradients)) if order is None else order
    inside, inside_hessian, total = gradients[last], hessians[last], np.zeros(len(points))
    for p in reversed(outer):
        a, a_hessian = gradients[p], hessians[p]
        moved = np.einsum("kij,kjl,kl->ki", a_hessian, J, inside) - np.einsum("kij,kjl,kl->ki", inside_hessian, J, a)
        moved += np.stack([algebra.bracket(u, v) for u, v in zip(a, inside, strict=True)])
        total -= np.einsum("ki,kij,kj->k", a / 24 + inside / 12, J, moved)
        inside, inside_hessian = inside + a, inside_hessian + a_hessian
    return total
