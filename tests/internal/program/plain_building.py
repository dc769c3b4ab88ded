"""The tables of a program built coordinate by coordinate, with dictionaries: what the arrays are compared with."""

from bisect import bisect_left

import numpy as np

from coadjoint.program.blocks import Block, Kind, larger_block

U = 2.0**-53


def plain_generator(algebra, form):
    """The entries of sum_i form_i D_i, (D_i)_jk = c_ji^k, without those that cancel."""
    weights = dict(zip(*form, strict=True))
    total, size = {}, {}
    for i, j, k, c in zip(*(column.tolist() for column in algebra.triples), strict=True):
        for acting, row, value in ((j, i, c), (i, j, -c)):
            if acting in weights:
                term = float(weights[acting]) * value
                total[row, k] = total.get((row, k), 0.0) + term
                size[row, k] = size.get((row, k), 0.0) + abs(term)
    return {key: value for key, value in total.items() if abs(value) > 4 * U * size[key]}


def plain_sets(entries):
    """Connected sets of coordinates, by their first ones."""
    near = {}
    for i, j in entries:
        near.setdefault(i, set()).add(j)
        near.setdefault(j, set()).add(i)
    left, found = set(near), []
    for first in sorted(near):
        if first in left:
            inside, edge = {first}, [first]
            while edge:
                new = near[edge.pop()] - inside
                inside |= new
                edge += new
            left -= inside
            found.append(sorted(inside))
    return found


def plain_blocks(entries):
    found = []
    for own in plain_sets(entries):
        mine = {key: entries[key] for key in sorted(entries) if key[0] in own}
        place = {k: p for p, k in enumerate(own)}
        local = tuple((place[i], place[j], value) for (i, j), value in mine.items())
        longest = plain_longest_path(len(own), local)
        if {i for i, _ in mine}.isdisjoint(j for _, j in mine):
            found += [Block(Kind.SHEAR, key, (value,)) for key, value in mine.items()]
        elif len(own) == 1:
            found.append(Block(Kind.SCALE, tuple(own), tuple(mine.values())))
        elif longest is not None:
            found.append(Block(Kind.SERIES, tuple(own), (0.0,), local, longest))
        elif len(own) == 2:
            found.append(plain_plane(*own, mine))
        else:
            found.append(larger_block(len(own), local, U)._replace(coordinates=tuple(own)))
    return found


def plain_longest_path(size, local):
    pattern = np.zeros((size, size), dtype=bool)
    for i, j, _ in local:
        pattern[i, j] = True
    reach = np.eye(size, dtype=bool)
    for power in range(1, size + 1):
        reach = reach @ pattern
        if not reach.any():
            return power - 1
    return None


def plain_plane(i, j, mine):
    a, b, c, d = (mine.get(key, 0.0) for key in ((i, i), (i, j), (j, i), (j, j)))
    if a == 0 and d == 0 and b == -c:
        return Block(Kind.ROTATE, (i, j) if c > 0 else (j, i), (abs(c),))
    return Block(Kind.PLANE, (i, j), ((a + d) / 2, (a - d) / 2, b, c))


def plain_levels(blocks):
    reached, levels = {}, []
    for own in blocks:
        coordinates = {k for block in own for k in block.coordinates}
        levels.append(max((reached[k] + 1 for k in coordinates if k in reached), default=0))
        reached.update(dict.fromkeys(coordinates, levels[-1]))
    return levels


def plain_groups(angle, level, blocks):
    alike, ranks = {}, {}
    for place, block in enumerate(blocks):
        shared = {Kind.SHEAR: (), Kind.CUBIC: place, Kind.SERIES: place}.get(block.kind, block.constants)
        alike.setdefault((block.kind, shared), []).append(block)
    for members in alike.values():
        shape = (members[0].kind, len(members))
        ranks[shape] = rank = ranks.get(shape, -1) + 1
        yield (level, *shape, rank, angle), members


def plain_action(algebra, parts):
    """The columns of an `Action`, by name."""
    run, rows, indices, constants = [0], [], [], []
    for part in parts:
        blocks = [plain_blocks(plain_generator(algebra, form)) for form in part.forms]
        levels = plain_levels(blocks)
        groups = [group for angle, own in enumerate(blocks) for group in plain_groups(angle, levels[angle], own)]
        last = None
        for (level, kind, count, _, angle), members in sorted(groups, key=lambda group: group[0]):
            first = members[0]
            if last == (level, kind, count, angle - 1) and not first.entries:
                rows[-1][1] += 1
            else:
                place = (len(indices), len(constants))
                size = (len(first.coordinates), len(first.entries), first.degree)
                rows.append([kind, 1, count, angle, *place, *size])
            last = (level, kind, count, angle)
            indices += [k for block in members for k in block.coordinates]
            constants += [c for block in (members if kind == Kind.SHEAR else members[:1]) for c in block.constants]
            starts = [entry[0] for entry in first.entries]
            indices += [bisect_left(starts, row) for row in range(len(first.coordinates) + 1) if starts]
            indices += [entry[1] for entry in first.entries]
            constants += [entry[item] for item in range(2, 5) for entry in first.entries if item < len(entry)]
        run.append(len(rows))
    names = ("kind", "angles", "repeat", "angle", "position", "constant", "width", "entries", "degree")
    columns = dict(zip(names, np.array(rows, dtype=np.int64).reshape(-1, 9).T.tolist(), strict=True))
    return {"run": run, **columns, "indices": indices, "constants": constants}


def plain_first_fit(count, first, second, present=None):
    """The group of each thing, -1 for one that is not there."""
    noncommuting_pairs = [set() for _ in range(count)]
    for a, b in zip(first, second, strict=True):
        noncommuting_pairs[int(b)].add(int(a))
    found = []
    for k in range(count):
        taken = {found[m] for m in noncommuting_pairs[k]}
        there = present is None or present[k]
        found.append(next(group for group in range(count) if group not in taken) if there else -1)
    return found
