"""Spins on graphs: the bonds of a lattice, and equations and energy summed bond by bond."""

import numpy as np

import coadjoint as co


def bonds(lattice, shape, periodic=False):
    """Return the pairs of sites in the order of the numbers of an exchange, each directed as a DM vector sees it."""

    def between(row, column, **couplings):
        system = co.systems.spin_lattice(lattice, shape, periodic, **couplings)
        return system.hamiltonian.hessian(np.zeros(system.dim))[row::3, column::3]

    first, second = np.nonzero(np.triu(between(0, 0)))
    numbers = -between(0, 0, exchange=np.arange(1.0, len(first) + 1))[first, second]
    forward = between(0, 1, exchange=0.0, dm=(0.0, 0.0, 1.0))[first, second] > 0
    pairs = np.where(forward[:, None], np.stack([first, second], axis=1), np.stack([second, first], axis=1))
    return pairs[np.argsort(numbers)]


def by_hand(x, edges, J, T, D, K, B):
    """S_i' = S_i x B_i, the field of each spin summed edge by edge; couplings are given for each edge and each site."""
    S = x.reshape(-1, 3)
    seen = B + np.einsum("iab,ib->ia", 2 * K, S)
    for e, (i, j) in enumerate(edges):
        seen[i] += J[e] * T[e] @ S[j] - np.cross(S[j], D[e])
        seen[j] += J[e] * T[e].T @ S[i] - np.cross(D[e], S[i])
    return np.cross(S, seen).ravel()


def energy_by_hand(x, edges, J, T, D, K, B):
    S = x.reshape(-1, 3)
    pairs = sum(-J[e] * S[i] @ T[e] @ S[j] + D[e] @ np.cross(S[i], S[j]) for e, (i, j) in enumerate(edges))
    return pairs - np.einsum("ia,iab,ib->", S, K, S) - np.sum(B * S)


def has_closed_form(system):
    try:
        system.exact(np.ones(system.dim), 0.5)
    except TypeError:
        return False
    return True


# Axes of the cells and places of their sites, as in the documentation: bonds have length one.
PLACES = {
    "chain": (np.eye(1), [(0,)]),
    "square": (np.eye(2), [(0, 0)]),
    "triangular": (np.array([[1, 0], [0.5, np.sqrt(0.75)]]), [(0, 0)]),
    "honeycomb": (np.array([[np.sqrt(3), 0], [np.sqrt(0.75), 1.5]]), [(0, 0), (np.sqrt(0.75), 0.5)]),
    "kagome": (np.array([[2, 0], [1, np.sqrt(3)]]), [(0, 0), (1, 0), (0.5, np.sqrt(0.75))]),
    "cubic": (np.eye(3), [(0, 0, 0)]),
}


def positions_of(name, shape):
    axes, sites = PLACES[name]
    cells = np.indices(np.atleast_1d(shape)).reshape(len(axes), -1).T @ axes
    return (cells[:, None] + np.array(sites, dtype=float)).reshape(-1, len(axes))
