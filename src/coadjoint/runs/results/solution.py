"""The result of a run: states, invariants, attitude, drifts."""

from __future__ import annotations

from dataclasses import FrozenInstanceError
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.keyword_hints import suggest_keywords, unknown_solution_attribute
from coadjoint.runs.results.quantities import Drift, NamedValues, scales_of_invariants
from coadjoint.runs.results.solution_attributes import SolutionAttributes, unfinished_members
from coadjoint.runs.results.solution_output import SolutionOutput, extent_text, is_driven, table_of_run
from coadjoint.short_repr import short
from coadjoint.systems.coordinates import CoordinateGroups
from coadjoint.validation import read_bool

DECLARED = [name for name, value in vars(SolutionAttributes).items() if type(value) is cached_property]
COPIED = (*DECLARED, "_work_integrals", "_worst", "_starts")
"""Fields of copies; those of `ESTIMATES` if they are known."""
ESTIMATES = ("_errors_at_end", "_step_error")


class Solution(SolutionOutput):
    """The result of a run: arrays over the k saved times, (k, ...) for one member, (k, members, ...) for an ensemble.

    Attributes
    ----------
    path, attributes, inputs
        Only of stored runs, as what follows: the source, the attributes of the dataset, and a function that returns the
        arguments of `integrate` that repeat the run.
    dataset : xarray.Dataset
        Of a file: its content, in memory; settings of a sweep are coordinates.
    finished, reached, check_complete
        Of an archive: whether the run has reached its end (otherwise `resume` continues it), the number of steps taken,
        and a function that raises ArchiveError if committed chunks are missing or the last ones are damaged.
    status, blocks, progress_text
        Of an archive: 0 for members that are not computed yet, 1 for those that are, 2 for those that have failed;
        blocks of members that are run together, of a run one block; and the computed members or steps as text.

    Notes
    -----
    Attributes are computed or read lazily and cached; the tables of the run are not kept alive. A solution of an
    archive is a snapshot; its ``to_xarray()`` reads parts of arrays that do not fit in memory.

    Examples
    --------
    >>> import coadjoint as co
    >>> sol = co.integrate(co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1), t_span=(0, 1), step=0.1)
    >>> sol.x.shape, sorted(sol.drift())
    ((11, 3), ['energy', '|x|^2'])
    """

    choice = None
    _in_memory = True
    _starts: NDArray[np.float64] | None = None
    """Initial momenta of a run with `accuracy`, (members, n)."""

    def __init__(self, fields: dict[str, Any]) -> None:
        object.__setattr__(self, "__dict__", fields)

    @cached_property
    def t_span(self) -> tuple[float, float]:
        return self._times.t0, self._times.end if self._ending is None else self._ending.t

    @cached_property
    def asked_span(self) -> tuple[float, float]:
        return self._times.t0, self._times.end

    @cached_property
    def step(self) -> float:
        return abs(self._times.h)

    @cached_property
    def save_every(self) -> int:
        return self._times.save_every

    def __setattr__(self, name: str, value: Any) -> None:
        raise FrozenInstanceError(f"cannot assign to field {name!r}: a Solution cannot be changed")

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            # If the computation of an attribute failed, raise that error.
            if hasattr(type(self), name):
                return object.__getattribute__(self, name)

            raise unknown_solution_attribute(name, dir(self))

    def __delattr__(self, name: str) -> None:
        raise FrozenInstanceError(f"cannot delete field {name!r}: a Solution cannot be changed")

    @property
    def _title(self) -> str:
        return f"{self.system.name} by {self.method}"

    @property
    def _driven(self) -> bool:
        return is_driven(self.system)

    def __repr__(self) -> str:
        members = "" if self.failed is None else f", {len(self.failed)} members"
        return f"<solution of {self._title}: {extent_text(self)}, step {self.step:g}{members}>"

    def _repr_html_(self) -> str:
        return table_of_run(self)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy and pickle the values of all attributes, without the arrays from which they are made."""
        found = {name: value for name, value in vars(self).items() if name in ESTIMATES}
        return Solution, ({name: getattr(self, name) for name in COPIED if hasattr(self, name)} | found,)

    @suggest_keywords
    def drift(self, relative: bool = True) -> dict[str, Drift]:
        """Return the largest deviation of each invariant from its initial value.

        Small deviations do not show that a run is accurate: a scheme that preserves an invariant does so at any step.
        See `error_estimate` and `step_error`.

        Parameters
        ----------
        relative : bool
            Relative to the size of the invariant, ``drift()["energy"].scale``: the initial energy, or where its
            terms nearly cancel, and of Casimirs, the sum of their absolute values. Otherwise, and where both are zero,
            absolute.

        Returns
        -------
        dict
            ``"energy"`` and the name of each Casimir -> `Drift`: a float, the largest deviation over every step (with
            ``watch=False`` over the saved points, or the steps at or before the times of `t_eval`), with its `scale`,
            the `absolute` deviation, and `tenths`, the same for each tenth of the run. Members of an ensemble that have
            not run yet are left out, and NaN in its `members`.

        Examples
        --------
        >>> import coadjoint as co
        >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
        >>> drift = co.integrate(body, (10.0, 2.0, 1.0), (0, 10), 0.01).drift()["energy"]
        >>> drift.scale == body.energy((10.0, 2.0, 1.0)), bool(abs(drift.absolute / drift.scale - drift) < 1e-18)
        (True, True)
        """
        if self.work:
            raise TypeError(
                f"energy and Casimirs of {self.system.name} are changed by its forces; take balance(), the change "
                "minus the work of the forces, or change()"
            )
        return self._deviations(0, relative)

    @suggest_keywords
    def balance(self, relative: bool = True) -> dict[str, Drift]:
        """Return the change of each invariant minus the work of the forces: the error of the scheme.

        The work of a force is the difference of the invariant before and after each flow of the force, added up over
        the run with compensated sums; `work` has it at the saved points. If the Hamiltonian depends on time, the
        balance also contains the energy that this brings in.

        Parameters
        ----------
        relative : bool
            As for `drift`.

        Returns
        -------
        dict
            As `drift`, for ``invariant - work of all forces``. Without forces it is `drift`. For matrices it has the
            energy, the Casimirs whose work is recorded (degree two, one block), and all that the forces preserve.

        Examples
        --------
        >>> import coadjoint as co
        >>> body = co.systems.rigid_body(inertia=(1, 2, 3)).with_forces(co.forces.LinearDamping(0.1))
        >>> sol = co.integrate(body, (1.0, 0.2, 0.1), t_span=(0, 10), step=0.125, method=co.GaussLegendre(2))
        >>> lost, done = sol.energy[-1] - sol.energy[0], sol.work["LinearDamping"]["energy"][-1]
        >>> bool(lost < -0.4), bool(abs(lost - done) < 1e-15), bool(sol.balance()["energy"] < 1e-14)
        (True, True, True)
        """
        if not self.work:
            return self._deviations(0, relative)
        accounted = {invariant for _, invariant in self._work_integrals}
        conserves_casimirs = accounted == {"energy"} and self._forces_keep_casimirs
        deviations = self._deviations(1 + len(self.casimirs), relative)
        return NamedValues({name: one for name, one in deviations.items() if conserves_casimirs or name in accounted})

    @property
    def _forces_keep_casimirs(self) -> bool:
        """Whether the forces preserve all Casimirs, which work integrals do not show: some matrices have none."""
        return all(force.casimirs for force in self.system.forces)

    @suggest_keywords
    def change(self, relative: bool = True) -> dict[str, Drift]:
        """Return the largest change of each invariant from its initial value, by forces and scheme.

        Parameters
        ----------
        relative : bool
            As for `drift`.

        Returns
        -------
        dict
            As `drift`; without forces it is `drift`.
        """
        return self._deviations(0, relative)

    @suggest_keywords
    def error_estimate(self, by_group: bool = False) -> Any:
        """Return the estimated error of the last state, relative in the same way as `accuracy`.

        Choose it to know how accurate a run is; conserved invariants do not show it. It is computed once, by a second
        run of 1.5 times as many steps. If both agree to rounding, a third run of 1.75 times as many steps is compared.
        This takes 1.5 or 3.25 times as long as the run. The estimate is accurate within a factor of 10, if it is well
        below one. If the error is below the expected rounding, the estimate is that rounding. If a finer run fails,
        another is tried, four at most; if all fail, the estimate is infinite. If steps lose many digits of a group of
        coordinates by rounding, one more run of as many steps is rounded up and down in turns.

        Parameters
        ----------
        by_group : bool
            Return the errors of all groups of coordinates that brackets do not turn into each other, such as angular
            momentum, momentum and position, or each spin. Without structure constants all coordinates are one group.

        Returns
        -------
        float, or ndarray of shape (members,)
            The largest error of a group of coordinates, relative to its largest size during the run; NaN for members
            without a last state, which have not run yet, have failed, or were ended by an event. With `by_group` a
            dict: name of the group, made of those of its coordinates -> its error.

        Raises
        ------
        TypeError
            The system has random forces.
        ValueError
            No member has a last state.

        Examples
        --------
        >>> import coadjoint as co
        >>> body, x0 = co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.5)
        >>> sol = co.integrate(body, x0, (0, 100), step=0.5, method=co.Taylor(order=4))
        >>> bool(sol.drift()["energy"] < 1e-14), bool(1e-6 < sol.error_estimate() < 1e-2)
        (True, True)

        Of the momentum and of the axis of gravity of a top:

        >>> top = co.systems.heavy_top()
        >>> sol = co.integrate(top, (0.01, 0.0, 0.02, 0.1, 0.0, 1.0), (0, 1), step=0.05)
        >>> sorted(sol.error_estimate(by_group=True))
        ['gamma', 'm']
        """
        errors = self._errors_at_end
        if self.failed is None:
            errors = errors[:, 0].tolist()
        if not read_bool(by_group, "by_group"):
            return errors[0]
        return NamedValues(zip(CoordinateGroups(self.system).names(), errors[1:], strict=True))

    @suggest_keywords
    def step_error(self, by_group: bool = False) -> Any:
        """Return the error of a step, relative to the change of the state in it: a cheap test of the step.

        At five points of the run a step is compared with two half steps; and so is the fastest step that the saved
        points show, such as a pericentre, whose error counts 0.4 times. Above 0.02 the scheme does not follow a motion
        that turns or oscillates, whatever its invariants; near equilibria and on slow ramps, where a step changes as
        little as it errs, the number is large in runs that are right, and NaN at rest, where it is the error that
        changes the state; see `error_estimate` for them. `integrate` warns if the error over the run is
        more than 5 per cent of the motion (docs/accuracy.md). For the error at the end see `error_estimate`.
        Groups of coordinates count relative to their sizes, such as momentum and position, or each spin; those that
        start at zero relative to the size of the state. The rounding of a step counts if it loses many digits of a
        group.

        Parameters
        ----------
        by_group : bool
            Return the errors of the groups instead, at the five points. That of a group which hardly moves may be
            large while its error is small beside its size; see ``error_estimate(by_group=True)``.

        Returns
        -------
        float
            The root mean square over the points; of an ensemble that of the worst of at most 64 members. With
            `by_group` a dict: name of the group -> its error in a step, relative to its change.

        Raises
        ------
        TypeError
            The scheme chooses its own steps, or the system has random forces.

        Examples
        --------
        >>> import coadjoint as co
        >>> top, x0 = co.systems.heavy_top(), (1.0, 0.0, 2.0, 0.1, 0.0, 1.0)
        >>> co.integrate(top, x0, (0, 10), step=0.05, method=co.Splitting(order=4)).step_error() < 1e-3
        True
        """
        if read_bool(by_group, "by_group"):
            from coadjoint.runs.error_estimates import step_errors_of_groups

            return NamedValues(step_errors_of_groups(self))
        return self._step_error

    @cached_property
    def _errors_at_end(self) -> NDArray[np.float64]:
        """Estimated errors at the end, the largest and those of groups of coordinates, (1 + groups, members)."""
        from coadjoint.runs.error_at_end import error_at_end

        return error_at_end(self)

    @cached_property
    def _step_error(self) -> float:
        from coadjoint.runs.error_estimates import step_error

        return step_error(self)

    def _deviations(self, first: int, relative: bool) -> dict[str, Drift]:
        # Balances have the initial values of the invariants.
        worst, scales = self._worst, self._scales if read_bool(relative, "relative") else {}
        waiting = False if self.failed is None else unfinished_members(self)
        return NamedValues(
            {
                name: Drift(worst[..., first + i], value, scales.get(name, 1.0), waiting)
                for i, (name, value) in enumerate(self.initial.items())
            }
        )

    @cached_property
    def _pending_members(self) -> NDArray[np.bool_] | None:
        """Members of an archive that are not computed yet, (members,); None where other states show them."""
        return None

    @cached_property
    def _scales(self) -> dict[str, Any]:
        """Sizes of the invariants, to which deviations are relative."""
        try:
            system = self.system
        except ValueError:  # a run that was read, with functions that are not stored
            system = None
        return scales_of_invariants(system, self.x0, self.initial)


def with_choice(solution: Solution, choice: Any) -> Solution:
    """Attach the `Choice` of scheme and step to a new solution; None if they were given."""
    if choice is not None:
        vars(solution).update(choice=choice, _starts=solution._start.momenta)
    return solution


def set_elapsed(solution: Solution, seconds: float) -> None:
    """Set the time of the call that has returned a new solution."""
    vars(solution)["_elapsed"] = seconds


def check_solution(solution: Any) -> None:
    """Raise TypeError unless the argument is a `Solution`."""
    if not isinstance(solution, Solution):
        raise TypeError(f"solution is {short(solution)}; it must be a Solution, from co.integrate")
