"""Damaged datasets are refused by one ValueError in bounded time, or rebuild another run."""

import copy
import json
import random
from fractions import Fraction

import numpy as np
import pytest
from hostile_archives import entry_paths, nested_lists

import coadjoint as co
from coadjoint.files.datasets.export import dataset_of, rebuild
from coadjoint.methods import registry
from guards import bounded_work
from served import served

X = (0.3, 0.1, 0.5)
SEEDS = range(30)

SO3, FULL = co.algebras.so(3), [[2.0, 0.3, 0.1], [0.3, 1.5, -0.2], [0.1, -0.2, 1.0]]
OWN = co.LieAlgebra.from_brackets(
    3, {(0, 1): {1: 2.0}, (0, 2): {2: -2.0}, (1, 2): {0: 1.0}}, basis=("h", "e", "f"), name="mine"
)
QUARTIC = co.Polynomial({(4, 0, 0): 0.1, (2, 0, 0): Fraction(1, 3), (0, 2, 0): 1, (0, 0, 2): 0.25})
PIECES = co.SplitHamiltonian(
    [((0,), co.Quadratic(1.5, constant=2.0)), ((1,), co.Polynomial({(3,): 0.1})), ((2,), co.Quadratic(2.0))]
)
C2 = co.Quadratic([[0.5, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
BODY = co.systems.rigid_body((1.0, 2.0, 2.5))


def own_system(hamiltonian, algebra=OWN, casimirs=None):
    return co.LiePoissonSystem(algebra, hamiltonian, sign=-1, casimirs=casimirs, name="own")


# Each kind of Hamiltonian and each scheme, with one state and several, and both kinds of attitude.
RUNS = {
    "quadratic": (own_system(co.Quadratic(FULL, [0.1, 0.0, 0.0], 0.5), casimirs={"C": C2}), X, co.Splitting(4), False),
    "polynomial": (own_system(QUARTIC, casimirs={"C": co.Polynomial({(2, 0, 0): 0.25, (0, 1, 1): 1})}), X, None, False),
    "exact": (own_system(co.Polynomial({(2, 0, 0): Fraction(1, 3), (0, 1, 1): 1}), SO3), X, co.GaussLegendre(3), True),
    "split": (own_system(PIECES, SO3), [X, X[::-1]], co.Splitting(parts="auto", rotation="rational"), "coadjoint"),
    "ready made": (co.systems.paper_a37(), X, co.Composition(co.Splitting(2), (0.25, 0.5, 0.25)), True),
    "tuned": (BODY, X, co.Splitting.tuned(BODY, X, order=4), [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "batch": (co.batch([BODY, co.systems.rigid_body((1.0, 2.0, 2.75))]), X, co.ExplicitRungeKutta("runge2"), False),
    "batch of own": (co.batch([own_system(QUARTIC), own_system(2 * QUARTIC)]), [X, X[::-1]], co.Taylor(8), False),
    "structure": (BODY, X, co.ModifiedGaussLegendre(2), False),
    "gradient": (BODY, X, co.ModifiedGaussLegendre(freeze="gradient"), "coadjoint"),
    "iterated": (BODY, X, co.IteratedGaussLegendre(3, iterations=4), False),
    "energy": (BODY, X, co.RadauEnergy(2), False),
}
# The remaining schemes.
RUNS |= {
    name: (*served(method := registry.scheme(name).examples()[0]), method, False)
    for name in sorted(
        set(registry.names()) - {type(method or co.Splitting()).__name__ for _, _, method, _ in RUNS.values()}
    )
}


@pytest.fixture(scope="module")
def datasets():
    return {
        name: dataset_of(co.integrate(system, x0, (0.0, 1.0), 0.25, method, save_every=2, attitude=attitude))
        for name, (system, x0, method, attitude) in RUNS.items()
    }


def test_every_scheme_is_covered(datasets):
    used = {json.loads(dataset.attrs["method"])["name"] for dataset in datasets.values()}
    assert used == set(registry.names())


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
        rebuild(dataset)
        return ""
    except co.IntegrationError:
        return "failed"
    except ValueError as refused:
        return str(refused)


@pytest.mark.thinned(6)
@pytest.mark.parametrize("name", RUNS)
@pytest.mark.filterwarnings("ignore:inertia")  # moments are damaged too
def test_random_damage_is_refused(name, datasets):
    refusals = 0
    for seed in SEEDS:
        rng = random.Random(f"{name} {seed}")
        changed = damaged_dataset(datasets[name], rng)
        with bounded_work():
            message = outcome(changed)
        refusals += len(message) > 10
        assert len(message) < 500 and message.isprintable(), (seed, message)
    assert refusals > len(SEEDS) // 3


def with_attributes(dataset, **attributes):
    return dataset.assign_attrs(attributes)


def system_with(dataset, change):
    record = json.loads(dataset.attrs["system"])
    change(record)
    return with_attributes(dataset, system=json.dumps(record))


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("quadratic", lambda r: r.pop("hamiltonian"), "system has no 'hamiltonian'"),
        ("quadratic", lambda r: r["hamiltonian"].pop("constant"), "system.hamiltonian has no 'constant'"),
        ("quadratic", lambda r: r.update(hamilton=1), "system.hamilton is an unknown key"),
        ("quadratic", lambda r: r["algebra"].update(dim=10**12), "system.algebra has dimension"),
        ("quadratic", lambda r: r["algebra"]["constants"].append([0, 1, 7, 1.0]), "system.algebra.constants is [["),
        ("quadratic", lambda r: r["algebra"]["constants"].append([0, 0, 2, 1.0]), "system.algebra: "),
        ("quadratic", lambda r: r["hamiltonian"]["M"].append([0, 0, 1.0]), "system.hamiltonian.M is [["),
        ("quadratic", lambda r: r["hamiltonian"].update(kind="cubic"), "system.hamiltonian.kind is 'cubic'; it must"),
        ("quadratic", lambda r: r.update(sign=0), "system: sign"),
        ("polynomial", lambda r: r["hamiltonian"].update(monomials=[[1, [10**10, 0, 0]]]), "system.hamiltonian.mon"),
        ("polynomial", lambda r: r["hamiltonian"].update(monomials=[["1e999", [0, 0, 0]]]), "system.hamiltonian.mon"),
        ("polynomial", lambda r: r["casimirs"].update(energy=[]), "system: a Casimir is called 'energy'"),
        ("polynomial", lambda r: r.update(integrals={"x": [[1, [0, 1, 0]]]}), "system: 'x' is not an integral"),
        ("split", lambda r: r["hamiltonian"].update(pieces=[r["hamiltonian"]["pieces"]] * 2), "system.hamiltonian.pie"),
        ("exact", lambda r: r["algebra"]["representation"].update(size=10**9), "system.algebra.representation: "),
        ("tuned", lambda r: r["parameters"].update(inertia=None), "system.parameters: "),
        ("tuned", lambda r: r.update(name="rigid_bodi"), "system.parameters: unknown system 'rigid_bodi'"),
        ("batch", lambda r: r["members"].clear(), "system.members: the batch is empty"),
        ("batch", lambda r: r["members"][1].pop("name"), "system.members[1] has no 'name'"),
    ],
)  # fmt: skip
def test_damaged_system_entry_is_named(name, change, message, datasets):
    with pytest.raises(ValueError) as refused:
        rebuild(system_with(datasets[name], change))
    assert str(refused.value).startswith(message)


def test_contradictory_span_is_refused(datasets):
    # Rebuilding would take days.
    changed = with_attributes(datasets["quadratic"], t_span="[0.0, 1e12]")
    with pytest.raises(ValueError, match=r"steps is 4; it must be 4000000000000"):
        rebuild(changed)
    with pytest.raises(ValueError, match="no attribute 'system'"):
        rebuild(changed.drop_attrs(deep=False))


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({"system": "[" * 10**5}, "system is '[[[[[[[["),
        ({"system": "{"}, "system is '{', which is no JSON: Expecting property name"),
        ({"system": 3}, "system is 3; it must be text, JSON"),
        ({"method": "9" * 5000}, "method is '999"),
        ({"method": '{"name": "Splitting", "parameters": {"order": 1e400}}'}, "method.parameters.order is inf; it"),
        ({"method": '{"name": "Splitting", "parameters": {"order": 3}}'}, "method: Splitting has the orders"),
        ({"step": "0.25"}, "step is '0.25'; it must be a finite number"),
        ({"watch": 2}, "watch is 2; it must be 0 or 1"),
        ({"save_every": 0}, "save_every is 0; it must be a whole number from 1 up"),
        ({"attitude_carried": "all"}, "attitude_carried is 'all'; it must be 'none', 'coadjoint' or 'representation'"),
        ({"attitude_carried": "representation"}, "the dataset has no variable 'attitude0'"),
    ],
)  # fmt: skip
def test_damaged_attribute_is_named(attributes, message, datasets):
    with pytest.raises(ValueError) as refused:
        rebuild(with_attributes(datasets["quadratic"], **attributes))
    assert str(refused.value).startswith(message)
