"""Deviations of modified Hamiltonians of increasing order along a run, on a logarithmic scale."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.optional_packages import require_packages
from coadjoint.pictures.style import colour, legend, plain_axes, with_figure_settings
from coadjoint.runs.results.solution import Solution, check_solution
from coadjoint.validation import read_integer, read_list

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_POINTS = 5000
"""Largest number of points drawn; a printed line does not resolve more."""


@suggest_keywords
@with_figure_settings
def draw_modified_energy(solution: Solution, orders: Sequence[int] = (4, 6, 8)) -> Figure:
    r"""Return a figure of the deviations of the energy and of modified energies from their initial values.

    If the run is the motion of a nearby Hamiltonian system, the deviation of each order is below that of the previous
    one by a factor of about the square of the step, down to round-off, and none grows.

    Parameters
    ----------
    solution : Solution
        By a splitting; of an ensemble the first member is drawn.
    orders : sequence of int
        Orders of the modified Hamiltonians; see `coadjoint.modified_hamiltonian`.

    Returns
    -------
    matplotlib.figure.Figure
        Neither shown nor saved.

    Examples
    --------
    >>> import coadjoint as co
    >>> sol = co.integrate(co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1), t_span=(0, 10), step=0.1)
    >>> [line.get_label() for line in draw_modified_energy(sol, orders=(4, 6)).axes[0].lines]
    ['energy $H$', '$\\tilde H$ of order 4', '$\\tilde H$ of order 6']
    """
    check_solution(solution)
    require_packages("drawing modified energies", "matplotlib")
    from coadjoint.pictures.figure import ShownFigure
    from coadjoint.pictures.layout import PanelLayout

    listed = read_list(orders, "orders", "give whole numbers such as (4, 6)")
    checked = [read_integer(order, "an order") for order in listed]
    figure = ShownFigure(figsize=(7.2, 4.2), layout=PanelLayout())
    axes = figure.add_subplot()
    draw_deviations(axes, solution, checked)
    axes.set_title(f"{solution.system.name}, {solution.method}, step {solution.step:g}".replace("$", r"\$"))
    legend(axes, beside=True)
    return figure


def draw_deviations(axes: Any, solution: Solution, orders: Sequence[int]) -> None:
    """Draw the deviations of energy and modified energies of the first member from their initial values into axes."""
    series = {"energy $H$": solution.energy}
    series |= {rf"$\tilde H$ of order {order}": solution.modified_energy(order) for order in orders}
    at_start = [values.reshape(len(values), -1)[0, 0] for values in series.values()]
    if solution.t[0] != solution.t_span[0]:  # t_eval does not save the start
        at_start = _energies_at_start(solution, orders)
    every = max(1, -(-len(solution.t) // MAX_POINTS))
    for line, ((label, values), initial) in enumerate(zip(series.items(), at_start, strict=True)):
        energy = values.reshape(len(values), -1)[:, 0]
        deviation = np.abs(energy - initial)[::every]
        # Zero deviations have no logarithm, and leave gaps.
        visible = np.where(deviation > 0.0, deviation, np.nan)
        axes.plot(solution.t[::every], visible, color=colour(line), linewidth=0.9, label=label)
    axes.set(yscale="log", xlabel="time $t$", ylabel="absolute deviation from start")
    plain_axes(axes)


def _energies_at_start(solution: Solution, orders: Sequence[int]) -> list[Any]:
    """Return the energy and the modified energies of the initial state of the first member."""
    # As if it were the only saved point.
    start = type(solution)({**vars(solution), "x": np.asarray(solution.x0)[None]})
    return [np.ravel(solution.initial["energy"])[0], *(np.ravel(start.modified_energy(order))[0] for order in orders)]
