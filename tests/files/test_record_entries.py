"""Entries of records: accepted values of each kind; no entry is ignored, exchanged or lost."""

import copy
import functools
import json
import operator
from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.records.entries import MAX_CHARACTERS, MAX_DEPTH, MAX_INTEGER, Entry, as_value_errors, parsed
from coadjoint.files.records.records import record_of, safe_name, system_of
from coadjoint.systems.matrices.streams import Circulants, DiagonalSolve, Inverse, Weights
from coadjoint.systems.matrices.two_layer_system import TwoLayerSystem
from coadjoint.systems.protocol import unforced
from served import state_of

INFINITE, NAN = float("inf"), float("nan")
STRANGE = (
    None, True, False, -1, 0, 1, 2, 3, 2.5, -2.5, 1e308, INFINITE, -INFINITE, NAN, 2**62, 2**62 + 1, -(2**62), 10**400,
    np.int64(2), np.float64(2.5), np.bool_(True), "", "a", "1/3", "-2/7", "1/0", "1e5", "1/3x", "x" * MAX_CHARACTERS,
    "x" * (MAX_CHARACTERS + 1), [], {}, [0, 1], [0, 1, 2], [0, 1, 3], [0, True, 2], [True, False, True],
    [np.bool_(True)] * 3, [[True]] * 3, [0, 1, -1], [0.5, 1, 2],
    [0, 1, NAN],
    [0, 1, INFINITE], [0, 1, -INFINITE], ["a", 1, 2], [[0, 1], [2, 3]], [0, [1], 2], (0, 1, 2), {"a": 1}, [None, 1, 2],
)  # fmt: skip
WHOLE, REAL = (int, np.int64), (int, float, np.int64, np.float64)


def is_whole(value):
    return isinstance(value, WHOLE) and not isinstance(value, bool)


def is_number(value):
    return isinstance(value, REAL) and not isinstance(value, bool) and abs(value) <= 1e308


def is_list(value, length=None):
    return isinstance(value, list) and (length is None or len(value) == length)


