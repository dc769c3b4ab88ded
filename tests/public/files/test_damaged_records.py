"""Damaged datasets are refused by one ValueError in bounded time, or rebuild another run."""

import copy
import functools
import json
import operator
import random

import numpy as np
import pytest
from stored_systems import BODY, MATRICES, SPHERE, SYSTEMS, start

import coadjoint as co
from guards import bounded_work
from refusals import refused
from served import served, state_of

X = (0.3, 0.1, 0.5)
SEEDS = range(20)
# Systems of each kind of record, and each scheme.
RUNS = {name: (system, start(system), None) for name, system in SYSTEMS.items() if name not in MATRICES}
RUNS |= {name: (SYSTEMS[name], start(SYSTEMS[name]), co.IsospectralGauss()) for name in MATRICES}
RUNS |= {"tuned": (BODY, X, co.Splitting.tuned(BODY, X, order=4)), "structure": (BODY, X, co.ModifiedGaussLegendre(2))}
for each in co.methods.names():
    scheme = co.methods.registry.scheme(each).examples()[0]
    RUNS[each] = (*served(scheme), scheme)


@functools.cache
def stored(name):
    """Return the dataset of a short run."""
    system, x0, method = RUNS[name]
    attitude = "coadjoint" if method is None and "batch" not in name else False
    method = method or co.GaussLegendre(2)
    return co.integrate(system, x0, (0.0, 0.25), 0.0625, method, save_every=2, attitude=attitude).to_xarray()


def nested_lists(depth):
    value = 1.0
    for _ in range(depth):
        value = [value]
    return value


def entry_paths(value, path=()):
    """Yield the path of every entry of nested lists and tables."""
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
        yield (*path, key)
        if isinstance(inner, dict | list):
            yield from entry_paths(inner, (*path, key))


STRANGE = (
    None, True, False, -1, 0, 1, 2, 7, 3.5, -0.0, 1e308, -1e308, 1e-320, float("nan"), float("inf"), 2**31, 2**63,
    10**12, 10**30, 10**400, "", "1/3", "1/0", "1e1000000000", "9" * 5000, "é\0", [], {}, [[]], [1], ["a"], {"a": 1},
    {"kind": "split", "pieces": []}, nested_lists(10), nested_lists(100), {"name": "Splitting"}, [0.0] * 50,
)  # fmt: skip


