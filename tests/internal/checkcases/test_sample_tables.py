"""Bounds of the size of files of samples, and their optional package."""

import pytest

import coadjoint as co
from refusals import refused


@pytest.fixture(scope="module")
def case():
    return co.checkcases.get("free_body")


def test_parquet_without_its_package_names_the_extra(case, tmp_path, monkeypatch):
    (tmp_path / "mine.parquet").write_bytes(b"PAR1")
    monkeypatch.setattr("coadjoint.optional_packages.installed", lambda name: name != "pyarrow")
    with refused(ModuleNotFoundError, "pyarrow", "coadjoint[parquet]"):
        case.compare(tmp_path / "mine.parquet")


@pytest.mark.parametrize("bytes_and_allowed", [(2**30 + 1, False), (2**30, True)])
def test_the_size_of_a_file_is_bounded(case, tmp_path, monkeypatch, bytes_and_allowed):
    """A sparse file, of which nothing is read."""
    size, allowed = bytes_and_allowed
    with open(tmp_path / "large.csv", "wb") as file:
        file.truncate(size)
    seen = []
    monkeypatch.setattr("coadjoint.regular_files.check_available_memory", lambda *_: seen.append(1) or 1 / 0)
    with refused(ZeroDivisionError if allowed else ValueError, "division" if allowed else "bytes"):
        case.compare(tmp_path / "large.csv")
    assert bool(seen) == allowed