# For each kind of entry: the reader, a predicate of accepted values, and the type of the result.
READERS = {
    "a whole number": (lambda e: e.integer(), lambda v: is_whole(v) and 0 <= v <= MAX_INTEGER, int),
    "from 1 up": (lambda e: e.integer(1), lambda v: is_whole(v) and 1 <= v <= MAX_INTEGER, int),
    "from -1 to 1": (lambda e: e.integer(-1, 1), lambda v: is_whole(v) and -1 <= v <= 1, int),
    "a number": (lambda e: e.number(), is_number, float),
    "a flag": (lambda e: e.flag(), lambda v: isinstance(v, (bool, np.bool_, *WHOLE)) and v in (0, 1), bool),
    "text": (lambda e: e.text(), lambda v: isinstance(v, str) and len(v) <= MAX_CHARACTERS, str),
    "a table": (lambda e: list(e.table()), lambda v: isinstance(v, dict), list),
    "a list": (lambda e: [one.value for one in e.entries()], is_list, list),
    "a list of three": (lambda e: [one.value for one in e.entries(3)], lambda v: is_list(v, 3), list),
    "three up to 2": (
        lambda e: e.integers(2, 3), lambda v: is_list(v, 3) and all(type(k) is int and 0 <= k <= 2 for k in v), list
    ),
    "any up to 2": (
        lambda e: e.integers(2), lambda v: is_list(v) and all(type(k) is int and 0 <= k <= 2 for k in v), list
    ),
    "three numbers": (
        lambda e: e.numbers(3).tolist(),
        lambda v: is_list(v, 3)
        and all(isinstance(k, int | float) and not isinstance(k, bool) and is_number(float(k)) for k in v), list
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", READERS)
def test_entries_accept_valid_values_only(kind):
    read, accepted, result = READERS[kind]
    for value in STRANGE:
        entry = Entry(copy.deepcopy(value), "place")
        if accepted(value):
            found = read(entry)
            plain = list(value) if isinstance(value, dict) else value
            assert found == (float(plain) if result is float else plain) and type(found) is result, (kind, value)
            # True == 1, so types are compared as well; numbers are read as floats.
            if result is list and kind != "three numbers":
                assert [type(one) for one in found] == [type(one) for one in value], (kind, value)
        else:
            with pytest.raises(ValueError, match=r"^place is .*; it must be "):
                read(entry)


def test_exact_numbers():
    for value, found in ((3, 3), (2.5, 2.5), ("1/3", Fraction(1, 3)), ("-2/7", Fraction(-2, 7)), ("4/2", 2)):
        assert Entry(value, "c").exact() == found and type(Entry(value, "c").exact()) in (int, float, Fraction)
    for value in (True, None, NAN, INFINITE, 10**400, "1/0", "1", "1/3x", "x1/3", "1/-3", "1e5", f"{'9' * 400}/1", [1]):
        with pytest.raises(ValueError, match=r"^c is .*; it must be a"):
            Entry(value, "c").exact()


def test_row_indices_are_bounded():
    rows = [[0, 1, 0.5], [1, 2, -1e300], [1, 0, 2]]
    assert Entry(rows, "M").rows(2, 3).tolist() == rows
    assert Entry([], "M").rows(2, 3).shape == (0, 3)
    for wrong in (
        [2, 0, 1.0], [0, 3, 1.0], [-1, 0, 1.0], [0, -1, 1.0], [0.5, 0, 1.0], [0, 1.5, 1.0], [0, 0, NAN],
        [0, 0, INFINITE], [0, 0, -INFINITE], [0, 0], [0, 0, 1.0, 1.0], ["a", 0, 1.0], [None, 0, 1.0],
        [True, 0, 1.0], [0, 0, True],
    ):  # fmt: skip
        for arguments in ([wrong], [*rows, wrong], [wrong, *rows]):
            with pytest.raises(ValueError, match=r"^M is .*; it must be rows of 2"):
                Entry(arguments, "M").rows(2, 3)
    for value in (None, 0, "", {}, (), tuple(rows), [[True, False, True]], [[False, True, True], [True, True, False]]):
        with pytest.raises(ValueError, match=r"^M is "):
            Entry(value, "M").rows(2, 3)


def nested(depth, kind):
    value = 1.0
    for _ in range(depth):
        value = [value] if kind == "list" else {"a": value}
    return value


@pytest.mark.parametrize("kind", ["list", "table"])
def test_depth_is_bounded(kind):
    assert Entry(nested(MAX_DEPTH, kind), "place").plain() == nested(MAX_DEPTH, kind)
    with pytest.raises(ValueError, match=f"is nested deeper than {MAX_DEPTH} lists and tables"):
        Entry(nested(MAX_DEPTH + 1, kind), "place").plain()


def test_plain_values_are_unconverted():
    value = {"a": [1, 2.5, None, True, "text", {"b": []}], "c": -(2**62), "d": 2**62, "e": False, "f": [0, True, 2]}
    found = Entry(value, "place").plain()
    assert found == value and json.dumps(found) == json.dumps(value)
    for wrong, place in (({"a": [1, NAN]}, "a[1]"), ({"a": {"b": 10**30}}, "a.b"), ({"a": [[], -INFINITE]}, "a[1]"),
                         ({"a": "x" * (MAX_CHARACTERS + 1)}, "a"), ({"a": (1,)}, "a")):  # fmt: skip
        with pytest.raises(ValueError) as refused:
            Entry(wrong, "place").plain()
        assert str(refused.value).startswith(f"place.{place} is ")


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (ValueError("no"), "s.a: no"),
        (TypeError("no\nnumber"), "s.a: no number"),
        (ZeroDivisionError("no"), "s.a: ZeroDivisionError: no"),
        (RecursionError("deep"), "s.a: RecursionError: deep"),
        (MemoryError("full"), "s.a: MemoryError: full"),
    ],
)
def test_library_errors_have_the_path(error, message):
    with pytest.raises(ValueError) as raised, as_value_errors(Entry({}, "s.a")):
        raise error
    assert str(raised.value) == message
    with np.errstate(all="raise"), as_value_errors(Entry({}, "s.a")):
        assert np.float64(1e308) * 10 == INFINITE


def test_attributes_are_parsed_as_json():
    assert parsed('{"a": [1, null]}', "s").plain() == {"a": [1, None]}
    for value in (3, None, b"{}", "{", "[" * 10**5):
        with pytest.raises(ValueError, match=r"^s is "):
            parsed(value, "s")


