"""The figure of the cell of a crystal with its bonds."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.pictures.curves import view_frame
from coadjoint.pictures.style import (
    colour,
    ink,
    legend,
    new_figure,
    set_title,
    setting,
    thickness,
    with_figure_settings,
)
from coadjoint.short_repr import short
from coadjoint.systems.lattices.bonds import Bond, Bonds
from coadjoint.systems.lattices.crystals import Crystal, check_bond
from coadjoint.validation import read_finite, read_list

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = npt.NDArray[np.float64]

VIEW = (20.0, 14.0)
"""Degrees around the third axis and above the plane of the others: no edges of a rectangular cell coincide."""
PALE = 0.4  # opacity of the edges of the cell, and of what is outside of it
ON_FACE = 1e-6  # fractional distance from a face at which a site is drawn on the opposite one, too
CELL_CORNERS = np.array(list(itertools.product((0.0, 1.0), repeat=3)))


@suggest_keywords
@with_figure_settings
def draw_bonds(crystal: Crystal, bonds: Sequence[Bond], view: tuple[float, float] = VIEW) -> Figure:
    """Draw the cell of a crystal with its sites, a colour for each label, and bonds, a colour for each class.

    Drawn are the sites of the cell, with their images on its faces, all bonds between these, and one of each other
    equivalent bond of a cell; it is pale, as the sites of neighbouring cells that it reaches.

    Parameters
    ----------
    crystal : Crystal
        The crystal.
    bonds : Bonds or sequence of Bond
        Some of its bonds: ``crystal.bonds(max_distance)``, or ``crystal.bonds(max_distance)[:2]``.
    view : (float, float)
        Direction of view in degrees: around the third Cartesian axis, and above the plane of the other two.

    Returns
    -------
    matplotlib.figure.Figure
        The figure, neither shown nor saved.

    Raises
    ------
    ValueError, TypeError
        Something else than a crystal with bonds of its own, or a view that is not two numbers.
    MissingPackageError
        Matplotlib is not installed.

    Examples
    --------
    >>> import coadjoint as co
    >>> cubic = co.spins.crystal(lattice=(1, 1, 1, 90, 90, 90), sites={"Fe": (0, 0, 0)})
    >>> figure = co.plotting.draw_bonds(cubic, cubic.bonds(max_distance=1.5))
    """
    if not isinstance(crystal, Crystal):
        raise TypeError(f"crystal is {short(crystal)}; give one of co.spins.crystal")
    listed = bonds if isinstance(bonds, Bonds) else read_list(bonds, "bonds", "give crystal.bonds(max_distance)")
    for bond in listed:
        check_bond(crystal, bond)
    around_above = read_finite(view, "view")
    if around_above.shape != (2,):
        raise ValueError(
            f"view is {short(view)}; give two angles in degrees, around the third axis and above the plane"
        )
    figure = new_figure("drawing bonds", 6.4, 4.8)
    axes = figure.add_subplot()
    frame = view_frame((float(around_above[0]), float(around_above[1])))

    def project(points: Any) -> tuple[Floats, Floats]:
        turned = np.asarray(points) @ crystal.lattice @ frame.T
        return turned[..., :2], turned[..., 2]

    depths = project(CELL_CORNERS)[1]
    near, far = float(depths.max()), float(depths.min())

    def order(depth: float) -> float:
        return 2.0 + (depth - far) / (near - far)

    for first, last in itertools.combinations(CELL_CORNERS, 2):
        if np.abs(first - last).sum() == 1.0:
            flat, depth = project([first, last])
            axes.plot(*flat.T, color=ink(), alpha=PALE, linewidth=thickness(0.6), zorder=order(depth.min()) - 0.01)
    flat, _ = project(np.concatenate([np.zeros((1, 3)), np.eye(3)]))
    text: dict[str, Any] = {
        "fontsize": setting("axes.titlesize"),
        "color": ink(),
        "ha": "center",
        "va": "center",
        "style": "italic",
    }
    for end, name in zip(flat[1:], "abc", strict=True):
        along = end - flat[0]
        beyond = 0.07 * float(np.ptp(flat)) * along / max(float(np.hypot(*along)), 1e-300)
        axes.text(end[0] + beyond[0], end[1] + beyond[1], name, zorder=4.0, **text)
        axes.update_datalim([end + beyond])
    sites = {(k, *n): True for k, n in _inside(crystal.positions)}
    for number, bond in enumerate(listed):
        label = f"{bond.name}: {bond.kinds[0]}-{bond.kinds[1]}, {bond.distance:.4g}"
        for (i, *n), (j, *m), whole in _drawn(bond, sites):
            sites.setdefault((i, *n), False)
            sites.setdefault((j, *m), False)
            flat, depth = project([crystal.positions[i] + n, crystal.positions[j] + m])
            style: dict[str, Any] = {
                "color": colour(number),
                "alpha": 1.0 if whole else PALE,
                "linewidth": thickness(1.6),
            }
            axes.plot(*flat.T, zorder=order(depth.mean()), label=label, **style)
            label = "_"
    kinds, seen = list(dict.fromkeys(crystal.labels)), set[str]()
    for (k, *n), inside in sorted(sites.items(), key=lambda entry: not entry[1]):
        point, depth = project(crystal.positions[k] + n)
        kind = crystal.labels[k]
        # Bonds have the first colours, and sites those that follow.
        fill = colour(len(listed) + kinds.index(kind))
        axes.plot(
            *point[:, None],
            marker="o",
            linestyle="none",
            markersize=9.0 if inside else 6.0,
            markerfacecolor=fill,
            markeredgecolor=ink(),
            markeredgewidth=0.5,
            alpha=1.0 if inside else PALE,
            zorder=order(float(depth)) + 0.02,
            label="_" if kind in seen else kind,
        )
        seen.add(kind)
    axes.set_aspect("equal")
    axes.axis("off")
    axes.margins(0.08)
    set_title(
        axes,
        f"bonds of {len(crystal.labels)} sites in a cell" if len(crystal.labels) > 1 else "bonds of one site in a cell",
    )
    legend(axes, beside=True)
    return figure


def _inside(positions: Floats) -> list[tuple[int, tuple[int, ...]]]:
    """Return the sites with the cells in which they are inside of the first cell, or on its faces."""
    found = []
    for k, position in enumerate(positions.tolist()):
        shifts = [(0, 1) if x < ON_FACE else (0, -1) if x > 1.0 - ON_FACE else (0,) for x in position]
        found += [(k, n) for n in itertools.product(*shifts)]
    return found


def _drawn(bond: Any, inside: dict[tuple[int, ...], bool]) -> list[tuple[tuple[int, ...], tuple[int, ...], bool]]:
    """Return the ends of the bonds between sites inside, and of each other bond of the class at its own crystal."""
    found = []
    for (i, j), n in zip(bond.sites.tolist(), bond.offsets.tolist(), strict=True):
        own = False
        for k, *start in [site for site, within in inside.items() if within and site[0] == i]:
            end = (j, *(a + b for a, b in zip(start, n, strict=True)))
            if inside.get(end, False):
                found.append(((k, *start), end, True))
                own = True
        if not own:
            found.append(((i, 0, 0, 0), (j, *n), False))
    return found
