"""Folders in which other users can change or replace files are recognised, wherever they lie above a file."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

import coadjoint as co
from coadjoint.extras import installed
from coadjoint.private_folders import check_private, private_folder

STRANGER = 65534
AS_ROOT = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder to another user")


@pytest.fixture
def folders(tmp_path):
    """Three folders in each other, all safe."""
    path = tmp_path.resolve()
    try:
        check_private(path)
    except PermissionError as reason:
        pytest.skip(f"the tests themselves are in a folder that others can change: {reason}")
    found = [path / "a", path / "a" / "b", path / "a" / "b" / "c"]
    for folder in found:
        folder.mkdir(mode=0o700)
        folder.chmod(0o755)
    check_private(found[-1])
    return found


@pytest.mark.parametrize("place", [0, 1, 2])
@pytest.mark.parametrize(
    ("mode", "safe"),
    [(0o700, True), (0o755, True), (0o500, True), (0o720, False), (0o702, False), (0o777, False), (0o1777, None)],
)
def test_modes(folders, place, mode, safe):
    """In a sticky folder others cannot replace a folder, but they can add files."""
    folders[place].chmod(mode)
    if safe is None:
        safe = place < 2
    if safe:
        check_private(folders[-1])
    else:
        with pytest.raises(PermissionError, match=f"{folders[place]} can be changed by other users, mode {mode:o}"):
            check_private(folders[-1])


@AS_ROOT
@pytest.mark.parametrize("place", [0, 1, 2])
@pytest.mark.parametrize("mode", [0o700, 0o755, 0o1777])
def test_owners(folders, place, mode):
    os.chown(folders[place], STRANGER, STRANGER)
    folders[place].chmod(mode)
    with pytest.raises(PermissionError, match=f"{folders[place]} belongs to another user"):
        check_private(folders[-1])


def test_links_and_files(folders):
    link, file = folders[0] / "link", folders[0] / "file"
    link.symlink_to(folders[1])
    file.touch(mode=0o600)
    for path in (link, link / "c", file):
        with pytest.raises(PermissionError, match="is not a folder"):
            check_private(path)
    with pytest.raises(FileNotFoundError):
        check_private(folders[0] / "none")


def test_temporary_folders(folders, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(folders[-1]))
    old = os.umask(0)
    try:
        for mode in (0o755, 0o1777):
            folders[-1].chmod(mode)
            with private_folder() as own:
                assert own.parent == folders[-1] and own.stat().st_mode & 0o777 == 0o700
            assert not own.exists()
    finally:
        os.umask(old)
    folders[-1].chmod(0o777)
    with pytest.raises(RuntimeError, match=r"can be changed by other users, mode 777\); set TMPDIR"):
        with private_folder():
            pass
    assert list(folders[-1].iterdir()) == []
    monkeypatch.setattr(tempfile, "tempdir", str(folders[-1] / "none"))
    with pytest.raises(RuntimeError, match="set TMPDIR"):
        with private_folder():
            pass


@pytest.mark.skipif(not installed("distributed"), reason="distributed is not installed")
def test_workers_are_not_started_where_others_replace_files(folders, monkeypatch):
    """A worker imports from its temporary folder."""
    monkeypatch.setattr(tempfile, "tempdir", str(folders[-1]))
    folders[1].chmod(0o777)
    with pytest.raises(RuntimeError, match="set TMPDIR to a folder of your own"):
        co.ensemble(co.systems.rigid_body((1, 2, 3)), [[1.0, 0.2, 0.5]], (0, 1), 0.1, workers=1)


@AS_ROOT
def test_folders_of_another_user_than_root(tmp_path):
    """What root owns is safe for everybody, and what another user owns is not safe for root."""
    code = (
        "import os, sys; from pathlib import Path; from coadjoint.private_folders import check_private; "
        f"os.setuid({STRANGER}); check_private(Path(sys.argv[1]))"
    )
    own = Path(tempfile.mkdtemp(dir="/tmp")).resolve()
    try:
        os.chown(own, STRANGER, STRANGER)
        paths = os.environ | {"PYTHONPATH": str(Path(co.__file__).parents[1])}
        assert subprocess.run([sys.executable, "-c", code, str(own)], env=paths, timeout=60).returncode == 0
        with pytest.raises(PermissionError, match="belongs to another user"):
            check_private(own)
    finally:
        own.rmdir()
