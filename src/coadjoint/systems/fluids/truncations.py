"""Fluids and plasmas truncated to a few waves or moments: triads, the equations of Lorenz, the Vlasov equation."""

from __future__ import annotations

import math
import re
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.families.phase_space import moments, powers_of
from coadjoint.algebra.polynomials.formulas import parse_polynomial
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.short_repr import short
from coadjoint.systems.bodies.inertia import read_vector
from coadjoint.systems.closed_forms.closed_form import move_state, oscillator_solutions
from coadjoint.systems.closed_forms.free_rigid_body import rigid_body_equivalent
from coadjoint.systems.gallery_entry import GalleryEntry, Picture, points_on_sphere
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.split_hamiltonian import SplitHamiltonian
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made
from coadjoint.validation import read_positive

Floats = npt.NDArray[np.float64]
Phase = dict[tuple[int, int], Any]  # a polynomial in q and p

MAX_CHARACTERS = 10_000
_MOMENT = re.compile(r"\bx([0-9,]+)\b")


def _waves(system: Any, X: Any, Y: Any) -> Any:
    """Return the three waves cos(k . r) at the points (X, Y)."""
    (a, b), (c, d) = system.parameters["first"], system.parameters["second"]
    return np.cos([a * X + b * Y, c * X + d * Y, (a + c) * X + (b + d) * Y])


def _two_waves(system: Any) -> float:
    """Return twice the longest wavelength."""
    (a, b), (c, d) = system.parameters["first"], system.parameters["second"]
    return 4.0 * math.pi / min(math.hypot(a, b), math.hypot(c, d), math.hypot(a + c, b + d))


@ready_made(
    gallery_entry=GalleryEntry(
        x0=(0.02, 1.0, 0.02),
        t_span=(0.0, 80.0),
        step=0.05,
        caption="The wave of middle length is unstable: its amplitude passes to the two others and comes back with "
        "the opposite sign. Middle, the vorticity at the start; right, when the waves have changed it most.",
        pictures=(
            Picture("field", modes=_waves, width=_two_waves, at=0.0, label="vorticity"),
            Picture("field", modes=_waves, width=_two_waves, at=0.275, label="vorticity"),
        ),
        components=Picture("components", flips=1),
        quantity="vorticity",
    )
)
def fluid_triad(first: npt.ArrayLike = (1.0, 0.0), second: npt.ArrayLike = (0.5, 1.5)) -> LiePoissonSystem:
    """Return a triad of waves of the two-dimensional Euler equations, equivalent to a rigid body.

    The vorticity ``sum of x_i cos(k_i . r)`` has three waves with k1 + k2 + k3 = 0, and the Euler equations are
    truncated to these: ``x1' = (S/2) (1/k3^2 - 1/k2^2) x2 x3`` and cyclic, S = k1 cross k2. The algebra is so(3) with
    brackets S, sign -1, and H is the mean kinetic energy ``sum of x_i^2 / (4 k_i^2)``. The wave of middle length is
    unstable, as the middle axis of a rigid body.

    Parameters
    ----------
    first, second : (2,)
        Wave vectors k1 and k2 (1/length), not parallel; ``k3 = -k1 - k2``.

    Returns
    -------
    LiePoissonSystem
        State: the amplitudes of vorticity (x1, x2, x3), per unit of time. Casimir: the mean enstrophy, ``(x1^2 + x2^2 +
        x3^2) / 4``. ``exact(x0, t)`` in closed form. There is no representation, because a group element has no
        meaning for the fluid.

    Raises
    ------
    ValueError
        Not two finite numbers each, parallel vectors (whose waves do not interact), or squares beyond float64.

    Notes
    -----
    Kraichnan, Phys. Fluids 10, 1417 (1967), for the triad; Waleffe, Phys. Fluids A 4, 350 (1992), for its instability.

    Examples
    --------
    >>> triad = fluid_triad(first=(1.0, 0.0), second=(0.0, 2.0))
    >>> triad.vector_field([1.0, 1.0, 1.0])
    array([-0.05,  0.8 , -0.75])
    """
    k1, k2 = _wave(first, "first"), _wave(second, "second")
    k3 = (-k1[0] - k2[0], -k1[1] - k2[1])
    area = k1[0] * k2[1] - k1[1] * k2[0]
    if area == 0:
        raise ValueError(f"first {short(first)} and second {short(second)} are parallel; give others that are not")
    try:
        S = float(area)
        masses = tuple(float(1 / (2 * (x * x + y * y))) for x, y in (k1, k2, k3))
    except OverflowError:
        S, masses = 0.0, ()
    if S == 0.0 or 0.0 in masses:
        raise ValueError(
            f"first {short(first)} and second {short(second)} leave the range of float64 when squared; take other units"
        )
    parameters = {"first": tuple(map(float, k1)), "second": tuple(map(float, k2))}
    return _truncated("fluid_triad", parameters, (S, S, S), masses, Fraction(1, 4))


