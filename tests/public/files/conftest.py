"""Fixtures of the tests of files."""

import pytest

from configuration_files import ConfigurationFiles


@pytest.fixture
def files(tmp_path, monkeypatch, capsys):
    """Return configuration files in a working folder of their own."""
    monkeypatch.chdir(tmp_path)
    return ConfigurationFiles(tmp_path, capsys)
