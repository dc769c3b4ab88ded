"""Descriptions of splittings: blocks, generators and work of each part, counted in matrices of structure constants."""

import re
from collections import Counter

import numpy as np
import pytest

import coadjoint as co
from drawn_matrices import constants_of

# An algebra, the blocks of all of its generators, an entry of a shear each, and the calls of elementary functions:
# blocks that are equal, but for the sense of a rotation, have them in common.
ALGEBRAS = {
    "so(3)": (co.algebras.so(3), {"ROTATE": 3}, 3),
    "e(3)": (co.algebras.e(3), {"ROTATE": 6, "SHEAR": 6}, 3),
    "so(4)": (co.algebras.so(4), {"ROTATE": 12}, 6),
    "so(5)": (co.algebras.so(5), {"ROTATE": 30}, 10),
    "sl(2)": (co.algebras.sl(2), {"SCALE": 2, "SERIES": 2}, 2),
    "gl(3)": (co.algebras.gl(3), {"SCALE": 12, "SERIES": 6, "SHEAR": 12}, 6),
    "heisenberg(2)": (co.algebras.heisenberg(2), {"SHEAR": 4}, 0),
    "A3,7": (co.algebras.get("A3,7", a=1.75), {"PLANE": 1, "SHEAR": 4}, 1),
    "so(2,2)": (co.algebras.get("so(p,q)", p=2, q=2), {"ROTATE": 4, "PLANE": 8}, 8),
    "copies of e(3)": (co.algebras.copies(co.algebras.e(3), 2), {"ROTATE": 12, "SHEAR": 12}, 6),
    "so(3) in another basis": (
        co.algebras.change_of_basis(co.algebras.so(3), np.array([[1, 0, 0], [1, 1, 0], [0, -1, 1]])), {"CUBIC": 3}, 3,
    ),
}  # fmt: skip


def generators_of(system):
    """Return a part for each generator, in their order: parts keep the order in which they are given."""
    return co.Splitting(order=1, parts=[[i] for i in range(system.dim)]).describe(system).parts


WORK = {"SCALE": 1, "ROTATE": 4, "PLANE": 6, "SHEAR": 2}
"""Multiplications of one block: a factor; a 2 x 2 rotation; two numbers and a 2 x 2 matrix; an angle and a constant."""


