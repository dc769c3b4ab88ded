"""Quantities over time: components of the state, drifts of invariants, velocities of bodies, errors, and others."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.pictures.curves import draw_each_member, draw_members, draw_over_time, from_start
from coadjoint.pictures.plot_data import PlottedRun, spread
from coadjoint.pictures.register import CannotShow, Paint, Update, kind
from coadjoint.pictures.style import (
    colour,
    coordinate,
    ink,
    legend,
    new_figure,
    plain_axes,
    setting,
    symbol,
    thickness,
    with_figure_settings,
    write_note,
)
from coadjoint.runs.results.solution import Solution, check_solution
from coadjoint.systems.bodies.body_systems import FRAMES
from coadjoint.validation import read_choice, read_integer, read_list

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = npt.NDArray[np.float64]
Function = Callable[[Any], Any]

MAX_LINES = 8  # as many as there are colours
MAX_TIMES = 400  # points of a curve; a closed form each, which takes time
MAX_CASIMIRS = 5
MAX_POINTS = 5000  # drawn of modified energies; a printed line does not resolve more
"""Largest number of Casimirs drawn as lines; of more, the worst four are drawn, with a band of all."""
BAND_COLOUR = "#9AA7B5"
BISECTIONS = 52  # halvings of an interval, to the last bit of its length


@kind("components", over_time=True, moves=True)
def components(
    drawn: PlottedRun,
    chosen: Sequence[int | str] | Callable[[int], Sequence[int]] | None = None,
    functions: Mapping[str, Function] | Callable[[int], Mapping[str, Function]] | None = None,
    flips: int | str | None = None,
    quantity: str | None = None,
) -> Paint:
    """Show components over time; at most eight, evenly spread.

    Parameters
    ----------
    chosen : sequence of int or str, or callable, optional
        The components, by number from 0 or by name; or a function of the dimension that returns them.
    functions : mapping of str to callable, or callable, optional
        Name to function of the states, (..., n) to (...): drawn in place of components, or in addition to those that
        are `chosen`. Or a function of the dimension that returns them.
    flips : int or str, optional
        A component whose changes of sign are marked, with the time between them.
    quantity : str, optional
        Label of the axis; by default the quantity of the coordinates of the system.
    """
    n, saved, drawn = drawn.n, drawn, drawn.refined
    chosen = chosen(n) if callable(chosen) else chosen
    functions = functions(n) if callable(functions) else functions
    if functions is not None and not functions:  # functions of several parts, of which there is one
        functions = quantity = None
    indices = [drawn.index_of(i) for i in chosen or ()]
    if chosen is None and functions is None:
        indices = spread(n, MAX_LINES).tolist()
    lines = {drawn.label(i): drawn.x[..., i] for i in indices}
    for name, function in (functions or {}).items():
        with np.errstate(all="ignore"):  # nonfinite values are not drawn
            lines[coordinate(name)] = np.asarray(function(drawn.x))
    lines, note = from_start(lines)
    flip_index = None if flips is None else drawn.index_of(flips)

    def paint(axes: Any) -> Update:
        by_member = len(drawn.x) > 1 and len(lines) == 1
        name = drawn.quantity if quantity is None else quantity
        title = f"components of the {name}"
        if quantity is not None or functions is not None or by_member:
            title = f"{name} over time"
        if chosen is None and functions is None and len(indices) < n:
            title += f" ({len(indices)} of {n})"
        ylabel = name
        if by_member:
            ylabel = f"{name} {next(iter(lines))}"
        elif all(label.startswith("$x_{") for label in lines):
            ylabel = f"{name} $x_i$"
        if by_member:
            draw_each_member(axes, saved, drawn.t, next(iter(lines.values())), drawn.dense)
            axes.set(xlabel="time $t$", ylabel=ylabel + note, title=title)
            plain_axes(axes)
            legend(axes, beside=True)
        else:
            draw_over_time(axes, drawn.t, lines, drawn.dense, ylabel + note, title)
        if flip_index is not None:
            _mark_flips(axes, drawn, flip_index)
        return _cursor(axes, saved, title)

    return paint


def _cursor(axes: Any, drawn: PlottedRun, title: str) -> Update:
    """Return the update of a picture over time: a line at the time, added by the first call."""
    lines: list[Any] = []

    def update(k: int) -> None:
        if not lines:
            lines.append(axes.axvline(drawn.t[k], color=ink(), linewidth=thickness(0.8)))
        lines[0].set_xdata([drawn.t[k], drawn.t[k]])
        axes.title.set_text(f"{title}, $t$ = {drawn.t[k]:.4g}")

    return update


def _mark_flips(axes: Any, drawn: PlottedRun, i: int) -> None:
    if len(drawn.x) > 1 or not drawn.dense:
        return
    times = flip_times(drawn.slope, drawn.t, drawn.x[0], i, max_count=2)
    # An arrow between closer times would not be visible.
    if len(times) < 2 or abs(times[1] - times[0]) < 0.05 * abs(drawn.t[-1] - drawn.t[0]):
        return
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.22 * (high - low))
    height = high + 0.07 * (high - low)
    for time in times:
        axes.plot([time, time], [0.0, height], color=ink(), linewidth=0.6, linestyle=":")
    arrow = {"arrowstyle": "<->", "color": ink(), "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", xy=(times[1], height), xytext=(times[0], height), arrowprops=arrow)
    text = f"{drawn.label(i)} changes sign after {abs(times[1] - times[0]):.6g}"
    left, right = axes.get_xlim()
    middle = (times.mean() - left) / (right - left)
    side = "left" if middle < 0.3 else "right" if middle > 0.7 else "center"
    position = {"left": times.min(), "right": times.max(), "center": times.mean()}[side]
    axes.text(position, height, text, ha=side, va="bottom", fontsize=setting("legend.fontsize"), color=ink())


def flip_times(
    field: Callable[[Floats, float], Floats], t: Floats, x: Floats, i: int, max_count: int | None = None
) -> Floats:
    """Return the first `max_count` times at which coordinate i of a motion crosses zero, by cubic interpolation."""
    values = x[:, i]
    intervals = np.flatnonzero((values[:-1] != 0.0) & (np.sign(values[:-1]) * np.sign(values[1:]) <= 0.0))
    times = []
    for p in intervals[:max_count]:
        dt = float(t[p + 1] - t[p])
        before, after = (dt * float(field(x[q], float(t[q]))[i]) for q in (p, p + 1))
        times.append(float(t[p]) + dt * _root(float(values[p]), float(values[p + 1]), before, after))
    return np.array(times)


def _root(a: float, b: float, slope: float, end_slope: float) -> float:
    """Return the zero in [0, 1] of a cubic Hermite polynomial with a change of sign, by bisection."""
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        s = 0.5 * (low + high)
        r = 1.0 - s
        value = a * r * r * (1 + 2 * s) + b * s * s * (3 - 2 * s) + s * r * (slope * r - end_slope * s)
        low, high = (s, high) if (value > 0.0) == (a > 0.0) else (low, s)
    return 0.5 * (low + high)


@kind("drift", over_time=True)
def drift(drawn: PlottedRun) -> Paint:
    """Show the deviations from the start, relative as in `Solution.drift`, on a logarithmic scale.

    If the Hamiltonian depends on time, the title states that the energy is driven. Of many Casimirs the worst four are
    drawn as lines, and a band spans the deviations of all. With forces, dotted lines show the change minus the work of
    the forces: the error of the run.
    """
    sizes = drawn.scales
    deviations = {name: np.abs(change) / sizes[name] for name, change in drawn.changes.items()}
    energy = deviations.pop("energy")
    lines = {"energy": energy, **_worst(deviations)}

    def paint(axes: Any) -> None:
        if len(deviations) > MAX_CASIMIRS:
            _draw_band(axes, drawn, np.stack(list(deviations.values())))
        for i, (name, members) in enumerate(lines.items()):
            # Zero deviations have no logarithm, and leave gaps.
            visible = np.where(members > 0.0, members, np.nan)
            label = "$H$, driven" if name == "energy" and drawn.driven else symbol(name)
            draw_members(axes, drawn.t, visible, drawn.dense, colour(i), label)
            if drawn.unexplained_change is not None:
                change = np.abs(drawn.unexplained_change[name]) / sizes[name]
                _draw_dotted(axes, drawn, change, colour(i), None if i else "$H$ less their work")
        axes.set(yscale="log", xlabel="time $t$", ylabel="relative deviation from start")
        title = "drift of the energy $H$ and the Casimirs"
        if drawn.unexplained_change is not None:
            title = "change of the energy $H$ and the Casimirs by forces"
        elif drawn.driven:
            title = "change of the driven energy $H$, drift of the Casimirs"
        axes.set_title(f"{title}, at the saved points")
        if not any(np.any(values > 0.0) for values in (energy, *deviations.values())):
            write_note(axes, "no deviation in any bit")
        _widen_to_two_decades(axes)
        plain_axes(axes)
        legend(axes, beside=True)

    return paint


def _draw_dotted(axes: Any, drawn: PlottedRun, members: Floats, shade: str, label: str | None) -> None:
    for m, values in enumerate(members):
        visible = np.where(values > 0.0, values, np.nan)
        axes.plot(drawn.t, visible, ":", color=shade, linewidth=thickness(0.8), label=label if m == 0 else None)


def _worst(deviations: dict[str, Floats]) -> dict[str, Floats]:
    if len(deviations) <= MAX_CASIMIRS:
        return dict(deviations)
    size = {name: float(np.nanmax(values, initial=0.0)) for name, values in deviations.items()}
    worst = sorted(deviations, key=lambda name: -size[name])[: MAX_CASIMIRS - 1]
    return {name: deviations[name] for name in worst}


def _widen_to_two_decades(axes: Any) -> None:
    low, high = axes.get_ylim()
    if 0.0 < low < high < 100.0 * low:
        middle = (low * high) ** 0.5
        axes.set_ylim(middle / 10.0, middle * 10.0)


def _draw_band(axes: Any, drawn: PlottedRun, deviations: Floats) -> None:
    series = deviations.reshape(-1, deviations.shape[-1])
    series = np.where(series > 0.0, series, np.nan)
    finite: npt.NDArray[np.bool_] = np.isfinite(series).any(axis=0)  # type: ignore[assignment]
    low, high = np.full((2, series.shape[1]), np.nan)
    low[finite], high[finite] = np.nanmin(series[:, finite], axis=0), np.nanmax(series[:, finite], axis=0)
    label = f"all {len(deviations)} Casimirs"
    axes.fill_between(drawn.t, low, high, color=BAND_COLOUR, alpha=0.4, linewidth=0.5, label=label)


@kind("angular velocity", over_time=True)
def angular_velocity(drawn: PlottedRun, frame: str = "body") -> Paint:
    """Show the components of the angular velocity of bodies, at most eight.

    Parameters
    ----------
    frame : {"body", "space"}
        Frame of the components; space needs the attitude.
    """
    return _paint(drawn, "angular_velocity", r"\Omega", frame)


@kind("angular momentum", over_time=True)
def angular_momentum(drawn: PlottedRun, frame: str = "body") -> Paint:
    """Show the components of the angular momentum of bodies, at most eight.

    Parameters
    ----------
    frame : {"body", "space"}
        Frame of the components; space needs the attitude.
    """
    return _paint(drawn, "angular_momentum", "L", frame)


def _paint(drawn: PlottedRun, name: str, letter: str, frame: str) -> Paint:
    chosen, solution, title = read_choice(frame, "frame", FRAMES), drawn.solution, name.replace("_", " ")
    try:
        vectors = getattr(solution, name)
        if chosen == "space":
            vectors = solution.in_space(vectors)
    except (TypeError, ValueError) as error:
        raise CannotShow(str(error)) from None
    series = drawn.select(vectors)
    series = series.reshape(*series.shape[:2], -1, 3)
    several = series.shape[2] > 1
    vectors_by_name = {
        f"${letter}_{i + 1}$" + (f" [{k + 1}]" if several else ""): np.asarray(series[:, :, k, i])
        for k, i in product(range(series.shape[2]), range(3))
    }
    where = "the body" if chosen == "body" else "space"
    return _paint_lines(drawn, vectors_by_name, title, f"{title} in the frame of {where}")


def first_lines(series: Mapping[str, Floats]) -> tuple[dict[str, Floats], str]:
    """Return the first `MAX_LINES` series, and a text for the title if there are more."""
    lines = dict(list(series.items())[:MAX_LINES])
    return lines, f" ({len(lines)} of {len(series)})" if len(lines) < len(series) else ""


def _paint_lines(drawn: PlottedRun, series: Mapping[str, Floats], ylabel: str, title: str) -> Paint:
    """Return what draws the first `MAX_LINES` series (members, k) over time."""
    first, shown = first_lines(series)
    lines, note = from_start(first)
    return lambda axes: draw_over_time(axes, drawn.t, lines, drawn.dense, ylabel + note, title + shown)


@kind("observed", over_time=True)
def observed(drawn: PlottedRun) -> Paint:
    """Show the observed quantities (``observe=``) that are numbers, at most the first eight."""
    series = {name: drawn.select(values) for name, values in drawn.solution.observed.items()}
    numbers = {name: values for name, values in series.items() if values.ndim == 2 and values.dtype.kind in "fiub"}
    if not numbers:
        raise CannotShow("nothing was observed; integrate with observe={name: function}")
    lines = {symbol(name): values.astype(np.float64) for name, values in numbers.items()}
    return _paint_lines(drawn, lines, "observed quantity", "observed")


@kind("error", over_time=True)
def error(drawn: PlottedRun) -> Paint:
    """Show the distance from the closed form, relative to the size of the initial state, at up to 400 times.

    For a motion that stays on its orbit it is the phase error. Batches are not supported.
    """
    system = drawn.system
    if system.closed_form is None or drawn.solution.system.is_batch:
        raise CannotShow(f"no closed form is known for {drawn.solution.system.name}")
    indices = spread(len(drawn.t), MAX_TIMES)
    t = drawn.t[indices]
    errors_of_members = []
    for states, x0 in zip(drawn.x, drawn.x0, strict=True):
        exact = np.asarray(system.exact(x0, t - drawn.solution.t_span[0]))
        size = float(np.linalg.norm(x0)) or 1.0
        errors_of_members.append(np.linalg.norm(states[indices] - exact, axis=-1) / size)
    errors = np.array(errors_of_members)

    def paint(axes: Any) -> None:
        # Zero errors have no logarithm, and leave gaps.
        draw_members(axes, t, np.where(errors > 0.0, errors, np.nan), drawn.dense, colour(0), None)
        axes.set(xlabel="time $t$", ylabel="relative error", title="distance from the closed form")
        if np.any(errors > 0.0):
            axes.set_yscale("log")
        plain_axes(axes)

    return paint


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
    listed = read_list(orders, "orders", "give whole numbers such as (4, 6)")
    checked = [read_integer(order, "an order") for order in listed]
    figure = new_figure("drawing modified energies", 7.2, 4.2)
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
