"""Random elements of the group that the matrices of a representation generate."""

import numpy as np
from scipy.linalg import expm


def random_element(representation, seed, members=None, size=0.5):
    """Return products of three exponentials, (d, d), or one for each of some members."""
    random, n = np.random.default_rng(seed), len(representation)
    if members is not None:
        return np.stack([random_element(representation, (seed, m), size=size) for m in range(members)])
    first, second, third = (expm(np.tensordot(size * random.normal(size=n), representation, axes=1)) for _ in range(3))
    return first @ second @ third
