"""Explicit Lie-Poisson splitting: exact flows of commuting parts, composed (section 4 of Reich 1993)."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods.protocol.flow_method import FlowMethod
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.protocol.properties import Properties
from coadjoint.program.parts.decompose import check_parts
from coadjoint.program.sweeps import Sweep
from coadjoint.short_repr import short
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_vector_states
from coadjoint.validation import read_bool, read_choice, read_finite, read_number

if TYPE_CHECKING:
    from coadjoint.program.describe import Description


class SplittingScheme(NamedTuple):
    """A symmetric composition, processed or not; coefficients have 50 digits (40 for a processed scheme)."""

    order: int
    half: tuple[str, ...]
    """The first half of the palindrome of fractions of the step, with the middle one if `of_second_order`."""
    of_second_order: bool
    """Whether it composes the symmetric step of order 2; otherwise the forward sweep and its adjoint, alternating."""
    processor_half: tuple[str, ...]
    """Fractions of the processor P: second-order steps at these and then at their negatives, the first applied last."""
    source: str

    @property
    def processed(self) -> bool:
        """Whether a step is P K P^-1, with output only after the processor P."""
        return bool(self.processor_half)

    def sweeps(self, number: Callable[[Any], Any]) -> list[Sweep]:
        """Return the sweeps of one step (of the kernel K of a processed scheme), first to last."""
        fractions = self.fractions(number)
        return _sweeps_of_steps(fractions, number) if self.of_second_order else _alternating(fractions, number)

    def fractions(self, number: Callable[[Any], Any]) -> list[Any]:
        """Return the fractions of all steps or sweeps: the palindrome."""
        half = [number(c) for c in self.half]
        return [*half, *(half[-2::-1] if self.of_second_order else half[::-1])]

    def processor(self, number: Callable[[Any], Any]) -> list[Sweep]:
        """Return the sweeps of the processor P, first to last; empty without a processor."""
        half = [number(c) for c in self.processor_half]
        return _sweeps_of_steps([-c for c in half[::-1]] + half[::-1], number)


def _sweeps_of_steps(coefficients: Sequence[Any], number: Callable[[Any], Any]) -> list[Sweep]:
    """Return the sweeps of a composition of second-order steps: each is half a step forward and half its adjoint."""
    sweeps = _alternating([c / 2 for c in coefficients for _ in range(2)], number)
    return [sweep._replace(turn=not sweep.forward) for sweep in sweeps]


def _alternating(coefficients: Sequence[Any], number: Callable[[Any], Any]) -> list[Sweep]:
    """Return forward and backward sweeps in turn: a first-order step (time before parts) and its adjoint."""
    sweeps, elapsed = [], number(0)
    for k, coefficient in enumerate(coefficients):
        forward = k % 2 == 0
        sweeps.append(Sweep(forward, coefficient, elapsed + coefficient if forward else elapsed))
        elapsed = elapsed + coefficient
    return sweeps


def _load_schemes() -> dict[str, SplittingScheme]:
    text = files("coadjoint.methods.numerics").joinpath("splitting_schemes.json").read_text(encoding="utf-8")
    return {
        name: SplittingScheme(
            order=entry["order"],
            half=tuple(entry["half"]),
            of_second_order=entry["base"] == "second order",
            processor_half=tuple(entry.get("processor_half", ())),
            source=entry["source"],
        )
        for name, entry in json.loads(text)["schemes"].items()
    }


SCHEMES = _load_schemes()
PROPERTIES = Properties(poisson=True, energy=False, casimirs="all", attitude="every representation")

# Smallest error at equal cost on a rigid body, among schemes without a processor. This depends on the state: on other
# orbits blanes_moan4 halves the error of order 4.
DEFAULT_SCHEMES = {
    2: "strang",
    4: "suzuki4",
    6: "sofroniou_spaletta6",
    8: "sofroniou_spaletta8",
    10: "sofroniou_spaletta10",
}


@suggest_keywords
@dataclass(frozen=True)
class Splitting(FlowMethod):
    """Composition of exact flows of parts of the Hamiltonian: explicit, a Poisson map, preserves all Casimirs.

    It is the first choice for long runs. Each step costs a few rotations or shears. It is a Poisson map to round-off,
    and preserves every Casimir and the spatial momentum of every representation. The energy is not preserved exactly,
    but its error stays within O(step^order) for exponentially long times.

    Parameters
    ----------
    order : {1, 2, 4, 6, 8, 10}
        1: one sweep X_1(h), ..., X_n(h) through the parts. 2: ``X_1(h/2) ... X_n(h) ... X_1(h/2)`` (Lemma 4.1).
        4, 6, 8, 10: a symmetric composition of 5, 11, 21, 35 steps of order 2, with the smallest error at equal cost on
        a rigid body. Forces act in each of these steps, some of which go backward in time; the order is kept, and
        forces that act forward only, such as noise, are refused.
    parts : "auto", "coordinates", "free_body", "bonds", sequence of sequences of int, or ChosenParts
        How H is split into parts. ``"auto"``: commuting coordinates share a part. Multiples of quadratic Casimirs are
        subtracted from H if this removes a part or lowers the error, and the parts are ordered. The same system always
        has the same parts; `describe` shows them. ``"coordinates"``: one part for each coordinate, as in the paper.
        ``"free_body"``: coordinates that span so(3), with all of the energy that is quadratic in them, are one part,
        which is solved exactly as a free rigid body. A rigid body alone then has only rounding errors. This costs about
        seven rotations, and is worthwhile if the rest of H is weak. ``"bonds"``: for copies of so(3), such as spins,
        each isotropic coupling c z.w of two momenta is solved exactly, as a rotation of both about their sum. Couplings
        that share no momentum are one part. The total momentum is then preserved to rounding, if the couplings preserve
        it. Sets of coordinates are used as given, in that order. `tuned` returns a splitting with explicit parts. If M
        couples coordinates that do not commute, the parts are completed squares; those of more than 16 coordinates of
        many copies, such as spins on a lattice, have one coordinate of each copy, so that all pairs that are coupled
        meet in a part: nine parts for any exchange matrices of neighbours that four colours separate. Monomials of
        degree 3 to 6 of such coordinates are sums of powers of linear forms, as x y^2 of those of x, x + 2 y and x - 2
        y.
    compensated : bool, optional
        Whether the sums of the momentum are compensated, which reduces round-off; the default is no. (Those of the
        group element always are.) After 10^7 steps of 0.1, the errors of the Casimirs of a rigid body, a heavy top and
        a body on so(4) are 5e-13, 3e-13 and 8e-13 of abs(x)^2 without compensation, growing like the square root of
        time or a little faster (root mean square of 16 states); with a full M on so(3) 6e-12, growing linearly. This is
        far below the energy error of any order. With compensation the errors are 8e-15, 8e-15 and 3e-14, growing like
        the square root of time (full M: 4e-13), and a step takes 1.1 to 1.4 times as long.
    rotation : {"exact", "rational"}
        ``"exact"``: by sine and cosine. ``"rational"``: with tan(angle/2) replaced by half the angle, and therefore
        without trigonometric functions. The step is still a Poisson map and preserves the same invariants, but has a
        different error of order 2. An error is raised for a generator that is not a rotation of a single frequency, and
        for an angle that depends on more than its own linear form. A step takes about 1.1 times as long as an exact
        one, since consecutive steps cannot share a flow. Choose it for maps without transcendental functions, not for
        speed.
    scheme : str, optional
        A named scheme instead of `order`, one of `coadjoint.methods.splitting.SCHEMES`: ``"strang"``,
        ``"yoshida4"`` (the paper's fourth-order scheme), ``"suzuki4"``, ``"kahan_li8a"``, ... Processed schemes
        P K P^-1 (``"blanes_casas_murua6"``, 8, 10) cost one short kernel K per step and the processor P at each point
        that is saved or watched: use them with ``watch=False`` and a large `save_every`. A Hamiltonian that depends on
        time is then also evaluated slightly before the start and after the end. At steps that are far too large the
        processor may overflow where the kernel does not; such points are NaN, and the run counts as failed.
    adjoint : bool
        For order 1: the adjoint sweep X_n(h), ..., X_1(h).

    Raises
    ------
    ValueError
        If an order, scheme or choice does not exist.

    See Also
    --------
    GaussLegendre : For Hamiltonians that do not split; preserves quadratic invariants, including a quadratic energy.
    Taylor : For a given accuracy with the least work; restores the energy and polynomial Casimirs.

    References
    ----------
    S. Reich, Numerical integration of the generalized Euler equations, 1993, Lemmas 4.1 and 4.2.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> co.Splitting(order=4).properties(body)
    Properties(poisson=True, energy=False, casimirs='all', attitude='every representation')
    >>> sol = co.integrate(body, (1.0, 0.1, 0.5), t_span=(0, 10), step=0.1, method=co.Splitting(order=2))
    >>> sol.drift()["|x|^2"] < 1e-14
    True
    """

    order: int = 2
    parts: Any = "auto"
    compensated: bool | None = None
    rotation: str = "exact"
    scheme: str | None = None
    adjoint: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "adjoint", read_bool(self.adjoint, "adjoint"))
        order = read_number(self.order, "order")
        if order.is_integer():
            object.__setattr__(self, "order", int(order))
        if self.scheme is not None:
            read_choice(self.scheme, "splitting scheme", SCHEMES)
            if self.order not in (2, SCHEMES[self.scheme].order):
                raise ValueError(
                    f"scheme {self.scheme!r} has order {SCHEMES[self.scheme].order}, not {short(self.order)}"
                )
            object.__setattr__(self, "order", SCHEMES[self.scheme].order)
        elif self.order != 1 and self.order not in DEFAULT_SCHEMES:
            raise ValueError(f"Splitting has the orders 1, 2, 4, 6, 8 and 10, not {short(self.order)}")
        if self.adjoint and self.order != 1:
            raise ValueError(f"adjoint=True is for order 1, a single sweep, not for order {self.order}")
        super().__post_init__()

    @classmethod
    @ignore_overflow
    def tuned(cls, system: LiePoissonSystem, x0: npt.ArrayLike, order: int = 2, **options: Any) -> Splitting:
        """Return a splitting whose parts are chosen for given states: shift and order with the smallest error there.

        The error is that of the first term of the modified Hamiltonian along a short motion from the state (128 steps,
        about 30 radians), carried forward by the tangent map. On bodies, tops and random systems errors were 0.4 to
        0.6 times those of the automatic parts (geometric mean of 48), and in one case of twenty larger by a tenth or
        more. Schemes of order above two are compared by their own first term if it is a polynomial of at most 4000
        monomials, and otherwise by the term of order two.

        Parameters
        ----------
        system : LiePoissonSystem
            The system.
        x0 : array_like, shape (n,) or (k, n)
            A state, or a sample of the states of interest. Without second derivatives of H, or with more than 64
            coordinates, the h^2 term is compared at these states only.
        order : int
            Order of the scheme.
        **options
            Further parameters of `Splitting`.

        Returns
        -------
        Splitting
            With explicit parts: it can be printed, stored and used again.

        Examples
        --------
        >>> import coadjoint as co
        >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
        >>> co.Splitting.tuned(body, (0.1, 1.0, 0.1)).parts
        ChosenParts(order=(0, 1), shift=(('|x|^2', 0.16666666666666666),))
        """
        from coadjoint.methods.numerics.tuned_parts import tuned_parts

        def scheme(parts: Any) -> Splitting:
            return cls(order=order, parts=parts, **options)

        scheme("auto").properties(system)
        points = np.atleast_2d(read_finite(x0, "x0"))
        if points.ndim != 2 or points.shape[1] != system.dim or not len(points):
            raise ValueError(f"x0 has the shape {points.shape}; it must be ({system.dim},) or (k, {system.dim})")
        return scheme(tuned_parts(system, scheme, points))

    def describe(self, system: LiePoissonSystem) -> Description:
        """Return a description of the splitting of a system: parts, generators, kinds of blocks, operations per step.

        Parameters
        ----------
        system : LiePoissonSystem
            The system.

        Returns
        -------
        Description
            Its text is formatted for printing; the fields have the same data.

        Examples
        --------
        >>> import coadjoint as co
        >>> print(co.Splitting().describe(co.systems.rigid_body(inertia=(1, 2, 3))))
        Splitting(order=2) on rigid_body: H - 0.25 |x|^2 in 2 parts
          part 1: x1: 1 ROTATE
          part 2: x3: 1 ROTATE
          a step: 2 flows, 10 multiplications, 2 sines and the like
        """
        from coadjoint.program.describe import describe

        self.properties(system)
        return describe(system, self)

    @property
    def explicit(self) -> bool:
        """Always true: no system of equations is solved."""
        return True

    @property
    def symmetric(self) -> bool:
        """Whether a backward step undoes a step: true for every order but 1, unless processed."""
        # The processor over -h is not that over h: a backward step undoes a step up to O(h^(order + 2)).
        return self.order != 1 and not self._named.processed

    @property
    def instead(self) -> str:  # type: ignore[override]
        """The scheme to compose instead of one that is not symmetric."""
        if len(self.processor()) > 0:
            return "; of a processed scheme P K P^-1 only the kernel K is; take a scheme without a processor"
        return "; of a first-order splitting take Splitting(order=2), its composition with its adjoint"

    def symmetrized(self) -> Method:
        return super().symmetrized() if self.order != 1 or self.adjoint else replace(self, order=2)

    def with_compensation(self) -> Method | None:
        return replace(self, compensated=True) if self.compensated is None else None

    @classmethod
    def examples(cls) -> Sequence[Method]:
        """Return splittings of several orders, parts and sums."""
        return [
            *(cls(order=order) for order in (1, 2, 4)),
            cls(order=1, adjoint=True),
            cls(order=2, parts="coordinates"),
            cls(order=2, compensated=True),
            *(cls(scheme=name) for name in ("yoshida4", "suzuki4")),
        ]

    def properties(self, system: System) -> Properties:
        """Return the properties: the bracket, every Casimir, and the spatial momentum are preserved."""
        check_vector_states(system)
        if not system.has_structure_constants:
            raise ValueError(
                f"Splitting needs a Lie algebra, which {system.name} does not have (its split flows are not linear); "
                "use GaussLegendre or ModifiedGaussLegendre"
            )
        check_parts(cast(Any, system), self.parts, type(self).__name__)
        return PROPERTIES

    def sweeps(self, number: Callable[[Any], Any] = float) -> Sequence[Sweep]:
        """Return the sweeps of one step; of a processed scheme those of its kernel."""
        if self.order == 1:
            moment = 1 if self.adjoint else 0
            return [Sweep(not self.adjoint, number(1), number(moment))]
        return self._named.sweeps(number)

    def processor(self, number: Callable[[Any], Any] = float) -> Sequence[Sweep]:
        """Return the sweeps of the processor P of a processed scheme."""
        return [] if self.order == 1 else self._named.processor(number)

    def steps_between_forces(self) -> tuple[Method, tuple[float, ...]]:
        if self.order <= 2:
            return super().steps_between_forces()
        if not self._named.of_second_order or self._named.processed:
            raise ValueError(
                f"{self} does not consist of steps of order two, between which forces act; with forces take "
                f"Splitting(order={self.order}), or Splitting(order=2)"
            )
        return replace(self, order=2, scheme=None), tuple(self._named.fractions(float))

    @property
    def _named(self) -> SplittingScheme:
        return SCHEMES[self.scheme or DEFAULT_SCHEMES[self.order]]