def damaged(tree, rng):
    """Return a tree with an entry deleted, exchanged, replaced or duplicated."""
    tree = copy.deepcopy(tree)
    found = list(entry_paths(tree))
    *path, last = rng.choice(found)
    within = tree
    for key in path:
        within = within[key]
    kind = rng.choice(["delete", "strange", "strange", "nudge", "exchange", "double", "rename", "truncate"])
    if kind == "delete":
        del within[last]
    elif kind == "strange":
        within[last] = copy.deepcopy(rng.choice(STRANGE))
    elif kind == "nudge" and isinstance(within[last], int | float) and not isinstance(within[last], bool):
        within[last] = rng.choice([within[last] + 1, -within[last], within[last] * 1e12, within[last] + 0.5])
    elif kind == "exchange":
        *other, key = rng.choice(found)
        from_there = tree
        for step in other:
            from_there = from_there[step]
        within[last] = copy.deepcopy(from_there[key])
    elif kind == "double" and isinstance(within, list):
        within.append(copy.deepcopy(within[last]))
    elif kind == "rename" and isinstance(within, dict):
        within[f"{last}_"] = within.pop(last)
    elif isinstance(within[last], list | str):
        within[last] = within[last][: len(within[last]) // 2]
    else:
        within[last] = copy.deepcopy(rng.choice(STRANGE))
    return tree


def damaged_text(text, rng):
    if rng.random() < 0.9:
        # Within a list, so that the root can be exchanged as well.
        return json.dumps((damaged([json.loads(text)], rng) or [None])[0])
    at = rng.randrange(len(text))
    return rng.choice([text[:at], text[:at] + rng.choice('[]{}",:0x') + text[at + 1 :], "[" * 10**5])


def damaged_dataset(dataset, rng):
    changed = dataset.copy(deep=True)
    kind = rng.choice(["system"] * 8 + ["method"] * 5 + ["t_span", "attribute", "attribute", "variable", "variable"])
    if kind in ("system", "method", "t_span"):
        changed.attrs[kind] = damaged_text(changed.attrs[kind], rng)
    elif kind == "attribute":
        key = rng.choice(["system", "method", "step", "save_every", "watch", "attitude_carried", "t_span", "steps"])
        if rng.random() < 0.3:
            del changed.attrs[key]
        else:
            value = rng.choice([*STRANGE, np.float64(0.3), np.int64(10**6), np.array([1.0, 2.0]), b"bytes"])
            changed.attrs[key] = copy.deepcopy(value)
    else:
        name = rng.choice([name for name in ("x0", "attitude0") if name in changed])
        act = rng.choice(["drop", "cut", "nan", "text", "transpose", "swap"])
        if act == "drop":
            changed = changed.drop_vars(name)
        elif act == "cut":
            changed = changed.isel({rng.choice(changed[name].dims): slice(rng.choice([0, 1, 2]))})
        elif act == "nan":
            changed[name].values.flat[0] = rng.choice([np.nan, np.inf, 1e308])
        elif act == "text":
            changed[name] = changed[name].astype(str)
        elif act == "transpose":
            changed[name] = changed[name].transpose()
        else:
            changed[name] = changed[rng.choice(["x", "energy", "time", "drift"])]
    return changed


def outcome(dataset):
    """Return the refusal of a dataset, or an empty string; other exceptions and warnings are failures."""
    try:
        co.results.rebuild(dataset)
        return ""
    except co.IntegrationError:
        return "failed"
    except ValueError as refused:
        return str(refused)


@pytest.mark.thinned(6)
@pytest.mark.parametrize("name", RUNS)
@pytest.mark.filterwarnings("ignore:inertia")  # moments are damaged too
@pytest.mark.filterwarnings("default::coadjoint.LongWait")
def test_random_damage_is_refused(name):
    refusals = 0
    for seed in SEEDS:
        rng = random.Random(f"{name} {seed}")
        changed = damaged_dataset(stored(name), rng)
        with bounded_work():
            message = outcome(changed)
        refusals += len(message) > 10
        assert len(message) < 500 and message.isprintable(), (seed, message)
    assert refusals > len(SEEDS) // 4


# Damage of each entry of a system.


def system_with(name, change):
    """Return a dataset with a changed record of its system."""
    record = json.loads(stored(name).attrs["system"])
    change(record)
    return stored(name).assign_attrs(system=json.dumps(record))


def read(dataset):
    return co.results.solution_inputs(dataset)


def dimensions_in(record, path=()):
    """Yield the path of each dimension in a record."""
    for key, inner in record.items() if isinstance(record, dict) else enumerate(record):
        if key in ("dim", "N"):
            yield *path, key
        elif key != "parameters" and isinstance(inner, dict | list):
            yield from dimensions_in(inner, (*path, key))


NAMES = {"casimirs", "integrals", "layout", "parameters"}
"""Tables whose keys are names."""


def tables_of(record, name="system"):
    """Yield the tables of a record that have a fixed set of keys."""
    if isinstance(record, dict):
        if name not in NAMES:
            yield name, record
        for key, inner in record.items():
            yield from tables_of(inner, key) if name != "parameters" else ()
    elif isinstance(record, list):
        for inner in record:
            yield from tables_of(inner, name)


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", SYSTEMS)
def test_every_dimension_and_key_of_a_record_is_checked(name):
    """Dimensions of fewer entries too; keys of a later version may matter, and none is replaced by a default."""
    record = json.loads(stored(name).attrs["system"])
    for *path, last in dimensions_in(record):
        for change in (-1, 1, 1000):

            def other(changed, path=path, last=last, change=change):
                functools.reduce(operator.getitem, path, changed)[last] += change

            with refused(ValueError, "system"):
                read(system_with(name, other))
    optional = {"casimirs", "integrals", "representation", "layout", "linear", "second_stream", "layers", "members"}
    for number, (place, table) in enumerate(tables_of(record)):
        with refused(ValueError, "color"):
            read(system_with(name, lambda r, k=number: list(tables_of(r))[k][1].update(color="red")))
        for key in table.keys() - optional:
            if (place == "forces" and key != "name") or (
                name.startswith("a batch") and (place, key) == ("system", "name")
            ):
                continue  # forces may have defaults, and a batch is named by its members
            with pytest.raises(ValueError):
                read(system_with(name, lambda r, k=number, key=key: list(tables_of(r))[k][1].pop(key)))


DAMAGED = [
    ("a matrix", lambda r: r.pop("hamiltonian"), "system has no 'hamiltonian'"),
    ("a matrix", lambda r: r["hamiltonian"].pop("constant"), "system.hamiltonian has no 'constant'"),
    ("a matrix", lambda r: r["algebra"].update(dim=10**12), "system.algebra"),
    ("a matrix", lambda r: r["algebra"]["constants"].append([0, 1, 7, 1.0]), "system.algebra.constants"),
    ("a matrix", lambda r: r["algebra"]["constants"].append([0, 0, 2, 1.0]), "system.algebra"),
    ("a matrix", lambda r: r["hamiltonian"]["M"].append([0, 0, 1.0]), "system.hamiltonian.M"),
    ("a matrix", lambda r: r["hamiltonian"].update(M=[[1, 0, 0.3]]), "each pair once"),
    ("a matrix", lambda r: r["hamiltonian"].update(M=[[0.5, 1, 0.3]]), "system.hamiltonian.M"),
    ("a matrix", lambda r: r["hamiltonian"].update(M=[[0, 1, "1/0"]]), "system.hamiltonian.M"),
    ("a matrix", lambda r: r["hamiltonian"].update(constant="9" * 400 + "/1"), "system.hamiltonian.constant"),
    ("a matrix", lambda r: r["hamiltonian"].update(kind="cubic"), "system.hamiltonian.kind is 'cubic'"),
    ("a matrix", lambda r: r.update(sign=0), "sign"),
    ("a polynomial", lambda r: r["hamiltonian"].update(monomials=[[1, [10**10, 0, 0]]]), "system.hamiltonian.mon"),
    ("a polynomial", lambda r: r["hamiltonian"].update(monomials=[["1e999", [0, 0, 0]]]), "system.hamiltonian.mon"),
    ("a polynomial", lambda r: r["hamiltonian"].update(monomials=[[1, [2, 0, 0]], [2, [2, 0, 0]]]), "monomials[1][1]"),
    ("a polynomial", lambda r: r["hamiltonian"].update(monomials=[[1, [1000, 25, 0]]]), "1024"),
    ("a polynomial", lambda r: r["hamiltonian"].update(monomials=[[1, [1, 0]]]), "monomials[0][1]"),
    ("a polynomial", lambda r: r.update(hamiltonian={"kind": "sum", "summands": []}), "at least one Hamiltonian"),
    ("a polynomial", lambda r: r.update(integrals={"x": [[1, [0, 1, 0]]]}), "'x'"),
    ("pieces", lambda r: r["hamiltonian"].update(pieces=[r["hamiltonian"]["pieces"]] * 2), "system.hamiltonian.pie"),
    ("a representation", lambda r: r["representation"].update(size=10**9), "system.representation"),
    ("tuned", lambda r: r["parameters"].update(inertia=None), "system.parameters"),
    ("tuned", lambda r: r.update(name="rigid_bodi"), "'rigid_bodi'"),
    ("a batch", lambda r: r["members"].clear(), "system.members"),
    ("a batch of ready made", lambda r: r["members"][1].pop("name"), "system.members[1] has no 'name'"),
    ("forces", lambda r: r["forces"][1].update(torqe=r["forces"][1].pop("torque")), "did you mean 'torque'"),
    ("forces", lambda r: r.update(forces=[]), "no force"),
    ("a formula", lambda r: formula_in(r).update(text="cos(x1"), "hamiltonian"),
    ("a formula", lambda r: formula_in(r).update(text="__import__('os')"), "hamiltonian"),
    ("a formula", lambda r: formula_in(r).update(text="x1+" * 100_000 + "x1"), "hamiltonian"),
    ("a formula", lambda r: formula_in(r).update(text=1), "hamiltonian"),
    ("a formula", lambda r: formula_in(r).update(names=["x1"]), "hamiltonian"),
    ("a formula", lambda r: formula_in(r).update(parameters={"x1": 1.0}), "hamiltonian"),
    ("a formula", lambda r: formula_in(r).update(factors=["x"]), "hamiltonian"),
    ("weights", lambda r: r["matrices"].update(kind="sq"), "system.matrices"),
    ("weights", lambda r: r["matrices"].update(N=1), "system.matrices.N is 1"),
    ("weights", lambda r: r["matrices"].update(kind="sum"), "blocks"),
    ("weights", lambda r: r.update(matrices={"kind": "gl", "N": 4096, "q": 0}), "system"),
    ("weights", lambda r: r.update(stream={}), "system.stream has no 'main'"),
    ("weights", lambda r: r["stream"]["weights"][0].__setitem__(1, 7.0), "system.stream: weights"),
    ("weights", lambda r: r.update(linear=[[[1.0, 0.0], [0.0, 1.0]]]), "system.linear"),
    ("weights", lambda r: r.update(energy_sign=0), "energy_sign"),
    ("weights", lambda r: r.update(powers=-1), "system.powers"),
]  # fmt: skip


def formula_in(record):
    """Return the table of the formula in the record of a sum."""
    return next(table for _, table in tables_of(record) if "text" in table)


@pytest.mark.thinned(1)
@pytest.mark.parametrize("number", range(len(DAMAGED)))
def test_a_damaged_entry_is_named(number):
    name, change, said = DAMAGED[number]
    with refused(ValueError, "system", said) as caught, bounded_work():
        read(system_with(name, change))
    assert len(str(caught.value)) < 500 and str(caught.value).isprintable()


def test_monomials_of_few_coordinates_are_checked():
    """As they are stored of spins with couplings of degree four: pairs of a coordinate and an exponent."""

    def read_with(*monomials):
        sparse = {"kind": "sparse polynomial", "dim": 3, "monomials": list(monomials)}
        return read(system_with("a polynomial", lambda r: r.update(hamiltonian=sparse)))

    square, product = [[0, 2]], [[0, 1], [2, 3]]
    found = read_with([1.5, square], [2.0, product])["system"]
    assert found.energy(X) == pytest.approx(1.5 * X[0] ** 2 + 2.0 * X[0] * X[2] ** 3, rel=1e-15)
    for second in (square, product[::-1], [[0, 1], [0, 1]], [[3, 1]], [[0, 0]], [[0, 600], [1, 600]], [[0, -1]], [[0]]):
        with refused(ValueError, "system.hamiltonian.monomials[1][1]"):
            read_with([1.0, square], [2.0, second])


@pytest.mark.parametrize(
    ("key", "inside", "beyond", "said"),
    [
        ("order", nested_lists(30), nested_lists(31), "nested deeper than 32"),
        ("name", "x" * 2000, "x" * 2001, "2000 letters"),
        ("order", 2**62, 2**62 + 1, "method.parameters.order is"),
        ("order", -(2**62), -(2**62) - 1, "method.parameters.order is"),
        ("order", 1e308, float("inf"), "method.parameters.order is"),
        ("order", [None], [float("nan")], "method.parameters.order[0] is nan"),
    ],
)
def test_entries_are_of_bounded_depth_and_size(key, inside, beyond, said):
    """Those inside are refused as well, by the scheme; depth is that of lists with the tables around them."""
    for value, outside in ((inside, False), (beyond, True)):
        method = {"name": "Splitting", "parameters": {"order": value}}
        text = json.dumps({**method, "name": value} if key == "name" else method)
        with pytest.raises(ValueError) as caught:
            read(stored("a matrix").assign_attrs(method=text))
        assert (said in str(caught.value)) == outside, caught.value


def test_a_contradictory_span_is_refused():
    """Repeating it would take days."""
    changed = stored("a matrix").assign_attrs(t_span="[0.0, 1e12]")
    with refused(ValueError, "steps is 4", "16000000000000"):
        co.results.rebuild(changed)
    with refused(ValueError, "system"):
        co.results.rebuild(changed.drop_attrs(deep=False))


@pytest.mark.parametrize("named", [("part", "column", "row"), ("column", "part", "row"), ("column", "row", "part")])
def test_states_are_read_by_the_names_of_their_dimensions(named):
    sol = co.integrate(SPHERE, state_of(SPHERE), (0.0, 0.5), 0.25)
    dataset = sol.to_xarray().drop_vars("part")
    again = co.results.rebuild(dataset.assign(x0=dataset["x0"].transpose(*named)))
    np.testing.assert_array_equal(again.x0, sol.x0)
    np.testing.assert_array_equal(again.x, sol.x)
