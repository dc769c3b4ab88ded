"""Decomposition of many systems at once: those of a stack for which `decompose` makes the same choices."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.program.parts.casimir_shifts import (
    MAX_SINGULAR_DIMENSION,
    ROUNDING,
    QuadraticCasimir,
    Rule,
    Shift,
    quadratic_casimirs,
    quadratic_position,
    shift_rules,
    shifted_terms,
)
from coadjoint.program.parts.decompose import (
    BODY_FLOW_CHOICES,
    ChosenParts,
    angles_of,
    at_linear_values,
    candidates,
    decompose,
    leave_out,
    remember,
    sample_points,
    with_order,
)
from coadjoint.program.parts.part import COMPUTED, GradientShare, Parts
from coadjoint.program.parts.second_order import (
    IMPROVEMENT_FACTOR,
    MAX_PERMUTED,
    has_hessians,
    order_weights,
    part_derivatives,
)
from coadjoint.program.parts.split import split
from coadjoint.program.sources import CoefficientNumbers, Sources, sources_of_parts
from coadjoint.program.sparse_rows import MAX_PATTERN_SIZE, SparseRows
from coadjoint.program.table import term_table
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.system_stacks import SystemStack, counts_of, different, grouped, stacks_of
from coadjoint.systems.vanishing_products import without_cancelling

Floats = NDArray[np.float64]

# Operations of an h^2 term beside the sum over triples of pieces, each of which may round the sum of absolute terms.
OPERATIONS = 512
MAX_ATOMS = 40  # pieces of all parts; brackets of all triples are stored


def joint_sizes(
    algebra: LieAlgebra, parts: Parts, sources: Sources, coefficients: Floats, points: Floats
) -> tuple[Floats, Floats]:
    """Return the RMS of the h^2 term (orders, members), and its rounding; infinite if it cannot be computed."""
    members, orders = coefficients.shape[1], list(permutations(range(len(parts))))
    atoms = _atoms(parts, sources, coefficients, points)
    if len(atoms) > MAX_ATOMS:
        return np.full((len(orders), members), np.inf), np.full((len(orders), members), np.inf)
    weights = np.array([order_weights(order) for order in orders]).reshape(len(orders), -1)
    with np.errstate(over="ignore", invalid="ignore"):
        sizes, errors = (
            np.sqrt(np.mean((w @ one.reshape(w.shape[1], -1)).reshape(len(orders), members, -1) ** 2, axis=-1))
            for w, one in zip((weights, np.abs(weights)), _brackets(algebra, atoms, len(parts), points), strict=True)
        )
    failed = ~np.isfinite(sizes + errors)
    sizes[failed] = errors[failed] = np.inf
    return sizes, (OPERATIONS + len(atoms) ** 3) * UNIT_ROUNDOFF * errors


def _atoms(
    parts: Parts, sources: Sources, coefficients: Floats, points: Floats
) -> list[tuple[int, Floats, Floats, Floats]]:
    """Return the pieces of the parts: part, factors of the members, gradient and Hessian."""
    numbers = np.unique(np.concatenate([one.number for one in sources.multiples.values()]))
    varying = numbers[np.any(coefficients[numbers] != coefficients[numbers, :1], axis=1)]
    constant = coefficients[:, 0].copy()
    constant[varying] = 0.0
    pieces = [_derivatives(parts, sources, constant, points, True)]
    for number in varying.tolist():
        unit = np.zeros(len(coefficients))
        unit[number] = 1.0
        pieces.append(_derivatives(parts, sources, unit, points, False))
    weights = [np.ones(coefficients.shape[1]), *coefficients[varying]]
    return [
        (p, weight, gradients[p], np.broadcast_to(hessians[p], (len(points), *hessians.shape[2:])))
        for p in range(len(parts))
        for weight, (gradients, hessians) in zip(weights, pieces, strict=True)
        if np.any(gradients[p]) or np.any(hessians[p])
    ]


def _brackets(algebra: LieAlgebra, atoms: list[Any], count: int, points: Floats) -> Iterator[Floats]:
    """Yield {H_i, {H_j, H_k}} of the parts, (parts, pairs, members, points), and then sums of absolute terms."""
    owner = np.array([p for p, *_ in atoms])
    weight, gradient, hessian = (np.stack([atom[k] for atom in atoms]) for k in (1, 2, 3))
    a, b, c = np.indices((len(atoms),) * 3).reshape(3, -1)
    # Triples of atoms by their parts i and j < k.
    numbers = np.full((count, count), -1)
    numbers[np.triu_indices(count, 1)] = np.arange(count * (count - 1) // 2)
    group = np.where((number := numbers[owner[b], owner[c]]) < 0, -1, owner[a] * (numbers.max() + 1) + number)
    order = np.argsort(group, kind="stable")[np.count_nonzero(group < 0) :]
    first = np.searchsorted(group[order], np.arange(count * (numbers.max() + 1) + 1))
    products = weight[a[order]] * weight[b[order]] * weight[c[order]]
    for absolute in (False, True):
        values = _nested(algebra, gradient, hessian, points, absolute).reshape(-1, len(points))[order]
        factors = np.abs(products) if absolute else products
        sums = [factors[one].T @ values[one] for one in map(slice, first[:-1], first[1:])]
        yield np.reshape(sums, (count, -1, weight.shape[1], len(points)))


def _nested(algebra: LieAlgebra, gradient: Floats, hessian: Floats, points: Floats, absolute: bool) -> Floats:
    """Return {A, {B, C}} of all atoms at points, (a, b, c, points), or with all terms and signs positive."""
    i, j, k, c = algebra.triples
    sign = 1.0 if absolute else -1.0
    if absolute:
        gradient, hessian, points, c = map(np.abs, (gradient, hessian, points, c))
    (count, n), atoms = points.shape, len(gradient)
    structure = np.zeros((n, n, count))
    np.add.at(structure, (i, j), c[:, None] * points[:, k].T)
    np.add.at(structure, (j, i), sign * c[:, None] * points[:, k].T)
    structure = np.ascontiguousarray(np.moveaxis(structure, -1, 0))
    rotated = structure @ gradient[..., None]
    inner = (hessian[:, None] @ rotated)[..., 0]
    inner = inner + sign * np.swapaxes(inner, 0, 1)
    pairs = gradient[:, None, :, i] * gradient[None, :, :, j] + sign * gradient[:, None, :, j] * gradient[None, :, :, i]
    sums = np.zeros((len(k), n))
    sums[np.arange(len(k)), k] = c
    outer = structure @ (inner + pairs @ sums)[..., None]
    columns = outer[..., 0].transpose(2, 3, 0, 1).reshape(count, n, atoms**2)
    products = gradient.swapaxes(0, 1) @ columns
    return np.moveaxis(products.reshape(count, atoms, atoms, atoms), 0, -1)


def _derivatives(
    parts: Parts, sources: Sources, coefficients: Floats, points: Floats, others: bool
) -> tuple[Floats, Floats]:
    """Return `part_derivatives` for other coefficients; numbers and functions that have none are kept if `others`."""

    def filled(name: str, constants: NDArray[Any]) -> NDArray[Any]:
        return sources.multiples[name].at(constants if others else 0.0 * constants, coefficients)

    shares: dict[int, GradientShare] = {}
    given = sorted(parts.gradients.items())
    own = [float(c) for _, share in given if share.polynomial is not None for c in share.polynomial.monomials.values()]
    values = iter(filled("coefficient", np.array(own)).tolist())
    for s, share in given:
        if share.polynomial is not None:
            monomials = {e: next(values) for e in share.polynomial.monomials}
            shares[s] = GradientShare(share.coordinates, Polynomial(monomials, dim=share.polynomial.dim))
        elif others:
            shares[s] = share
    weights = SparseRows(parts.weights.start, parts.weights.coordinate, filled("weight", parts.weights.value))
    offset = filled("offset", parts.offset)
    return part_derivatives(replace(parts, offset=offset, weights=weights, gradients=shares), points)


def smallest(sizes: Floats, errors: Floats) -> tuple[Integers, Floats, Floats, NDArray[np.bool_]]:
    """Choose orders (members,) as by exact sizes, with sizes and errors; the mask is False if rounding decides."""
    best = np.zeros(sizes.shape[1], dtype=np.int64)
    least, error = sizes[0].copy(), errors[0].copy()
    clear = np.isfinite(least)
    for k in range(1, len(sizes)):
        bound = least * IMPROVEMENT_FACTOR
        with np.errstate(invalid="ignore"):
            clear &= np.abs(sizes[k] - bound) > errors[k] + error
        smaller = sizes[k] < bound
        best[smaller] = k
        least, error = np.where(smaller, sizes[k], least), np.where(smaller, errors[k], error)
    return best, least, error, clear


Masks = NDArray[np.bool_]

MAX_RULES = 64  # shifts that are compared for many systems at once
MAX_STACKED = 4096  # systems compared at once


def joint_choices(stack: SystemStack, choice: Any) -> list[SystemStack]:
    """Return systems by their decompositions, with the coefficients that are split; others are decomposed alone."""
    system = stack.first
    if not np.any(different(stack.coefficients)):  # the energy is that of one system
        shift = [factor for _, factor in decompose(system, choice).choice.shift]
        return [stack._replace(factors=np.tile(np.array(shift).reshape(-1, 1), stack.size))]
    if system.dim > MAX_PATTERN_SIZE or choice in BODY_FLOW_CHOICES:
        return []
    linear = getattr(choice, "linear", ())
    inputs: Integers | None = None
    if linear:
        inputs = _present_everywhere(stack, linear)
        if inputs is None:
            return []
    found: dict[tuple[Any, ...], list[SystemStack]] = {}
    for first in range(0, stack.size, MAX_STACKED):
        chunk = stack.take(np.arange(first, min(first + MAX_STACKED, stack.size)))
        of_chunk = _decisions(chunk, choice) if inputs is None else _decisions_with_inputs(chunk, choice, inputs)
        for decision, chosen in of_chunk:
            found.setdefault(decision, []).append(chosen)
    return [SystemStack.joined(pieces) for pieces in found.values()]


def _present_everywhere(stack: SystemStack, linear: Sequence[int]) -> Integers | None:
    """Return the numbers of these linear coefficients, each of one term and zero in no system; None for others."""
    energy, present = CoefficientNumbers.of(stack.terms), np.any(stack.coefficients, axis=1)
    numbers = [energy.number[(energy.coordinate == k) & present[energy.number]] for k in linear]
    if any(len(own) != 1 for own in numbers) or not stack.coefficients[found := np.concatenate(numbers)].all():
        return None
    return found


def _decisions_with_inputs(
    stack: SystemStack, choice: ChosenParts, inputs: Integers
) -> list[tuple[tuple[Any, ...], SystemStack]]:
    """Return `_decisions` where linear coefficients, of these numbers, are inputs: those of "auto" at their values."""
    if not choice.at:
        return _decisions(stack, replace(choice, linear=()))
    there = stacks_of([at_linear_values(stack.systems[m], choice) for m in stack.numbers.tolist()])
    if len(there) != 1 or len(there[0].coefficients) != len(stack.coefficients):
        return []
    (at,), casimirs = there, quadratic_casimirs(stack.first)
    result = list[tuple[tuple[Any, ...], SystemStack]]()
    expected = stack.coefficients[:, at.numbers]
    expected[inputs] = at.coefficients[inputs]
    if not np.array_equal(expected, at.coefficients):
        return []
    for key, found in _automatic(at):
        chosen = stack.take(found.numbers)
        shift = with_order(chosen.first, choice).shift
        factors = {name: own for (name, _), own in zip(shift, found.factors, strict=True)}
        chosen = _shifted(chosen, casimirs, factors)[1](np.arange(chosen.size))
        result += [(key, one) for one in _plain(chosen, casimirs, shift)]
    return result


def _decisions(stack: SystemStack, choice: Any) -> list[tuple[tuple[Any, ...], SystemStack]]:
    """Return members by what was decided; made for all of them at once."""
    if isinstance(choice, ChosenParts):
        factors = {name: np.full(stack.size, factor) for name, factor in choice.shift}
        casimirs = quadratic_casimirs(stack.first)
        if not factors.keys() <= casimirs.keys() or (factors and quadratic_position(stack.terms) is None):
            return []  # refused, with the name of the member
        present, chosen = _shifted(stack, casimirs, factors)
        found = [(key, chosen(members)) for key, members in grouped(present)]
        return [((key,), kept) for key, one in found for kept in _plain(one, casimirs, choice.shift)]
    if choice == "auto":
        return _automatic(stack)
    return [((), stack)]


def _plain(stack: SystemStack, casimirs: dict[str, QuadraticCasimir], shift: Shift) -> list[SystemStack]:
    """Return the systems of which no products cancel after the shift, in a list; an empty one if there are none."""
    terms = shifted_terms(stack.terms, casimirs, shift)
    kept = np.flatnonzero(without_cancelling(stack.first.algebra, terms, stack.split))
    return [stack.take(kept)] if len(kept) else []


def _shifted(
    stack: SystemStack, casimirs: dict[str, QuadraticCasimir], factors: dict[str, NDArray[Any]]
) -> tuple[Masks, Callable[[Integers], SystemStack]]:
    """Subtract multiples of Casimirs, `factors` (members,), bit for bit as `shifted_terms`.

    Return the entries of M that remain (cells, members), and a function of members for which these agree.
    """
    by_member = np.array(list(factors.values()), dtype=np.float64).reshape(-1, stack.size)

    def taken(members: Integers) -> SystemStack:
        return stack.take(members)._replace(factors=by_member[:, members])

    number = quadratic_position(stack.terms) if factors else None
    if number is None:
        return np.zeros((0, stack.size), dtype=bool), taken
    counts, form = counts_of(stack.terms), stack.terms[number].form
    assert form is not None
    n, begin = len(form.linear), sum(counts[:number])
    first, last = begin + n, begin + n + len(form.values)
    own = form.rows * n + form.indices
    codes = {name: casimirs[name].rows * n + casimirs[name].columns for name in factors}
    cells = np.unique(np.concatenate([own, *codes.values()]))
    total = np.zeros((len(cells), stack.size))
    total[np.searchsorted(cells, own)] = stack.coefficients[first:last]
    size = np.abs(total)
    for name, factor in factors.items():
        at, subtracted = np.searchsorted(cells, codes[name]), -factor * casimirs[name].values[:, None]
        total[at] += subtracted
        size[at] += np.abs(subtracted)
    present = np.abs(total) > ROUNDING * size

    def chosen(members: Integers) -> SystemStack:
        stacked = taken(members)
        entries = total[np.ix_(np.flatnonzero(present[:, members[0]]), members)]
        before, after = stacked.coefficients[:first], stacked.coefficients[last:]
        return stacked._replace(split=np.concatenate([before, entries, after]))

    return present, chosen


def _automatic(stack: SystemStack) -> list[tuple[tuple[Any, ...], SystemStack]]:
    """Make the choices of `best_decomposition` by the same comparisons, for members with the same presence."""
    system, count = stack.first, stack.size
    casimirs = quadratic_casimirs(system)
    parts = split(system, "auto")
    if np.any(parts.source == COMPUTED):
        return []
    number = quadratic_position(stack.terms)
    rules: list[Rule] = list(shift_rules(parts, casimirs)) if number is not None and len(parts) > 1 else []
    if len(rules) * max(len(casimirs), 1) > MAX_RULES or _may_be_singular(stack, casimirs, rules):
        return []
    factors = [_factors(stack, rule, number) for rule in rules]
    remaining = [_shifted(stack, casimirs, by_name)[0] for by_name in factors]
    # Everything that `candidates` compares: factors that are zero or equal, and entries that remain.
    table = np.zeros((len(rules), len(casimirs), count))
    for row, by_name in zip(table, factors, strict=True):
        for name, values in by_name.items():
            row[list(casimirs).index(name)] = values
    equal = [np.all(a == b, axis=0) for k, b in enumerate(table) for a in table[:k]]
    masks = [np.zeros((0, count), dtype=bool), (table != 0).reshape(-1, count), *remaining]
    if equal:
        masks.append(np.stack(equal))
    result = []
    for key, members in grouped(np.concatenate(masks)):
        own = stack.take(members)
        for decision, chosen in _ordered(
            own,
            [(rule, {n: f[members] for n, f in by_name.items()}) for rule, by_name in zip(rules, factors, strict=True)],
            casimirs,
        ):
            result.append(((key, *decision), chosen))
    return result


def _may_be_singular(stack: SystemStack, casimirs: dict[str, QuadraticCasimir], rules: Sequence[Rule]) -> bool:
    """Return whether `candidate_shifts` may seek factors for which a completed square vanishes."""
    if len(casimirs) != 1 or stack.first.dim > MAX_SINGULAR_DIMENSION or not rules:
        return False
    form = stack.terms[quadratic_position(stack.terms) or 0].form
    return form is not None and bool(np.any(form.rows != form.indices))


def _factors(stack: SystemStack, rule: Rule, number: int | None) -> dict[str, NDArray[Any]]:
    assert number is not None
    form = stack.terms[number].form
    assert form is not None
    begin = sum(counts_of(stack.terms)[:number]) + len(form.linear)
    diagonal = {int(i): begin + k for k, i in enumerate(form.indices) if form.rows[k] == i}
    zeros = np.zeros(stack.size)
    return {name: (stack.coefficients[diagonal[i]] if i in diagonal else zeros) / entry for name, i, entry in rule}


def _ordered(
    stack: SystemStack, rules: Sequence[tuple[Rule, dict[str, NDArray[Any]]]], casimirs: dict[str, QuadraticCasimir]
) -> list[tuple[tuple[Any, ...], SystemStack]]:
    """Choose among the candidates of members for which they have the same structure, and their orders."""
    system, count = stack.first, stack.size
    points, every, plain = sample_points(system.dim), np.arange(count), np.ones(count, dtype=bool)
    for _, by_name in rules:
        shift = tuple((name, float(values[0])) for name, values in by_name.items() if values[0])
        terms = shifted_terms(stack.terms, casimirs, shift)
        if np.any(split(system, "auto", terms).source == COMPUTED):
            return []
        _, chosen = _shifted(stack, casimirs, {name: by_name[name] for name, _ in shift})
        coefficients = chosen(every).split
        plain &= without_cancelling(system.algebra, terms, coefficients)
    if not plain.all():
        kept = np.flatnonzero(plain)
        reduced = [(rule, {name: values[kept] for name, values in by_name.items()}) for rule, by_name in rules]
        return _ordered(stack.take(kept), reduced, casimirs) if len(kept) else []
    alternatives, found = candidates(system, len(points) > 0), []
    for shift, parts in alternatives:
        of_members = _of_members(stack, shift, parts, rules, casimirs)
        if of_members is None:
            return []
        found.append(of_members)
    fewest = len(alternatives[0][1])
    unordered = fewest < 2 or not len(points) or not has_hessians(system, stack.terms)
    if not unordered and (fewest > MAX_PERMUTED or stack.functions_differ):
        return []
    sized = (
        [
            joint_sizes(system.algebra, parts, sources, own.split, points)
            for (_, parts), (own, sources, _) in zip(alternatives, found, strict=True)
        ]
        if not unordered
        else [(np.zeros((1, count)), np.zeros((1, count))) for _ in alternatives]
    )
    angles = [one for _, _, one in found]
    best, clear = np.zeros(count, dtype=np.int64), np.ones(count, dtype=bool)
    order, least, error, decided = smallest(*sized[0])
    clear &= decided
    for k in range(1, len(alternatives)):
        other_order, size, other_error, decided = smallest(*sized[k])
        clear &= decided
        always, never = (np.zeros(count, dtype=bool) for _ in range(2))
        for b in range(k):
            always |= (best == b) & leave_out(angles[k], angles[b])
            never |= (best == b) & leave_out(angles[b], angles[k])
        bound = least * IMPROVEMENT_FACTOR
        with np.errstate(invalid="ignore"):  # infinite sizes, which are not clear
            decided = np.abs(size - bound) > other_error + error
        clear &= always | never | decided | (size + least + error == 0)
        taken = always | ((size < bound) & ~never)
        best[taken], order[taken] = k, other_order[taken]
        least, error = np.where(taken, size, least), np.where(taken, other_error, error)
    orders = [tuple(range(fewest))] if unordered else list(permutations(range(fewest)))
    result = []
    for b, o in sorted({*zip(best[clear].tolist(), order[clear].tolist(), strict=True)}):
        members = np.flatnonzero(clear & (best == b) & (order == o))
        if members[0] == 0:
            shift, parts = alternatives[b]
            remember(system, shift, parts, orders[o])
        result.append(((b, o), found[b][0].take(members)))
    return result


def _of_members(
    stack: SystemStack,
    shift: Shift,
    parts: Parts,
    rules: Sequence[tuple[Rule, dict[str, NDArray[Any]]]],
    casimirs: dict[str, QuadraticCasimir],
) -> tuple[SystemStack, Sources, list[tuple[Any, Floats]]] | None:
    """Return coefficients of all members after the first one's shift, sources and angles; None if not copies."""
    by_name: dict[str, NDArray[Any]] = {}
    if shift:
        for _, factors in rules:
            if shift == tuple((name, float(values[0])) for name, values in factors.items() if values[0]):
                by_name = {name: factors[name] for name, _ in shift}
                break
        else:
            return None
    chosen = _shifted(stack, casimirs, by_name)[1](np.arange(stack.size))
    terms = shifted_terms(stack.terms, casimirs, shift)
    if np.any(parts.source == COMPUTED):
        return None
    sources = sources_of_parts(term_table(parts).table(), parts, terms)
    constants = {"offset": parts.offset, "weight": parts.weights.value}
    offset, weight = (sources.multiples[name].at(each, chosen.split) for name, each in constants.items())
    return chosen, sources, angles_of(parts, offset, weight)