# Systems of every kind of record.
SO3, E3 = co.algebras.so(3), co.algebras.e(3)
Q = co.Quadratic([[2.0, 0.3, 0.1], [0.3, -1.5, -0.2], [0.1, -0.2, 1.0]], [0.1, -0.2, 0.3], 0.5)
P = co.Polynomial({(4, 0, 0): Fraction(1, 3), (0, 1, 1): 1})
SPLIT = co.SplitHamiltonian([((2, 0), co.Quadratic([1.0, 2.0])), ((1,), co.Polynomial({(3,): 0.5}))])
BODY = co.systems.rigid_body((1.0, 2.0, 2.5))
WEIGHTS = np.add.outer(np.arange(1.0, 4.0), np.arange(1.0, 4.0))
SPHERE, TORUS = co.systems.sphere_euler(N=3), co.systems.torus_euler(N=3)


def own(hamiltonian, **kwargs):
    free = co.LieAlgebra([], dim=3, name="free")
    return co.LiePoissonSystem(free if hamiltonian is SPLIT else SO3, hamiltonian, name="own", **kwargs)


def value(x):
    return x[0] * x[0]


def slope(x):
    return np.array([2 * x[0], 0.0, 0.0])


FUNCTION = co.Hamiltonian(value, slope)
SYSTEMS = {
    "ready made": BODY,
    "quadratic": own(Q, sign=-1),
    "polynomial": own(P, casimirs={"C": co.Polynomial({(2, 0, 0): 1, (0, 2, 0): 1, (0, 0, 2): 1})}),
    "integrals": own(co.Quadratic([1.0, 1.0, 2.0]), integrals={"x3": co.Polynomial({(0, 0, 1): 1})}),
    "split": own(SPLIT),
    "exact": own(co.Quadratic([Fraction(1, 3), Fraction(1, 2), Fraction(2)])),
    "forces": BODY.with_forces(co.forces.LinearDamping(0.1), co.forces.Torque((0.0, 0.1, 0.0))),
    "forces of own": own(Q).with_forces(co.forces.LinearDamping((0.1, 0.2, 0.3))),
    "batch": co.batch([own(Q), own(2 * P)]),
    "batch of ready made": co.batch([BODY, co.systems.rigid_body((1.0, 2.0, 2.75))]),
    "matrices": co.MatrixSystem(co.MatrixAlgebra("so", 3), Weights(WEIGHTS), name="w"),
    "matrices of a sum": co.MatrixSystem(
        co.MatrixAlgebra.sum(co.MatrixAlgebra("so", 2), co.MatrixAlgebra("gl", 1 + 1)), Weights(np.ones((4, 4)))
    ),
    "two layers": TwoLayerSystem(co.MatrixAlgebra("su", 3), SPHERE.stream, Inverse(SPHERE.stream), energy_sign=-1),
    "diagonal solve": co.MatrixSystem(
        co.MatrixAlgebra("su", 3), DiagonalSolve(SPHERE.stream.main, SPHERE.stream.beside, -0.5)
    ),
    "circulants": co.MatrixSystem(co.MatrixAlgebra("su", 3), Circulants(2.0 * TORUS.stream.spectrum)),
    "sum": own(P + Q),
}


def through_json(system):
    return json.loads(json.dumps(record_of(system)))


@pytest.mark.parametrize("name", SYSTEMS)
def test_rebuilt_systems_have_the_same_record(name):
    record = through_json(SYSTEMS[name])
    again = system_of(record)
    assert "not_stored" not in record and json.loads(json.dumps(record_of(again))) == record
    several = name.startswith("batch")
    for one, other in zip(SYSTEMS[name] if several else [SYSTEMS[name]], again if several else [again], strict=True):
        x = state_of(one) if isinstance(one, co.MatrixSystem) else np.array([0.5, -1.25, 2.0])
        assert one.energy(x) == other.energy(x)
        assert np.array_equal(unforced(one).vector_field(x), unforced(other).vector_field(x))


@pytest.mark.parametrize("name", SYSTEMS)
def test_dimension_of_states_is_checked(name):
    system, record = SYSTEMS[name], through_json(SYSTEMS[name])
    first = system[0] if name.startswith("batch") else system
    system_of(record, first.dim)
    for wrong in (1, first.dim - 1, first.dim + 1, 10**6):
        with pytest.raises(ValueError, match=rf"dimension {first.dim}, .*dimension {wrong}$"):
            system_of(record, wrong)