def _wave(argument: npt.ArrayLike, name: str) -> tuple[Fraction, Fraction]:
    x, y = read_vector(argument, name, 2).tolist()
    return Fraction(x), Fraction(y)


def _states(count: int) -> npt.NDArray[np.float64]:
    """Return states of equal enstrophy, A^2 + F^2 + 2 G^2 = 1."""
    return points_on_sphere(count) * (1.0, 1.0, 0.5**0.5)


@ready_made(
    gallery_entry=GalleryEntry(
        x0=partial(_states, 14),
        t_span=(0.0, 30.0),
        step=0.02,
        caption="Fourteen motions with one enstrophy, on its ellipsoid: the zonal current A and the waves F and G "
        "exchange their vorticity, around the current, which is stable for k > l, or around the wave G.",
        pictures=(Picture("coadjoint orbit"),),
        components=Picture("components", chosen=(0,)),
        coordinates=("A", "F", "G"),
        quantity="vorticity",
    )
)
def lorenz_1960(k: float = 2.0, l: float = 1.0) -> LiePoissonSystem:
    """Return the three equations of Lorenz (1960) for a zonal current and waves, equivalent to a rigid body.

    The vorticity ``A cos(l y) + F cos(k x) + 2 G sin(l y) sin(k x)`` of an ideal fluid, truncated to these waves:
    ``A' = -(1/k^2 - 1/(k^2 + l^2)) k l F G``, ``F' = (1/l^2 - 1/(k^2 + l^2)) k l A G``,
    ``G' = -(1/l^2 - 1/k^2) k l A F / 2``. The algebra is so(3) with brackets k l, k l, 2 k l, sign -1, and H is the
    mean kinetic energy ``A^2/(4 l^2) + F^2/(4 k^2) + G^2/(2 (k^2 + l^2))``. In coordinates (A, F, sqrt(2) G) it is the
    rigid body with inverse moments 1/(2 l^2), 1/(2 k^2), 1/(2 (k^2 + l^2)), sqrt(2) k l times as fast.

    Parameters
    ----------
    k, l : float
        Wave numbers along x and y (1/length), positive. The current A can be unstable only if k < l.

    Returns
    -------
    LiePoissonSystem
        State (A, F, G), vorticities, per unit of time. Casimir: the mean enstrophy, ``(A^2 + F^2 + 2 G^2) / 4``.
        ``exact(x0, t)`` in closed form. There is no representation, because a group element has no meaning for the
        fluid.

    Raises
    ------
    ValueError
        k or l is not positive, or its square leaves the range of float64.

    Notes
    -----
    Lorenz, "Maximum simplification of the dynamic equations", Tellus 12, 243 (1960).

    Examples
    --------
    >>> lorenz_1960(k=2.0, l=1.0).vector_field([1.0, 1.0, 1.0])
    array([-0.1 ,  1.6 , -0.75])
    """
    k, l = read_positive(k, "k"), read_positive(l, "l")
    k2, l2 = Fraction(k) ** 2, Fraction(l) ** 2
    try:
        masses = tuple(float(1 / (2 * square)) for square in (l2, k2, (k2 + l2) / 2))
        c = float(Fraction(k) * Fraction(l))
        out_of_range = 0.0 in (*masses, c) or 2.0 * c == float("inf")
    except OverflowError:
        out_of_range = True
    if out_of_range:
        raise ValueError(f"the squares of k = {k:g} and l = {l:g} leave the range of float64; take other units")
    return _truncated("lorenz_1960", {"k": k, "l": l}, (c, c, 2.0 * c), masses, Fraction(1, 2))


