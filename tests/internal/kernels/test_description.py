"""What Python and the kernels share is written in the kernels; kernels of another mind are refused by name."""

import subprocess
import sys
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import pytest

import coadjoint as co
from coadjoint.kernels import interface as description
from coadjoint.kernels.arrays import Extent, Layout, NamedArrays
from coadjoint.kernels.tables import structures
from coadjoint.kernels.tables.field import GroupField
from coadjoint.methods.numerics.projection import independent, project


def text():
    return description.interface_text()


# What is changed in the description, and what the refusal names: the constant, our value and theirs.
CHANGES = {
    "kind of block": ("SHEAR 3;", "SHEAR 7;", "Kind.SHEAR is 3 in this package and 7 in the compiled kernels"),
    "new kind of block": ("SERIES 5;", "SERIES 5;TWIST 6;", "Kind: names: nothing only in this package, TWIST only"),
    "kind of term": ("POLYNOMIAL 1;", "POLYNOMIAL 3;", "TermKind.POLYNOMIAL is 1 in this package and 3"),
    "closed form of an attitude": ("SKEW 4;", "SKEW 6;", "Turn.SKEW is 4 in this package and 6"),
    "layout of a block": ("CUBIC_HEADER 6;", "CUBIC_HEADER 4;", "Limit.CUBIC_HEADER is 6 in this package and 4"),
    "limit": ("MOST_SUBSTEPS 4096;", "MOST_SUBSTEPS 8192;", "Limit.MOST_SUBSTEPS is 4096 in this package and 8192"),
    "limit that is gone": ("MOST_LANES 32;", "", "Limit.MOST_LANES is a number in this package and missing in"),
    "units of a defect": ("PROJECTION_EXACT 4;", "", "Limit.PROJECTION_EXACT is a number in this package and missing"),
    "rank of gradients": ("DEPENDENT_BITS 36;", "", "Limit.DEPENDENT_BITS is a number in this package and missing in"),
    "divergence": ("GROWTH_BITS 64;", "", "Limit.GROWTH_BITS is a number in this package and missing in the compiled"),
    "status": ("UNDEFINED 3;", "", "Status.UNDEFINED is a number in this package and missing"),
    "outcome": ("NO_MEMORY -2;", "", "Outcome.NO_MEMORY is a number in this package and missing"),
    "solver": ("GRADIENT 4;", "FIELD 4;", "Solver.GRADIENT is a number in this package and missing"),
    "list of codes": ("codes Solver:", "codes Way:", "Solver.EXPLICIT is a number in this package and missing"),
    "array of a run": (
        "numbers worst ",
        "numbers worse ",
        "arrays of a run, state: worst only in this package, worse only in the compiled kernels",
    ),
    "array that is gone": (
        "numbers values points * members * invariants;",
        "",
        "arrays of a run, saved: values only in this package, nothing only",
    ),
    "type of an array": ("integers status", "bytes status", "type of state.status is numbers or integers in this"),
    "axis of an array": ("members * memory_size;", "members * room;", "axes of state.memory is numbers of Extent and"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_kernels_of_another_mind_are_refused(change, monkeypatch):
    old, new, said = CHANGES[change]
    assert text().count(old) == 1
    kernel_interface = text().replace(old, new)
    monkeypatch.setattr(description, "interface_text", lambda: kernel_interface)
    with pytest.raises(ImportError) as refusal:
        description.kernel_interface.__wrapped__()
    message = str(refusal.value)
    assert message.startswith(said) and "built for another version; build them again" in message
    assert "\n" not in message


def test_a_package_of_another_mind_is_refused(monkeypatch):
    ours = {**description.PYTHON_CODES, "Limit": {"CUBIC_HEADER": 6, "MOST_SUBSTEPS": 2048}}
    monkeypatch.setattr(description, "PYTHON_CODES", MappingProxyType(ours))
    with pytest.raises(ImportError, match=r"Limit\.MOST_SUBSTEPS is 2048 in this package and 4096 in the compiled"):
        description.kernel_interface.__wrapped__()


def test_fields_of_another_table_are_refused(monkeypatch):
    kernel_interface = description.parse_description(
        text().replace("table GroupField:integer size;integer entries;", "table GroupField:")
    )
    monkeypatch.setattr(description, "kernel_interface", lambda: kernel_interface)
    with pytest.raises(ImportError, match="table GroupField: fields: entries, size only in this package, nothing"):
        structures.structure_of_table.__wrapped__(GroupField)


def test_kernels_without_a_description_are_refused(monkeypatch):
    monkeypatch.setattr(description, "kernels", lambda: object())
    with pytest.raises(ImportError, match="do not describe themselves: they were built for another version"):
        description.kernel_interface.__wrapped__()


@pytest.mark.long
def test_a_run_hears_the_refusal():
    """In an interpreter of its own: the first run reads the description, and no step is taken."""
    code = """
import coadjoint as co
from coadjoint.program import blocks
blocks.MOST_SUBSTEPS = 2048
try:
    co.integrate(co.systems.rigid_body((1, 2, 3)), [0.1, 1.0, 0.2], (0, 1), 0.1)
except ImportError as refusal:
    print(refusal)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("Limit.MOST_SUBSTEPS is 2048 in this package and 4096 in the compiled kernels")


def test_the_order_and_shapes_of_arrays_are_those_of_the_kernels(monkeypatch):
    """Another order in the description is another order in Python, without a line changed."""
    first, second = "numbers x points * members * size;", "numbers group points * members * square;"
    assert first + second in text()
    kernel_interface = description.parse_description(text().replace(first + second, second + first))
    extent = Extent(members=3, points=2, size=4, square=9, invariants=2, memory_size=5)
    before = Layout(extent)
    monkeypatch.setattr("coadjoint.kernels.arrays.kernel_interface", lambda: kernel_interface)
    after = Layout(extent)
    assert list(before.saved.shapes) == ["x", "group", "values"] and next(iter(after.saved.shapes)) == "group"
    assert before.saved.shapes["x"] == after.saved.shapes["x"] == (2, 3, 4)
    assert before.saved.size == after.saved.size == 2 * 3 * (4 + 9 + 2)
    assert before.state.shapes["worst"] == (3, description.limit("TENTHS"), 2)
    assert NamedArrays(before.state)["status"].dtype == np.int64


def with_limits(monkeypatch, **values):
    said = description.parse_description(text())
    changed = {**said.codes, "Limit": {**said.codes["Limit"], **values}}
    monkeypatch.setattr(description, "kernel_interface", lambda: said._replace(codes=changed))


def test_the_plain_reading_of_a_projection_has_the_limits_of_the_kernels(monkeypatch):
    body = co.systems.rigid_body((1, 2, 3))
    x = np.array([0.3, 0.5, 0.7])
    energy, near = body.hamiltonian, np.array([[1.0, 0.0], [1.0, 2.0**-17]])
    assert independent(near) == [0, 1]
    assert not np.array_equal(project([energy], x, 1.01 * x, float, 0.0).y, 1.01 * x)
    with_limits(monkeypatch, DEPENDENT_BITS=30)
    assert independent(near) == [0]
    with_limits(monkeypatch, PROJECTION_EXACT=2**53)
    assert np.array_equal(project([energy], x, 1.01 * x, float, 0.0).y, 1.01 * x)
    with_limits(monkeypatch, PROJECTION_CORRECTIONS=0)
    with pytest.raises(co.IntegrationError, match="does not converge"):
        project([energy], x, 1.01 * x, float, 0.0)


def test_the_plain_reading_of_stages_gives_up_where_the_kernels_do(monkeypatch):
    body, x = co.systems.rigid_body((1, 2, 3)), np.array([0.3, 0.5, 0.7])
    after = co.GaussLegendre(stages=2).step(body, x, 0.0, 0.1)
    with_limits(monkeypatch, GROWTH_BITS=0)
    assert np.array_equal(co.GaussLegendre(stages=2).step(body, x, 0.0, 0.1), after)
    with_limits(monkeypatch, GROWTH_BITS=-1)
    # No correction may be larger than half of the first, and the first is as large as itself.
    with pytest.raises(co.IntegrationError, match="do not converge"):
        co.GaussLegendre(stages=2).step(body, x, 0.0, 0.1)


class Pair(NamedTuple):
    size: int


def test_a_table_that_the_kernels_do_not_have_is_refused():
    with pytest.raises(ImportError, match="have no table Pair: they were built for another version"):
        structures.as_structure(Pair(1))