def dimensions_in(record, path=()):
    """Yield the path of each dimension in a record."""
    for key, inner in record.items() if isinstance(record, dict) else enumerate(record):
        if key in ("dim", "N"):
            yield *path, key
        elif key != "parameters" and isinstance(inner, dict | list):
            yield from dimensions_in(inner, (*path, key))


NESTED = {
    "form as a Casimir": own(Q, casimirs={"C": co.Quadratic([1.0, 1.0, 1.0])}),
    "form as an integral": own(co.Quadratic([1.0, 1.0, 2.0]), integrals={"J": co.Quadratic([0.0, 0.0, 1.0])}),
    "sum of pieces and a form": co.LiePoissonSystem(co.LieAlgebra([], dim=3), SPLIT + Q),
    "sum of pieces and a polynomial": co.LiePoissonSystem(co.LieAlgebra([], dim=3), SPLIT + P),
}


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", SYSTEMS | NESTED)
def test_every_dimension_in_a_record_is_checked(name):
    """Smaller ones too, whose entries are all within the dimension."""
    record = through_json((SYSTEMS | NESTED)[name])
    for *path, last in dimensions_in(record):
        for change in (-1, 1, 1000):
            changed = copy.deepcopy(record)
            table = functools.reduce(operator.getitem, path, changed)
            table[last] += change
            with pytest.raises(ValueError, match=r"^system\b"):
                system_of(changed)


NAMES = {"casimirs", "integrals", "layout", "parameters"}


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


@pytest.mark.parametrize("name", SYSTEMS)
def test_unknown_keys_are_refused(name):
    """Keys of a later version may matter."""
    count = len(list(tables_of(through_json(SYSTEMS[name]))))
    for number in range(count):
        record = through_json(SYSTEMS[name])
        _, table = list(tables_of(record))[number]
        table["color"] = "red"
        with pytest.raises(ValueError, match="color"):
            system_of(record)


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", SYSTEMS)
def test_missing_keys_are_refused(name):
    optional = {"casimirs", "integrals", "representation", "layout", "linear", "second_stream", "layers", "members"}
    for number, (place, table) in enumerate(tables_of(through_json(SYSTEMS[name]))):
        for key in table.keys() - optional:
            if (place == "forces" and key != "name") or (
                name.startswith("batch") and (place, key) == ("system", "name")
            ):
                continue  # forces may have defaults, and a batch is named by its members
            record = through_json(SYSTEMS[name])
            del list(tables_of(record))[number][1][key]
            with pytest.raises(ValueError):
                system_of(record)


def test_unstored_functions_are_named():
    class Torque(co.forces.Torque):
        """A force of another class with a known name."""

    class Changing(Weights):
        """A stream of another class."""

    inner = own(FUNCTION)
    piece = co.SplitHamiltonian([((2, 0), co.Quadratic([1.0, 2.0])), ((1,), co.Separable({0: (np.cosh, np.sinh)}))])
    late = co.forces.Torque(lambda t: np.array([0.0, 0.0, np.sin(t)]))
    second = TwoLayerSystem(co.MatrixAlgebra("su", 3), SPHERE.stream, Changing(np.ones((3, 3))))
    lost = {
        "split": (co.LiePoissonSystem(co.LieAlgebra([], dim=3), piece), ["hamiltonian: cosh"]),
        "sum": (own(Q + FUNCTION), ["hamiltonian: value"]),
        "batch": (co.batch([own(Q), inner, own(P), inner]), ["hamiltonian: value (member 1)"]),
        "forces": (inner.with_forces(co.forces.LinearDamping(0.1), late), ["hamiltonian: value", "force: Torque"]),
        "another force": (BODY.with_forces(Torque((0.0, 0.0, 0.1))), ["force: Torque"]),
        "forces of members": (
            co.batch([BODY.with_forces(co.forces.Torque((0, 0, 1.0))), BODY.with_forces(late)]),
            ["force: Torque (member 1)"],
        ),
        "second layer": (second, ["stream: Changing"]),
        "bracket": (co.PoissonSystem(SO3.structure_matrix, Q, dim=3), ["structure matrix: structure_matrix"]),
    }
    for name, (system, wanted) in lost.items():
        record = through_json(system)
        assert len(record["not_stored"]) == len(wanted), name
        assert all(found.startswith(message) for found, message in zip(record["not_stored"], wanted, strict=True)), name
        with pytest.raises(ValueError, match="functions are not stored"):
            system_of(record)


