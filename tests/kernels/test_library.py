"""What is wrong with an installation, or with a table, is said in one sentence; an installation is never written to."""

import os
import subprocess
import sys
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import coadjoint
from coadjoint.kernels import library, structures
from coadjoint.kernels.field import GroupField

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
        (tmp_path / f"{name}{EXTENSION_SUFFIXES[0]}").write_bytes(b"of another machine")
    message = refusal_of(library.kernels.__wrapped__)
    assert f"{EXTENSION_SUFFIXES[0]} cannot be loaded (" in message and "build them again" in message


@pytest.mark.parametrize("level", ["v5", "4", ""])
def test_level_that_the_processor_has_not(monkeypatch, level):
    monkeypatch.setattr(library, "processor_level", lambda: 3)
    monkeypatch.setenv("COADJOINT_LEVEL", level)
    message = refusal_of(library.kernels.__wrapped__)
    assert message == f"COADJOINT_LEVEL is {level!r}, but this processor can use v3, v1"


@pytest.mark.parametrize("level", [1, 3, 4])
def test_level_that_was_not_built(monkeypatch, tmp_path, level):
    monkeypatch.setattr(library, "processor_level", lambda: level)
    monkeypatch.delenv("COADJOINT_LEVEL", raising=False)
    monkeypatch.setattr(library, "FOLDER", tmp_path)
    assert f"(_kernels_v{level}) are missing" in refusal_of(library.kernels.__wrapped__)


INDEX = np.zeros(2, dtype=np.uint32)


@pytest.mark.parametrize(
    ("value", "was"),
    [(np.zeros(2, dtype=np.float32), "float32"), (np.zeros(4)[::2], "float64"), (np.zeros(2, dtype=int), "int64")],
)
def test_arrays_that_the_kernels_do_not_read(value, was):
    with pytest.raises(TypeError) as refusal:
        structures.pointed(GroupField(1, 2, INDEX, INDEX, INDEX, value))
    assert str(refusal.value) == f"GroupField.value is {was}, not a contiguous float64"


class Unknown(NamedTuple):
    size: int


def test_tables_of_another_version():
    assert "have no table Unknown: they were built for another version" in refusal_of(
        lambda: structures.pointed(Unknown(1))
    )


def contents(folder):
    return {
        path: path.stat().st_mtime_ns
        for path in folder.rglob("*")
        if "__pycache__" not in path.parts and path.is_file()
    }


def test_a_run_writes_nothing_into_the_installation():
    folder = Path(coadjoint.__file__).parent
    before = contents(folder)
    environment = os.environ | {"PYTHONPATH": str(folder.parent)}
    subprocess.run([sys.executable, "-B", "-c", RUN], env=environment, check=True)
    assert contents(folder) == before
