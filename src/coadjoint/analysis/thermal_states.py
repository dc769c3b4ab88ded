"""States of spins in thermal equilibrium, by Monte Carlo sweeps: Metropolis, heat bath and over-relaxation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.analysis.coherent_sweeps import CoherentMoves
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import long_operation, note_progress
from coadjoint.memory import check_available_memory
from coadjoint.program.parts.free_bodies import by_degree
from coadjoint.short_repr import short
from coadjoint.systems.coordinates import spins_in
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.forces.base import read_seed
from coadjoint.systems.hamiltonians.terms import PolynomialTerm
from coadjoint.systems.lattices.coherent_spins import CoherentSpinModel
from coadjoint.systems.lattices.dipoles import DipolarFunction
from coadjoint.systems.system_checks import check_system
from coadjoint.validation import read_choice, read_finite, read_integer

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class SpinMonomials:
    """Monomials of spins: coefficients (k,) and coordinates with multiplicity (k, degree), filled up by 3 sites."""

    coefficients: Floats
    factors: Integers
    sites: int

    @classmethod
    def of(cls, polynomial: Polynomial, sites: int) -> SpinMonomials:
        """Return the monomials of a polynomial."""
        listed = [[k for k, e in factors.items() for _ in range(e)] for _, _, factors in polynomial._factors]
        factors = np.full((len(listed), polynomial.degree), 3 * sites)
        for row, one in zip(factors, listed, strict=True):
            row[: len(one)] = one
        return cls(np.array([float(c) for _, c, _ in polynomial._factors]), factors, sites)

    def take(self, chosen: Any) -> SpinMonomials:
        return replace(self, coefficients=self.coefficients[chosen], factors=self.factors[chosen])

    def values(self, S: Floats) -> Floats:
        """Return the monomials (k, members) of spins (sites, 3, members)."""
        rows = S.reshape(-1, S.shape[2])
        filled = np.concatenate([rows, np.ones_like(rows[:1])])
        total = np.repeat(self.coefficients[:, None], rows.shape[1], axis=1)
        for column in self.factors.T:
            total *= filled[column]
        return total

    def changes(self, owner: Integers, S: Floats, sites: Integers, proposed: Floats) -> Floats:
        """Return the changes (sites, members) of the monomials that each proposed spin owns."""
        after, total = S.copy(), np.zeros((len(sites), S.shape[2]))
        after[sites] = proposed
        np.add.at(total, owner, self.values(after) - self.values(S))
        return total

    def fields(self, lengths: Floats) -> Floats:
        """Return bounds (sites, members) of the derivatives by spins of these lengths."""
        filled = np.concatenate([lengths, np.ones_like(lengths[:1])])
        total = np.zeros_like(filled)
        for j, column in enumerate(self.factors.T // 3):
            others = np.delete(self.factors // 3, j, axis=1)
            np.add.at(total, column, np.abs(self.coefficients)[:, None] * np.prod(filled[others], axis=1))
        return total[:-1]

    def neighbours(self) -> Any:
        """Return the pairs of different sites in a monomial, sparse (sites, sites)."""
        import scipy.sparse

        degree, sites = self.factors.shape[1], self.factors // 3
        pairs = np.stack([np.repeat(sites, degree, axis=1).ravel(), np.tile(sites, degree).ravel()])
        first, second = pairs[:, (pairs[0] != pairs[1]) & (pairs < self.sites).all(axis=0)]
        return scipy.sparse.coo_matrix((np.ones(len(first)), (first, second)), shape=(self.sites, self.sites)).tocsr()


@dataclass(frozen=True, eq=False)
class SpinEnergy:
    """``H = S . W S / 2 + sum_i S_i . A_i S_i / 2 + linear . S + constant`` of spins, and monomials; W is sparse."""

    coupling: Any
    on_site: Floats
    linear: Floats
    constant: float
    monomials: SpinMonomials | None = None

    @property
    def words(self) -> int:
        """Random numbers of a spin in a sweep."""
        return WORDS

    @property
    def sites(self) -> int:
        return len(self.on_site)

    @cached_property
    def strengths(self) -> Any:
        """Frobenius norms of the coupling of each pair of sites, sparse (sites, sites), without zeros."""
        import scipy.sparse

        blocks = self.coupling.tocoo()
        place = (blocks.row // 3, blocks.col // 3)
        squares = scipy.sparse.coo_matrix((blocks.data**2, place), shape=(self.sites, self.sites)).tocsr()
        squares.eliminate_zeros()
        squares.data = np.sqrt(squares.data)
        return squares

    @cached_property
    def sublattices(self) -> tuple[Sublattice, ...]:
        """Sets of sites that are not coupled to each other, by first fit."""
        monomials = self.monomials
        colours = _colours(self.strengths if monomials is None else (self.strengths + monomials.neighbours()).tocsr())
        on_site = self.on_site if np.any(self.on_site) else None
        sets = []
        for colour in range(int(colours.max()) + 1):
            sites = np.flatnonzero(colours == colour)
            rows = (3 * sites[:, None] + np.arange(3)).ravel()
            form = None if on_site is None else on_site[sites]
            owned = None if monomials is None else _owned(monomials, sites)
            sets.append(Sublattice(sites, self.coupling[rows], self.linear[rows].reshape(-1, 3, 1), form, owned))
        return tuple(sets)

    def energy(self, S: Floats) -> Floats:
        rows = S.reshape(3 * self.sites, -1)
        density = rows * (0.5 * product(self.coupling, rows) + self.linear[:, None])
        # Each member is summed on its own, in an order that does not depend on their number.
        local = np.sum(np.ascontiguousarray(on_site_energy(self.on_site, S).T), axis=1)
        if self.monomials is not None:
            local += np.sum(np.ascontiguousarray(self.monomials.values(S).T), axis=1)
        return np.asarray(self.constant + local + np.sum(np.ascontiguousarray(density.T), axis=1))


@dataclass(frozen=True, eq=False)
class Sublattice:
    """Sites not coupled to each other: rows of the coupling, fields, on-site forms, and monomials with their sites.

    The last two are None if there are none.

    In a simulation also `beta` (members,), and lengths and rotation angles of spins (sites, members).
    """

    sites: Integers
    coupling: Any
    linear: Floats
    on_site: Floats | None
    monomials: tuple[SpinMonomials, Integers] | None = None
    beta: Any = None
    lengths: Any = None
    sizes: Any = None

    def at_temperature(self, beta: Floats, lengths: Floats, sizes: Floats) -> Sublattice:
        """Return the set in a simulation, with lengths and sizes of all spins."""
        return replace(self, beta=beta, lengths=lengths[self.sites], sizes=sizes[self.sites])

    def field(self, S: Floats) -> Floats:
        """Return ``-dH/dS_i`` without the on-site part, (sites of this set, 3, members), of all spins S."""
        products = product(self.coupling, S.reshape(-1, S.shape[2]))
        return np.asarray(-products.reshape(*self.linear.shape[:2], S.shape[2]) - self.linear)

    def change(self, S: Floats, proposed: Floats) -> Any:
        """Return the changes (sites of this set, members) of all energies but that in `field`, for proposed spins."""
        total: Any = 0.0
        if self.on_site is not None:
            total = on_site_energy(self.on_site, proposed) - on_site_energy(self.on_site, S[self.sites])
        if self.monomials is not None:
            owned, owner = self.monomials
            total = total + owned.changes(owner, S, self.sites, proposed)
        return total


def _owned(monomials: SpinMonomials, sites: Integers) -> tuple[SpinMonomials, Integers]:
    """Return the monomials that depend on some of the sites, no two of which share one, and the site of each."""
    number = np.full(monomials.sites + 1, -1)
    number[sites] = np.arange(len(sites))
    owner = number[monomials.factors // 3].max(axis=1, initial=-1)
    return monomials.take(owner >= 0), owner[owner >= 0]


@dataclass(frozen=True, eq=False)
class CoherentEnergy(SpinEnergy):
    """The energy of sites of SU(N), linear in each: `linear` has what is on site."""

    moves: CoherentMoves = field(kw_only=True)

    @property
    def words(self) -> int:
        return self.moves.words

    @cached_property
    def strengths(self) -> Any:
        """Norms of the coupling of each pair of sites, sparse (sites, sites)."""
        import scipy.sparse

        width, blocks = self.moves.width, self.coupling.tocoo()
        place = (blocks.row // width, blocks.col // width)
        return scipy.sparse.coo_matrix((blocks.data**2, place), shape=(self.sites, self.sites)).tocsr()

    @cached_property
    def sublattices(self) -> tuple[Sublattice, ...]:
        """Sets of sites that are not coupled to each other, by first fit."""
        colours, width = _colours(self.strengths), self.moves.width
        found = []
        for colour in range(int(colours.max()) + 1):
            sites = np.flatnonzero(colours == colour)
            rows = (width * sites[:, None] + np.arange(width)).ravel()
            found.append(Sublattice(sites, self.coupling[rows], self.linear[rows].reshape(-1, width, 1), None))
        return tuple(found)

    def energy(self, S: Floats) -> Floats:
        rows = S.reshape(-1, S.shape[2])
        density = rows * (0.5 * product(self.coupling, rows) + self.linear[:, None])
        return np.asarray(self.constant + np.sum(np.ascontiguousarray(density.T), axis=1))

    def draw(self, sublattice: Sublattice, S: Floats, u: Floats, weights: bool = True) -> Floats:
        """Draw sites in their local fields, or only their phases, in place; return the number of moves."""
        sites = sublattice.sites
        S[sites] = self.moves.draw(sublattice.field(S), S[sites], sublattice.beta, u[:, sites], weights)
        return np.full(S.shape[2], float(len(sites)))


def on_site_energy(A: Floats, S: Floats) -> Floats:
    """Return ``S_i . A_i S_i / 2``, (sites, members)."""
    return np.asarray(0.5 * np.sum(S * np.sum(A[:, :, :, None] * S[:, None], axis=2), axis=1))


def product(matrix: Any, rows: Floats) -> Floats:
    """Return a sparse product; one column takes the same operations as several."""
    wide = rows if rows.shape[1] > 1 else np.repeat(rows, 2, axis=1)
    return np.asarray((matrix @ wide)[:, : rows.shape[1]])


def _colours(neighbours: Any) -> Integers:
    """Return the smallest colours, in the order of sites, that differ between neighbours."""
    colours = np.full(neighbours.shape[0], -1, dtype=np.int64)
    bounds, others = neighbours.indptr.tolist(), neighbours.indices
    for site in range(len(colours)):
        used = set(colours[others[bounds[site] : bounds[site + 1]]].tolist())
        colours[site] = next(colour for colour in range(len(used) + 1) if colour not in used)
    return colours


@ignore_overflow
def spin_energy(system: Any, asking: str) -> SpinEnergy:
    """Return the energy of a system of spins; TypeError or ValueError, in the name of `asking`, for any other."""
    import scipy.sparse

    check_system(system)
    if system.is_batch:
        raise TypeError(f"{system.name} is a batch; call {asking} for each of its systems")
    if system.forces:
        raise TypeError(f"{system.name} has forces; {asking} takes the Hamiltonian part, system.unforced")
    coherent = isinstance(system, CoherentSpinModel)
    if not coherent and not are_spins(system):
        raise TypeError(f"{system.name} is not made of spins; {asking} needs copies of so(3), as spin_lattice has")
    if system.hamiltonian.timed:
        raise TypeError(f"the Hamiltonian of {system.name} depends on time, so that it has no thermal equilibrium")
    n = system.dim
    terms = [piece for term in system.hamiltonian.terms() for piece in by_degree(term)]
    polynomials = [one for one in terms if isinstance(one, PolynomialTerm)]
    parts = [_matrix_and_linear(term, n) for term in terms if term not in polynomials]
    if any(part is None for part in parts):
        raise TypeError(
            f"the Hamiltonian of {system.name} is a function that is not known as a polynomial; {asking} needs "
            "couplings, anisotropies and fields, as spin_lattice has"
        )
    matrix = sum((part[0] for part in parts if part), start=scipy.sparse.csr_matrix((n, n))).tocoo()
    if coherent:
        total = np.sum([part[1] for part in parts if part], axis=0)
        constant, on_sites = sum(part[2] for part in parts if part), np.zeros((len(system.sites), 0, 0))
        return CoherentEnergy(matrix.tocsr(), on_sites, total, constant, moves=CoherentMoves(system.levels))
    on_site, same = np.zeros((n // 3, 3, 3)), matrix.row // 3 == matrix.col // 3
    on_site[matrix.row[same] // 3, matrix.row[same] % 3, matrix.col[same] % 3] = matrix.data[same]
    entries = (matrix.data[~same], (matrix.row[~same], matrix.col[~same]))
    coupling = scipy.sparse.coo_matrix(entries, shape=(n, n)).tocsr()
    linear = np.sum([np.zeros(n), *(part[1] for part in parts if part)], axis=0)
    total = sum((one.polynomial for one in polynomials[1:]), polynomials[0].polynomial) if polynomials else None
    monomials = None if total is None else SpinMonomials.of(total, n // 3)
    return SpinEnergy(coupling, on_site, linear, sum(part[2] for part in parts if part), monomials)


def _matrix_and_linear(term: Any, n: int) -> tuple[Any, Floats, float] | None:
    """Return a term as a sparse matrix, linear part and constant; None if it is not known to be quadratic."""
    import scipy.sparse

    form, function = term.form, getattr(term, "value", None)
    if form is not None:
        rows = (form.values, form.indices, form.indptr)
        return scipy.sparse.csr_matrix(rows, shape=(n, n)), form.linear, form.constant
    if isinstance(function, DipolarFunction):
        at, matrix = term.coordinates, function.matrix()
        rows_of, columns_of = np.broadcast_arrays(at[:, None], at)
        entries = (matrix.ravel(), (rows_of.ravel(), columns_of.ravel()))
        return scipy.sparse.csr_matrix(entries, shape=(n, n)), np.zeros(n), 0.0
    return None


def are_spins(system: Any) -> bool:
    """Return whether the algebra of a system consists of copies of so(3), of any moments, one after the other."""
    found = spins_in(system.algebra) if system.has_structure_constants else None
    return found is not None and np.array_equal(found.coordinates.ravel(), np.arange(system.dim))


SPINS_AT_ONCE = 2**15  # of the members that are swept together
MAX_SWEEPS = 2**40  # with which counters stay within 64 bits
MAX_OVER_RELAXATION = 100  # half turns a sweep, far above any that are useful
MIN_TEMPERATURE = 1e-300  # its inverse is finite

STREAM = 1 << 63
"""The last word of counters, which no noise of forces uses."""
WORDS = 4  # random numbers of a spin in a sweep, and of a block of Philox
MAX_STEP = 1.0  # largest size of a small rotation: at most a quarter turn


@dataclass(frozen=True, eq=False, repr=False)
class ThermalStates:
    """States from a Monte Carlo simulation of spins, and its record; `thermal_states` computes them.

    Attributes
    ----------
    x : ndarray, shape (members, n)
        The states after the last sweep; initial states of `integrate`.
    temperature : ndarray, shape (members,)
        Boltzmann's constant times the temperature of each member.
    energy : ndarray, shape (sweeps + 1, members)
        H at the start and after each sweep.
    acceptance : ndarray, shape (sweeps, members)
        Accepted fraction of the proposed moves of each sweep, over-relaxation excluded.
    sites : int
        Number of spins.
    """

    x: Floats
    temperature: Floats
    energy: Floats
    acceptance: Floats
    sites: int

    def __repr__(self) -> str:
        members = len(self.x)
        low, high = np.min(self.temperature), np.max(self.temperature)
        kT = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
        return (
            f"<{members} states of {self.sites} spins at kT = {kT} after {len(self.acceptance)} sweeps, acceptance "
            f"{np.mean(self.acceptance):.2f}>"
        )


@suggest_keywords
@long_operation("thermal_states")
def thermal_states(
    system: Any,
    temperature: ArrayLike,
    members: int | None = None,
    *,
    seed: int,
    sweeps: int = 1000,
    method: str = "heat bath",
    over_relaxation: int = 0,
    x0: ArrayLike | None = None,
) -> ThermalStates:
    """Return states of spins drawn from the Boltzmann distribution exp(-H/kT), by Monte Carlo sweeps.

    Choose it for initial states at a temperature, and for averages in equilibrium. The members are independent Markov
    chains. Whether they have reached equilibrium is seen from the record of their energies, whose integrated
    autocorrelation time is that of `co.spectra.autocorrelation`.

    Parameters
    ----------
    system : LiePoissonSystem
        Copies of so(3) whose energy is a polynomial, such as `spin_lattice` and `co.systems.spins` with any of their
        couplings. With dipolar coupling spins are updated one by one, in time N^2 for each sweep. Or a model of
        `co.systems.spins` with ``mode="SU(N)"``, whose sites are drawn from all pure states; its bits depend on the
        LAPACK library.
    temperature : float or (members,) array_like
        Boltzmann's constant times the temperature, in units of the energy; kelvin for `co.systems.spins` in units of
        meV. Positive, one for all members or for each.
    members : int, optional
        Number of members; None is that of `x0` or `temperature`, else 1.
    seed : int
        Seed of the random numbers, from 0 to 2^62. To continue from earlier states give another seed.
    sweeps : int
        Number of sweeps over all spins.
    method : {"heat bath", "Metropolis"}
        "heat bath": new directions from the distribution in the local field; with anisotropy on site, and terms of
        degree three and higher such as biquadratic ones, they are accepted with the probability that corrects for it.
        "Metropolis": a small rotation (half of the proposals), a random direction or a reversal (a quarter each); for
        anisotropy on site, or terms of higher degree, far above the temperature. Sites of SU(N) take the heat bath:
        their energy is linear, so that all anisotropy is in the local field.
    over_relaxation : int
        Number of additional sweeps after each, up to 100, which rotate spins by half a turn about their local field:
        at constant energy, without anisotropy on site and terms of higher degree. They shorten correlations near phase
        transitions. Sites of SU(N) take new phases of the levels in their local field.
    x0 : (n,) or (members, n) array_like, optional
        Start, from which the spins have their lengths. None is random directions of length one, or pure states.

    Returns
    -------
    ThermalStates

    Raises
    ------
    TypeError
        The system has forces, other coordinates than spins, or an energy that depends on time or is no polynomial.
    ValueError
        An argument is out of range or has a wrong shape, or the memory does not suffice.

    Notes
    -----
    Spins that are not coupled to each other are updated together. Each spin of each member and sweep has random numbers
    of its own, by Philox: a member is the same, to the bit, for any number of members. With forces, `HeatBath` has the
    same equilibrium, and its dynamics.

    References
    ----------
    Y. Miyatake, M. Yamamoto, J. J. Kim, M. Toyonaga, O. Nagai, J. Phys. C 19, 2539 (1986), the heat bath;
    M. Creutz, Phys. Rev. D 36, 515 (1987), over-relaxation; D. Hinzke, U. Nowak, Comput. Phys. Commun. 121, 334 (1999),
    the moves.

    Examples
    --------
    Two spins, whose mean energy is -(coth(1/kT) - kT):

    >>> import coadjoint as co
    >>> states = co.thermal_states(co.systems.spin_lattice(), 0.5, members=4000, sweeps=10, seed=1)
    >>> states.x.shape, bool(abs(states.energy[-1].mean() + 0.537315) < 0.02)
    ((4000, 6), True)
    """
    energies = spin_energy(system, "thermal_states")
    return states_of(energies, system, temperature, members, seed, sweeps, method, over_relaxation, x0)


@ignore_overflow
def states_of(
    energies: SpinEnergy,
    system: Any,
    temperature: ArrayLike,
    members: int | None,
    seed: int,
    sweeps: int,
    method: str,
    over_relaxation: int,
    x0: ArrayLike | None,
) -> ThermalStates:
    """Return thermal states of a system whose energy is known by `spin_energy`."""
    choice = read_choice(method, "method", tuple(METHODS))
    key = read_seed(seed, "seed")
    count = read_integer(sweeps, "sweeps", 1, MAX_SWEEPS, floats=True)
    extra = read_integer(over_relaxation, "over_relaxation", 0, MAX_OVER_RELAXATION)
    if isinstance(energies, CoherentEnergy) and choice != "heat bath":
        raise ValueError(f'method is {short(method)}, which turns vectors; sites of SU(N) take "heat bath"')
    kT = system.boltzmann * read_finite(temperature, "temperature")
    start = None if x0 is None else read_finite(x0, "x0")
    number = _members(members, kT, start, system.dim, system.name)
    if np.any(kT < MIN_TEMPERATURE):
        raise ValueError(
            f"temperature is {float(kT.min() / system.boltzmann)!r}; it must be positive, from {MIN_TEMPERATURE:g} up; "
            "co.equilibrium finds states of lowest energy"
        )
    check_available_memory(8 * number * (system.dim + 2 * count + 2), f"{short(number)} thermal states")
    group = max(1, min(number, SPINS_AT_ONCE // energies.sites))
    temperatures = np.array(np.broadcast_to(kT, number))
    record = np.empty((count + 1, number)), np.empty((count, number))
    result = ThermalStates(np.empty((number, system.dim)), temperatures, *record, energies.sites)
    for first in range(0, number, group):
        chains = slice(first, min(first + group, number))
        S = _start(start, key, energies, chains)
        _sweep(energies, S, result, chains, (key, choice, extra))
        result.x[chains] = S.reshape(system.dim, -1).T
    if not (np.all(np.isfinite(result.energy)) and np.all(np.isfinite(result.x))):
        raise ValueError(f"energies of {system.name} leave the range of float64; take larger units")
    return result


def _sweep(energies: SpinEnergy, S: Floats, result: ThermalStates, chains: slice, how: tuple[int, str, int]) -> None:
    """Sweep over the spins S (sites, 3, members), in place, and record energies and acceptance."""
    key, choice, extra = how
    lengths, beta = np.sqrt(np.sum(S**2, axis=1)), 1.0 / result.temperature[chains]
    move: Callable[..., Floats] = METHODS[choice]
    relaxed: Callable[..., Any] = over_relax
    sizes = lengths
    if isinstance(energies, CoherentEnergy):
        move, relaxed = energies.draw, partial(energies.draw, weights=False)
    else:
        sizes = step_sizes(energies, lengths, beta)
    sublattices = [one.at_temperature(beta, lengths, sizes) for one in energies.sublattices]
    number, count = len(result.temperature), len(result.acceptance)
    result.energy[0, chains] = energies.energy(S)
    for sweep in range(count):
        accepted = np.zeros(S.shape[2])
        for part in range(1 + extra):
            words = uniform_words(key, (sweep + 1, part), energies.sites, chains, energies.words)
            for sublattice in sublattices:
                if part:
                    relaxed(sublattice, S, words)
                else:
                    accepted += move(sublattice, S, words)
        result.acceptance[sweep, chains] = accepted / energies.sites
        result.energy[sweep + 1, chains] = energies.energy(S)
        note_progress("Monte Carlo sweeps", (chains.start + (sweep + 1) / count * S.shape[2]) / number)


def _start(x0: Floats | None, key: int, energies: SpinEnergy, chains: slice) -> Floats:
    sites, moves = energies.sites, energies.moves if isinstance(energies, CoherentEnergy) else None
    if x0 is None:
        u = uniform_words(key, (0, 0), sites, chains, energies.words)
        return directions(u[0], u[1]) if moves is None else moves.uniform(u)
    members = chains.stop - chains.start
    rows = np.broadcast_to(x0, (members, x0.size)) if x0.ndim == 1 else x0[chains]
    start = np.array(rows.T.reshape(sites, -1, members), order="C")
    if moves is not None and not moves.are_pure(start):
        raise ValueError(
            "x0 has sites that are in no pure state; take states of model.coherent, from_amplitudes or random"
        )
    return start


def _members(members: Any, kT: Floats, start: Floats | None, dim: int, name: str) -> int:
    if start is not None and (start.ndim not in (1, 2) or start.shape[-1] != dim or not start.size):
        raise ValueError(f"x0 has shape {start.shape}; {name} needs ({dim},) or (members, {dim})")
    if kT.ndim > 1 or not kT.size:
        raise ValueError(f"temperature has shape {kT.shape}; give one number, or one for each member")
    counts = {"temperature": len(kT)} if kT.ndim else {}
    if start is not None and start.ndim == 2:
        counts["x0"] = len(start)
    if members is not None:
        counts["members"] = read_integer(members, "members (None is those of x0 and temperature)")
    if len(set(counts.values())) > 1:
        listed = ", ".join(f"{count} of {what}" for what, count in counts.items())
        raise ValueError(f"numbers of members differ: {listed}; give one number of them")
    return next(iter(counts.values()), 1)


def uniform_words(key: int, moment: tuple[int, int], sites: int, members: slice, needed: int = WORDS) -> Floats:
    """Return numbers in (0, 1), (needed, sites, members): a function of seed, sweep, site and member."""
    (sweep, part), blocks = moment, -(-needed // WORDS)
    first, count = members.start * sites * blocks, (members.stop - members.start) * sites * blocks
    # NumPy increments the counter before its first block of four words.
    counter = (((STREAM | part) << 192) | (sweep << 128)) + first - 1
    words = np.random.Philox(key=key, counter=counter).random_raw(WORDS * count)
    numbers = (np.asarray(words >> np.uint64(11), dtype=np.float64) + 0.5) * 2.0**-53
    return np.ascontiguousarray(numbers.reshape(-1, sites, WORDS * blocks).T[:needed])


def directions(u: Floats, v: Floats) -> Floats:
    """Return uniform unit vectors (sites, 3, members) from two uniform numbers each."""
    height, turn = 2.0 * u - 1.0, 2.0 * np.pi * v
    radius = np.sqrt((1.0 - height) * (1.0 + height))
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), height], axis=1)


def step_sizes(energies: SpinEnergy, lengths: Floats, beta: Floats) -> Floats:
    """Return sizes of small rotations that change the energy by about kT, from bounds of the local fields."""
    fields = product(energies.strengths, lengths) + np.linalg.norm(energies.linear.reshape(-1, 3), axis=1)[:, None]
    fields += np.linalg.norm(energies.on_site, axis=(1, 2))[:, None] * lengths
    if energies.monomials is not None:
        fields += energies.monomials.fields(lengths)
    with np.errstate(divide="ignore"):
        return np.asarray(np.minimum(MAX_STEP, 1.0 / np.sqrt(beta * lengths * fields)))


def heat_bath(sublattice: Sublattice, S: Floats, words: Floats) -> Floats:
    """Draw spins in their local fields, in place; return the number of accepted moves of each member."""
    u, v, w = words[:3, sublattice.sites]
    field = sublattice.field(S)
    size = np.sqrt(np.sum(field**2, axis=1))
    strength = sublattice.beta * sublattice.lengths * size
    with np.errstate(divide="ignore", invalid="ignore"):
        fall = -np.log1p(u * np.expm1(-2.0 * strength)) / strength  # 1 - cos of the angle to the field
    fall = np.clip(np.where(strength > 0.0, fall, 2.0 * u), 0.0, 2.0)
    axis = field / np.where(size > 0.0, size, 1.0)[:, None]
    axis[:, 2] = np.where(size > 0.0, axis[:, 2], 1.0)
    first, second = _perpendicular(axis)
    radius, turn = np.sqrt(fall * (2.0 - fall)), 2.0 * np.pi * v
    proposed = (1.0 - fall)[:, None] * axis
    proposed += (radius * np.cos(turn))[:, None] * first + (radius * np.sin(turn))[:, None] * second
    proposed *= sublattice.lengths[:, None]
    return _accept(sublattice, S, proposed, sublattice.change(S, proposed), w)


def metropolis(sublattice: Sublattice, S: Floats, words: Floats) -> Floats:
    """Propose small rotations, random directions and reversals, in place; return the number accepted."""
    u, v, w, kind = words[:, sublattice.sites]
    old, anywhere = S[sublattice.sites], directions(u, v)
    near = old + (sublattice.sizes * sublattice.lengths)[:, None] * anywhere
    size = np.sqrt(np.sum(near**2, axis=1))
    near *= (sublattice.lengths / np.where(size > 0.0, size, 1.0))[:, None]
    proposed = np.where(
        (kind < 0.5)[:, None], near, np.where((kind < 0.75)[:, None], sublattice.lengths[:, None] * anywhere, -old)
    )
    change = sublattice.change(S, proposed)
    change = change - np.sum((proposed - old) * sublattice.field(S), axis=1)
    return _accept(sublattice, S, proposed, change, w)


def over_relax(sublattice: Sublattice, S: Floats, words: Floats) -> None:
    """Rotate spins by half a turn about their local fields, in place; a change on site is accepted as by Metropolis."""
    field, old = sublattice.field(S), S[sublattice.sites]
    square = np.sum(field**2, axis=1)
    along = 2.0 * np.sum(field * old, axis=1) / np.where(square > 0.0, square, 1.0)
    proposed = np.where((square > 0.0)[:, None], along[:, None] * field - old, old)
    # Rounding would change the lengths over many sweeps.
    size = np.sqrt(np.sum(proposed**2, axis=1))
    proposed *= (sublattice.lengths / np.where(size > 0.0, size, 1.0))[:, None]
    change = sublattice.change(S, proposed)
    _accept(sublattice, S, proposed, change, words[2, sublattice.sites])


METHODS: Mapping[str, Callable[[Sublattice, Floats, Floats], Floats]] = {
    "heat bath": heat_bath,
    "Metropolis": metropolis,
}


def _accept(sublattice: Sublattice, S: Floats, proposed: Floats, change: Floats | float, w: Floats) -> Floats:
    """Take proposed spins with probability min(1, exp(-change/kT)); return how many of each member."""
    accepted = np.log(w) <= -sublattice.beta * change
    S[sublattice.sites] = np.where(accepted[:, None], proposed, S[sublattice.sites])
    return np.asarray(np.sum(accepted, axis=0), dtype=np.float64)


def _perpendicular(axis: Floats) -> tuple[Floats, Floats]:
    """Return two unit vectors perpendicular to each unit vector (sites, 3, members) and to each other."""
    x, y, z = axis[:, 0], axis[:, 1], axis[:, 2]
    sign = np.copysign(1.0, z)  # T. Duff et al., J. Comput. Graph. Tech. 6 (2017)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = np.stack([1.0 + sign * x**2 * a, sign * b, -sign * x], axis=1)
    second = np.stack([b, sign + y**2 * a, -y], axis=1)
    return first, second
