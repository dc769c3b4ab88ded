"""A scheme and a system made ready for their compiled loop: which family, which tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from coadjoint.algebra.polynomial import Polynomial
from coadjoint.memory import check_room
from coadjoint.methods.base import FlowMethod, Method
from coadjoint.methods.runge_kutta import RungeKuttaMethod
from coadjoint.methods.step_method import StepMethod
from coadjoint.systems.kinds import System
from coadjoint.systems.lie_poisson import LiePoissonSystem

BYTES_PER_CONSTANT = 450  # while flows are read from both orders of a bracket


@dataclass(frozen=True)
class Prepared:
    """A compiled loop, by its name, with its tables.

    `keep` holds the machine code of user functions alive; `shift` is what was taken off the Hamiltonian, Casimirs and
    factors, and turns the group element at output; `memory` is how many numbers a member remembers from step to step.
    """

    loop: str
    tables: Any
    keep: tuple[Any, ...]
    shift: tuple[tuple[Polynomial, float], ...] = ()
    memory: int = 0


def loop_of(system: System, method: Method, h: float, representation: NDArray[Any] | str | None) -> Prepared:
    """Return the compiled loop for a scheme on a system.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        The system.
    method : Method
        The scheme.
    h : float
        Step, negative for backward.
    representation : ndarray of shape (n, d, d), "coadjoint", or None
        What the group element is carried in.

    Returns
    -------
    Prepared
        Ready to advance.

    Raises
    ------
    ValueError
        If the scheme cannot serve the system.
    """
    method.properties(system)
    if system.algebra is not None:
        constants = system.algebra.triples.c.size
        check_room(BYTES_PER_CONSTANT * constants, f"the tables of {type(method).__name__} for {system.name}")
    innermost = method.innermost
    if isinstance(method, FlowMethod) and isinstance(innermost, FlowMethod):
        from coadjoint.kernels.flow import LOOP
        from coadjoint.kernels.tables import flow_tables
        from coadjoint.program.table import build_program

        assert isinstance(system, LiePoissonSystem)
        program = build_program(system, method, group=representation)
        found = flow_tables(program, h, bool(method.compensated))
        return Prepared(LOOP, found.tables, found.keep, program.shift)
    if isinstance(innermost, RungeKuttaMethod):
        from coadjoint.kernels import runge_kutta
        from coadjoint.kernels.runge_kutta_tables import runge_kutta_tables

        found = runge_kutta_tables(system, innermost, representation, method.fractions)
        memory = runge_kutta.memory_of(found.tables)
        return Prepared(runge_kutta.LOOP, found.tables, found.keep, memory=memory)
    if isinstance(innermost, StepMethod):
        from coadjoint.kernels import stepping
        from coadjoint.kernels.step_tables import step_tables

        found = step_tables(system, innermost, representation, method.fractions)
        return Prepared(stepping.LOOP, found.tables, found.keep, memory=stepping.memory_of(found.tables))
    raise TypeError(f"no loop is known for {innermost}")