def _truncated(
    name: str,
    parameters: dict[str, Any],
    brackets: tuple[float, float, float],
    masses: tuple[float, ...],
    third: Fraction,
) -> LiePoissonSystem:
    """Return three waves; the enstrophy has the coefficients 1/4, 1/4 and `third` of their squares."""
    quarter, (a, b, c) = Fraction(1, 4), masses
    enstrophy = Polynomial({(2, 0, 0): quarter, (0, 2, 0): quarter, (0, 0, 2): third})
    return rigid_body_equivalent(brackets, (a, b, c), {"enstrophy": enstrophy}, name, parameters)


@ready_made(
    gallery_entry=GalleryEntry(
        x0=(1.0, 0.0, 0.2),
        t_span=(0.0, 12.0),
        step=0.02,
        caption="A beam in a harmonic well with self-attraction: its ellipse in phase space rotates and "
        "oscillates, and its area, the emittance, is constant. Right, the moments on their hyperboloid, on which the "
        "area is constant.",
        pictures=(Picture("phase ellipse", moments=(0, 1, 2), until=0.15, times=8), Picture("coadjoint orbit")),
        parameters={"degree": 2, "potential": "1/2*x20 + 0.3*x20^2"},
        quantity="moments",
    )
)
def vlasov_moments(degree: int = 4, potential: Any = "1/2*x20 + 1/4*x40") -> LiePoissonSystem:
    """Return particles of mass 1 on a line as moments ``x_ij = <q^i p^j>``, ``H = x02/2 + V(x20, x40, ...)``.

    The Vlasov equation for a distribution symmetric about the origin; moments above a degree are set to zero, which
    preserves the bracket. Sign +1: ``x_ij' = i x_(i-1)(j+1) - j sum over k of k dV/dx_k0 x_(i+k-1)(j-1)``. An external
    potential W(q) is V = <W>, linear in the moments; the self-consistent field adds products of moments. Degree 2 is
    the envelope of a beam.

    Parameters
    ----------
    degree : int
        Highest degree of the moments, even, from 2 to 100.
    potential : str, Polynomial, or Hamiltonian of another kind
        V, an energy, of the moments x20, x40, ...: text such as ``"1/2*x20 + 0.1*x20^2"``, or a Hamiltonian of
        degree / 2 coordinates.

    Returns
    -------
    LiePoissonSystem
        State: the moments x20, x11, x02, x40, x31, ..., weighted by mass: length^i velocity^j. Casimirs: those of
        ``moments(degree)``; <qq><pp> - <qp>^2, the squared emittance, for degree 2. Integrals: if V is linear, the
        moments ``"<h^m>"`` of powers of the energy h = p^2/2 + W of one particle, truncated to the degree.
        ``exact(x0, t)`` if V is a multiple of x20. For degree 2 there is a group element, a linear map of (q, p).
        Parameters are stored if V is text.

    Raises
    ------
    TypeError, ValueError
        An odd degree, or a potential in other moments or in another number of coordinates.

    Notes
    -----
    Channell and Scovel, Physica D 50, 80 (1991); Scovel and Weinstein, Comm. Pure Appl. Math. 47, 683 (1994).
    Moments of q commute, and so do those of p: a splitting has two parts. No distribution has vanishing higher moments,
    so runs approximate the moments near x0 only, not for long times.

    Examples
    --------
    >>> beam = vlasov_moments(degree=2, potential="1/2*x20 + 0.1*x20^2")
    >>> beam.vector_field([1.0, 0.2, 0.5])
    array([ 0.4 , -0.9 , -0.56])
    >>> list(vlasov_moments(6).integrals)
    ['<h^2>', '<h^3>']
    """
    algebra = moments(degree)
    powers = powers_of(degree)
    of_q = [powers.index((d, 0)) for d in range(2, degree + 1, 2)]
    V: Any = potential
    parameters = None
    if isinstance(potential, str):
        V, parameters = _parse_potential(potential, len(of_q)), {"degree": int(degree), "potential": potential}
    particle_energy: Phase | None = None
    kinetic = Polynomial.variable(2, algebra.dim) * 0.5
    if isinstance(V, Polynomial):
        if V.dim != len(of_q):
            raise ValueError(
                f"potential has {V.dim} coordinates; there are {len(of_q)} moments of q: {_moment_names(of_q)}"
            )
        placed = {}
        for exponents, c in V.monomials.items():
            embedded = [0] * algebra.dim
            for k, power in zip(of_q, exponents, strict=True):
                embedded[k] = power
            placed[tuple(embedded)] = c
        H: Any = kinetic + Polynomial(placed, dim=algebra.dim)
        if V.degree <= 1:
            particle_energy = _particle_energy(V)
    else:
        H = SplitHamiltonian([((2,), Quadratic(0.0, linear=[0.5])), (of_q, V)])
    exact = None
    if particle_energy is not None and set(particle_energy) <= {(0, 2), (2, 0)}:
        motion = partial(_linear_flow, 2 * float(particle_energy.get((2, 0), 0)), powers)
        exact = partial(move_state, "vlasov_moments", algebra.dim, motion)
    return LiePoissonSystem(
        algebra,
        H,
        sign=+1,
        name="vlasov_moments",
        parameters=parameters,
        exact=exact,
        integrals={} if particle_energy is None else _powers_of_energy(particle_energy, degree, powers),
    )