def test_unstored_invariants_are_omitted():
    invariant = co.Invariant(lambda x: 3.0)
    casimir = co.Polynomial({(2, 0, 0): 1, (0, 2, 0): 1, (0, 0, 2): 1})
    system = own(
        co.Quadratic([1.0, 1.0, 2.0]),
        casimirs={"f": invariant, "C": casimir},
        integrals={"g": invariant, "x3": co.Polynomial({(0, 0, 1): 1})},
        exact=lambda x0, t, attitude: x0,
    )
    record = through_json(system)
    assert record["not_stored"] == ["casimir: f", "integral: g", "exact solution: <lambda>"]
    again = system_of(record)
    assert list(again.casimirs) == ["C"] and list(again.integrals) == ["x3"] and again.closed_form is None
    spiral = co.algebras.get("A3,7", a=0.5)
    assert list(spiral.casimirs_known) == ["log C"], "a function of the algebra"
    assert through_json(co.LiePoissonSystem(spiral, Q, casimirs={}))["not_stored"] == ["casimir: log C"]


def test_sums_and_monomials_are_checked():
    record = through_json(SYSTEMS["polynomial"])
    for monomials, message in (
        ([[1, [2, 0, 0]], [2, [2, 0, 0]]], r"monomials\[1\]\[1\] is .*in no other term"),
        ([[1, [1000, 25, 0]]], r"monomials\[0\]\[1\] is .*of a degree up to 1024"),
        ([[1, [1, 0]]], r"monomials\[0\]\[1\] is .*a list of 3 whole numbers"),
        ([[1, [1, 0, 0], 2]], r"monomials\[0\] is .*a list of 2 entries"),
    ):
        changed = copy.deepcopy(record)
        changed["hamiltonian"]["monomials"] = monomials
        with pytest.raises(ValueError, match=message):
            system_of(changed)
    changed["hamiltonian"] = {"kind": "sum", "summands": []}
    with pytest.raises(ValueError, match="at least one Hamiltonian"):
        system_of(changed)
    changed["hamiltonian"] = {**record["hamiltonian"], "dim": 4}
    with pytest.raises(ValueError, match=r"hamiltonian.dim is 4; it must be 3"):
        system_of(changed)
    quadratic = through_json(SYSTEMS["quadratic"])
    quadratic["hamiltonian"]["M"] = [[1, 0, 0.3]]
    with pytest.raises(ValueError, match="each pair once"):
        system_of(quadratic)


@pytest.mark.parametrize("kind", ["an algebra", "a representation", "matrices of"])
def test_memory_is_checked_before_allocation(monkeypatch, kind):
    """A short record may request arrays of any size."""
    from coadjoint.files.records import matrix_records
    from coadjoint.files.records import reconstruction as record_reading

    checked = {}

    def check_available_memory(size, what):
        checked[what.partition(" of ")[0] + (" of" if " of " in what else "")] = size

    monkeypatch.setattr(record_reading, "check_available_memory", check_available_memory)
    monkeypatch.setattr(matrix_records, "check_available_memory", check_available_memory)
    system_of(through_json(SYSTEMS["matrices"]))
    system_of(through_json(SYSTEMS["quadratic"]))
    least = {"an algebra": 3 * 8, "a representation": 3 * 3 * 3 * 8, "matrices of": 3 * 3 * 8}
    assert checked[kind] >= least[kind]


def test_complex_parameters_are_stored_as_parts():
    from coadjoint.files.records.records import _plain

    matrix = np.array([[1.0, 2.0 + 3.0j], [2.0 - 3.0j, 0.5]])
    wanted = {"real": matrix.real.tolist(), "imaginary": matrix.imag.tolist()}
    assert _plain(tuple(map(tuple, matrix.tolist()))) == wanted
    assert _plain([np.float64(1.0), [np.arange(2)], {3: (1, 2)}]) == [1.0, [[0, 1]], {"3": [1, 2]}]


@pytest.mark.parametrize(
    ("name", "safe"),
    [("x1*x3", "x1_x3"), ("", "unnamed"), ("|*|", "unnamed"), ("é2", "2"), ("²", "unnamed"), (" a  b ", "a_b"),
     ("a" * 100, "a" * 64), ("a/../b", "a_b")],
)  # fmt: skip
def test_safe_names(name, safe):
    assert safe_name(name) == safe