def commuting_groups(rng, algebra):
    """All coordinates, in a random order, in groups that commute."""
    actions, groups = constants_of(algebra), []
    for i in rng.permutation(algebra.dim).tolist():
        fitting = [own for own in groups if not any(np.any(actions[i, j]) for j in own)]
        if fitting and rng.random() < 0.75:
            fitting[rng.integers(len(fitting))].append(i)
        else:
            groups.append([i])
    return [sorted(own) for own in groups]


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", ALGEBRAS)
@pytest.mark.parametrize("seed", range(3))
def test_blocks_and_work_of_each_part(name, seed):
    """Of H = sum(c x^2) / 2, so that an angle is one product: one angle may move several blocks."""
    (algebra, wanted, functions), rng = ALGEBRAS[name], np.random.default_rng(seed)
    groups = commuting_groups(np.random.default_rng(seed), algebra)
    system = co.LiePoissonSystem(algebra, co.Quadratic(rng.uniform(0.5, 2.0, algebra.dim)), casimirs={})
    order, singles = (1, 2)[seed % 2], generators_of(system)
    assert sum((Counter(part.blocks) for part in singles), Counter()) == wanted
    assert sum(part.functions for part in singles) == functions
    found, names = co.Splitting(order=order, parts=groups).describe(system), [part.generators[0] for part in singles]
    lines = str(found).split("\n")
    assert sorted(part.generators for part in found.parts) == sorted(tuple(names[i] for i in own) for own in groups)
    for number, part in enumerate(found.parts, start=1):
        own = [singles[names.index(generator)] for generator in part.generators]
        blocks = sum((Counter(one.blocks) for one in own), Counter())
        assert Counter(part.blocks) == blocks
        assert part.functions == sum(one.functions for one in own)
        if set(blocks) <= set(WORK):
            assert part.multiplications == len(own) + sum(WORK[kind] * count for kind, count in blocks.items())
        head, _, said = lines[number].rpartition(": ")
        assert head.startswith(f"  part {number}: {', '.join(part.generators[:6])}")
        assert said == ", ".join(f"{count} {kind}" for kind, count in part.blocks.items()) or said == "nothing moves"
        assert (said == "nothing moves") == (not blocks)
    # A step of order 2 goes forth and back: the first part and the last one are flows of two half steps in one.
    count = len(found.parts)
    weights = [1] * count if order == 1 or count == 1 else [1, *[2] * (count - 2), 1]
    assert found.flows == sum(weights)
    for what in ("multiplications", "functions"):
        each = [getattr(part, what) for part in found.parts]
        assert getattr(found, what) == sum(w * value for w, value in zip(weights, each, strict=True))
    assert lines[0].endswith(f"H in {count} parts") and len(lines) == count + 2
    assert lines[-1].startswith(f"  a step: {found.flows} flows, {found.multiplications} multiplications, ")
    assert found.shift == {}


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("name", ["so(3)", "e(3)", "so(4)", "so(2,2)", "sl(2)"])
def test_the_subtracted_casimirs_as_a_formula(name, sign):
    """With the values of the Casimirs; H minus them is a function of the generators alone."""
    (algebra, _, _), rng = ALGEBRAS[name], np.random.default_rng(5)
    system = co.LiePoissonSystem(algebra, co.Quadratic(sign * np.arange(1.0, algebra.dim + 1.0)))
    found, names = co.Splitting().describe(system), [part.generators[0] for part in generators_of(system)]
    moved = {generator for part in found.parts for generator in part.generators}
    assert name == "sl(2)" or (moved <= set(names) and len(moved) < algebra.dim)  # forms of several there
    x, step = rng.standard_normal(algebra.dim), 2.0**-10
    for i in (i for i in range(algebra.dim) if name != "sl(2)" and names[i] not in moved):
        energies = [
            system.energy(y) - sum(factor * system.casimirs[own](y) for own, factor in found.shift.items())
            for y in (x + way * np.eye(algebra.dim)[i] for way in (step, -step))
        ]
        # Differences of numbers of size 10^2.
        assert abs(energies[0] - energies[1]) < 1e-11
    text = re.fullmatch(r".*: H(.+) in \d+ parts", str(found).split("\n")[0])[1]
    assert " - -" not in text and " + -" not in text and found.shift
    for own, casimir in system.casimirs.items():
        text = text if "x1" in own else text.replace(own, f"({casimir(x)!r})")
    values = {f"x{i + 1}": value for i, value in enumerate(x.tolist())}
    formula = re.sub(r"(\d) \(", r"\1 * (", text.replace("np.float64", "")).replace("^", "**")
    wanted = -sum(factor * system.casimirs[own](x) for own, factor in found.shift.items())
    # Six digits are shown.
    assert eval(formula, {"__builtins__": {}}, values) == pytest.approx(wanted, rel=1e-5)


CUBIC = {(2, 0, 0): 0.5, (0, 3, 0): 0.25, (1, 2, 0): 0.5, (0, 0, 2): 1.0}


@pytest.mark.parametrize(
    ("algebra", "parts"),
    [(co.algebras.copies(co.algebras.so(3), 12), 2), (co.algebras.so(9), 7)],
    ids=["copies", "so(9)"],
)
def test_squares_of_many_coordinates_are_shifted_by_casimirs(algebra, parts):
    """Beyond 24 coordinates too: so(3)^12 with x^2 + 2 y^2 + 3 z^2 has 3 parts without a shift, and so(9) has 15."""
    system = co.LiePoissonSystem(algebra, co.Quadratic(1.0 + np.arange(algebra.dim) % 3))
    assert str(co.Splitting().describe(system)).splitlines()[0].endswith(f"in {parts} parts")