def _moment_names(of_q: list[int]) -> str:
    names = [f"x{2 * k}0" for k in range(1, len(of_q) + 1)]
    return ", ".join(names if len(names) < 6 else [*names[:2], "...", names[-1]])


def _parse_potential(text: str, count: int) -> Polynomial:
    def rename(match: re.Match[str]) -> str:
        name = match[1].replace(",", "")
        power = int(name[:-1] or 0) if name[-1:] == "0" and len(name) <= 4 else 1
        if power % 2 or not 0 < power <= 2 * count:
            raise ValueError(f"potential has {short(match[0])}; the moments of q are {_moment_names([0] * count)}")
        return f"x{power // 2}"

    if len(text) > MAX_CHARACTERS:
        raise ValueError(f"potential has {len(text)} characters; give at most {MAX_CHARACTERS}")
    try:
        return parse_polynomial(_MOMENT.sub(rename, text), count)
    except ValueError as reason:
        raise ValueError(str(reason) if str(reason).startswith("potential") else f"potential: {reason}") from None


def _particle_energy(V: Polynomial) -> Phase:
    """Return the energy of one particle in an external potential, V = <W>."""
    h: Phase = {(0, 2): 0.5}
    for exponents, c in V.monomials.items():
        if sum(exponents):
            h[2 * exponents.index(1) + 2, 0] = c
    return h


def _powers_of_energy(h: Phase, degree: int, powers: list[tuple[int, int]]) -> dict[str, Quadratic]:
    """Return the moments of powers of h as linear functions of the state, truncated to the degree."""
    index = {pair: k for k, pair in enumerate(powers)}
    integrals, power = {}, dict(h)
    for m in range(2, degree // 2 + 1):
        product: Phase = {}
        for (i, j), c in power.items():
            for (k, n), factor in h.items():
                if i + j + k + n <= degree:
                    product[i + k, j + n] = product.get((i + k, j + n), 0) + c * factor
        power = product
        linear = np.zeros(len(powers))
        for pair, c in power.items():
            linear[index[pair]] = c
        integrals[f"<h^{m}>"] = Quadratic(0.0, linear=linear)
    return integrals


def _linear_flow(stiffness: float, powers: list[tuple[int, int]], start: Floats, times: Floats) -> Floats:
    """Return the moments under q'' = -stiffness q, where every particle undergoes the same linear map."""
    index = {pair: k for k, pair in enumerate(powers)}
    c, s, _ = oscillator_solutions(stiffness, times)
    slope = -stiffness * s
    moments_at = np.zeros((len(times), len(powers)))
    for (i, j), k in index.items():
        for a in range(i + 1):
            for b in range(j + 1):  # (c q + s p)^i (slope q + c p)^j
                share = math.comb(i, a) * math.comb(j, b) * c ** (a + j - b) * s ** (i - a) * slope**b
                moments_at[..., k] += share * start[index[a + b, i + j - a - b]]
    return moments_at
