"""The compiled libraries: which one is loaded, what is wrong with an installation, and what Python and they share."""

import os
import subprocess
import sys
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import pytest

import coadjoint as co
from coadjoint.kernels import interface as description
from coadjoint.kernels import library
from coadjoint.kernels.loop import Extent, Layout, NamedArrays
from coadjoint.kernels.tables import compiled
from coadjoint.kernels.tables.field import GroupField
from refusals import refused

RUN = """
import coadjoint as co
co.integrate(co.systems.rigid_body((1, 2, 3)), [0.1, 1.0, 0.2], (0, 1), 0.1)
"""


def refusal_of(call):
    with pytest.raises(ImportError) as refusal:
        call()
    message = str(refusal.value)
    assert "\n" not in message
    return message


def test_missing_kernels(monkeypatch, tmp_path):
    monkeypatch.setattr(library, "FOLDER", tmp_path)
    message = refusal_of(library.kernels.__wrapped__)
    assert f"are missing from {tmp_path}: install the package with a C++ compiler at hand" in message


def test_kernels_that_cannot_be_loaded(monkeypatch, tmp_path):
    monkeypatch.setattr(library, "FOLDER", tmp_path)
    for name in ("_processor", "_kernels"):
        (tmp_path / f"{name}{library.SUFFIX}").write_bytes(b"of another machine")
    message = refusal_of(library.kernels.__wrapped__)
    assert f"{library.SUFFIX} cannot be loaded (" in message and "build them again" in message


def installed(monkeypatch, folder, processor, built, asked=None):
    """Pretend that this processor has a level, that some are built, and that one is asked for."""
    monkeypatch.setattr(library, "processor_level", lambda: processor)
    monkeypatch.setattr(library, "FOLDER", folder)
    for level in built:
        (folder / f"_kernels_v{level}{library.SUFFIX}").touch()
    if asked is None:
        monkeypatch.delenv("COADJOINT_LEVEL", raising=False)
    else:
        monkeypatch.setenv("COADJOINT_LEVEL", asked)


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    ("processor", "built", "asked", "taken"),
    [
        (4, (4, 3, 1), None, 4),
        (3, (4, 3, 1), None, 3),
        (1, (4, 3, 1), None, 1),
        (4, (3, 1), None, 3),
        (4, (1,), None, 1),
        (4, (4, 3, 1), "v1", 1),
        (3, (3, 1), "v1", 1),
        (None, (), None, None),
    ],
)
def test_the_highest_level_that_is_built_and_usable(monkeypatch, tmp_path, processor, built, asked, taken):
    installed(monkeypatch, tmp_path, processor, built, asked)
    assert library.level_in_use() == taken


INDEX = np.zeros(2, dtype=np.uint32)


@pytest.mark.parametrize(
    ("value", "was"),
    [(np.zeros(2, dtype=np.float32), "float32"), (np.zeros(4)[::2], "float64"), (np.zeros(2, dtype=int), "int64")],
)
def test_arrays_that_the_kernels_do_not_read(value, was):
    with pytest.raises(TypeError) as refusal:
        compiled.as_structure(GroupField(1, 2, INDEX, INDEX, INDEX, value))
    assert str(refusal.value) == f"GroupField.value is {was}, not a contiguous float64"


class Unknown(NamedTuple):
    size: int


def test_tables_of_another_version():
    assert "have no table Unknown: they were built for another version" in refusal_of(
        lambda: compiled.as_structure(Unknown(1))
    )


def contents(folder):
    return {
        path: path.stat().st_mtime_ns
        for path in folder.rglob("*")
        if "__pycache__" not in path.parts and path.is_file()
    }


@pytest.mark.long
def test_a_run_writes_nothing_into_the_installation():
    folder = Path(co.__file__).parent
    before = contents(folder)
    environment = os.environ | {"PYTHONPATH": str(folder.parent)}
    subprocess.run([sys.executable, "-B", "-c", RUN], env=environment, check=True)
    assert contents(folder) == before


def text():
    return description.interface_text()


# What is changed in the description, and what the refusal names: the constant, our value and theirs.
CHANGES = {
    "kind of block": ("SHEAR 3;", "SHEAR 7;", ["Kind.SHEAR is 3", "7"]),
    "new kind of block": ("SERIES 5;", "SERIES 5;TWIST 6;", ["Kind", "TWIST"]),
    "layout of a block": ("CUBIC_HEADER 6;", "CUBIC_HEADER 4;", ["Limit.CUBIC_HEADER is 6", "4"]),
    "limit": ("MOST_SUBSTEPS 4096;", "MOST_SUBSTEPS 8192;", ["Limit.MOST_SUBSTEPS is 4096", "8192"]),
    "limit that is gone": ("MOST_LANES 32;", "", ["Limit.MOST_LANES", "missing"]),
    "status": ("UNDEFINED 3;", "", ["Status.UNDEFINED", "missing"]),
    "outcome": ("NO_MEMORY -2;", "", ["Outcome.NO_MEMORY", "missing"]),
    "list of codes": ("codes Solver:", "codes Way:", ["Solver.EXPLICIT", "missing"]),
    "array of a run": ("numbers worst ", "numbers worse ", ["state", "worst", "worse"]),
    "array that is gone": ("numbers values points * members * invariants;", "", ["saved", "values"]),
    "type of an array": ("integers status", "bytes status", ["state.status", "integers"]),
    "axis of an array": ("members * memory_size;", "members * room;", ["state.memory", "axes"]),
}


@pytest.mark.parametrize("change", CHANGES)
def test_kernels_of_another_mind_are_refused(change, monkeypatch):
    old, new, said = CHANGES[change]
    assert text().count(old) == 1
    kernel_interface = text().replace(old, new)
    monkeypatch.setattr(description, "interface_text", lambda: kernel_interface)
    with refused(ImportError, *said, "built for another version") as refusal:
        description.kernel_interface.__wrapped__()
    assert "\n" not in str(refusal.value)


def test_a_package_of_another_mind_is_refused(monkeypatch):
    ours = {**description.PYTHON_CODES, "Limit": {"CUBIC_HEADER": 6, "MOST_SUBSTEPS": 2048}}
    monkeypatch.setattr(description, "PYTHON_CODES", MappingProxyType(ours))
    with refused(ImportError, "Limit.MOST_SUBSTEPS is 2048", "4096"):
        description.kernel_interface.__wrapped__()


def test_fields_of_another_table_are_refused(monkeypatch):
    kernel_interface = description.parse_description(
        text().replace("table GroupField:integer size;integer entries;", "table GroupField:")
    )
    monkeypatch.setattr(description, "kernel_interface", lambda: kernel_interface)
    with refused(ImportError, "GroupField", "entries", "size"):
        compiled.structure_of_table.__wrapped__(GroupField)


def test_kernels_without_a_description_are_refused(monkeypatch):
    monkeypatch.setattr(description, "kernels", lambda: object())
    with refused(ImportError, "another version"):
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
    monkeypatch.setattr("coadjoint.kernels.loop.kernel_interface", lambda: kernel_interface)
    after = Layout(extent)
    assert list(before.saved.shapes) == ["x", "group", "values"] and next(iter(after.saved.shapes)) == "group"
    assert before.saved.shapes["x"] == after.saved.shapes["x"] == (2, 3, 4)
    assert before.saved.size == after.saved.size == 2 * 3 * (4 + 9 + 2)
    assert before.state.shapes["worst"] == (3, description.limit("TENTHS"), 2)
    assert NamedArrays(before.state)["status"].dtype == np.int64
