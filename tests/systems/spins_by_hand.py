"""Equations and energy of spins on a graph, summed edge by edge; couplings are given for each edge and each site."""

import numpy as np


def by_hand(x, edges, J, T, D, K, B):
    """S_i' = S_i x B_i, the field of each spin summed edge by edge."""
    S = x.reshape(-1, 3)
    seen = B + np.einsum("iab,ib->ia", 2 * K, S)
    for e, (i, j) in enumerate(edges):
        seen[i] += J[e] * T[e] @ S[j] - np.cross(S[j], D[e])
        seen[j] += J[e] * T[e].T @ S[i] - np.cross(D[e], S[i])
    return np.cross(S, seen).ravel()


def energy_by_hand(x, edges, J, T, D, K, B):
    S = x.reshape(-1, 3)
    bonds = sum(-J[e] * S[i] @ T[e] @ S[j] + D[e] @ np.cross(S[i], S[j]) for e, (i, j) in enumerate(edges))
    return bonds - np.einsum("ia,iab,ib->", S, K, S) - np.sum(B * S)
