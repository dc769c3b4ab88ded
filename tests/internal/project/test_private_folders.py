"""Private folders: those that other users can change are recognized at any depth."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

import coadjoint as co
from coadjoint.optional_packages import installed
from coadjoint.private_folders import check_private, private_folder
from refusals import refused

OTHER_USER = 65534
AS_ROOT = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder to another user")


@pytest.fixture
def folders(tmp_path):
    """Return three nested folders, all private."""
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
def test_writable_modes_are_refused(folders, place, mode, safe):
    """In a sticky folder others cannot replace folders, but can add files."""
    folders[place].chmod(mode)
    if safe is None:
        safe = place < 2
    if safe:
        check_private(folders[-1])
    else:
        with refused(PermissionError, folders[place], f"{mode:o}"):
            check_private(folders[-1])


@AS_ROOT
@pytest.mark.parametrize("place", [0, 1, 2])
@pytest.mark.parametrize("mode", [0o700, 0o755, 0o1777])
def test_other_owners_are_refused(folders, place, mode):
    os.chown(folders[place], OTHER_USER, OTHER_USER)
    folders[place].chmod(mode)
    with refused(PermissionError, folders[place], "user"):
        check_private(folders[-1])


def test_links_and_files_are_refused(folders):
    link, file = folders[0] / "link", folders[0] / "file"
    link.symlink_to(folders[1])
    file.touch(mode=0o600)
    for path in (link, link / "c", file):
        with refused(PermissionError, "folder"):
            check_private(path)
    with pytest.raises(FileNotFoundError):
        check_private(folders[0] / "none")


def test_temporary_folder_is_private(folders, monkeypatch):
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
    with refused(RuntimeError, "777", "TMPDIR"):
        with private_folder():
            pass
    assert list(folders[-1].iterdir()) == []
    monkeypatch.setattr(tempfile, "tempdir", str(folders[-1] / "none"))
    with refused(RuntimeError, "TMPDIR"):
        with private_folder():
            pass


@pytest.mark.skipif(not installed("distributed"), reason="distributed is not installed")
def test_workers_require_a_private_folder(folders, monkeypatch):
    """A worker imports from its temporary folder."""
    monkeypatch.setattr(tempfile, "tempdir", str(folders[-1]))
    folders[1].chmod(0o777)
    with refused(RuntimeError, "TMPDIR"):
        co.integrate_ensemble(co.systems.rigid_body((1, 2, 3)), [[1.0, 0.2, 0.5]], (0, 1), 0.1, workers=1)


@AS_ROOT
def test_folders_of_root_are_private_for_all(tmp_path):
    """Folders of other users are not private for root."""
    code = (
        "import os, sys; from pathlib import Path; from coadjoint.private_folders import check_private; "
        f"os.setuid({OTHER_USER}); check_private(Path(sys.argv[1]))"
    )
    own = Path(tempfile.mkdtemp(dir="/tmp")).resolve()
    try:
        os.chown(own, OTHER_USER, OTHER_USER)
        paths = os.environ | {"PYTHONPATH": str(Path(co.__file__).parents[1])}
        assert subprocess.run([sys.executable, "-c", code, str(own)], env=paths, timeout=60).returncode == 0
        with refused(PermissionError, "user"):
            check_private(own)
    finally:
        own.rmdir()


def test_folders_of_the_user_are_private_where_modes_are_not_those_of_posix(tmp_path, monkeypatch):
    """As on Windows, whose temporary files are in the folder of the user."""
    home = tmp_path.resolve() / "user"
    (home / "temporary").mkdir(parents=True)
    others = [tmp_path.resolve() / name for name in ("other", "user2", "use")]
    for folder in others:
        folder.mkdir()
    monkeypatch.setattr(Path, "home", lambda: home)
    with pytest.MonkeyPatch.context() as windows:
        windows.delattr(os, "geteuid")
        check_private(home / "temporary")
        for folder in others:
            with refused(PermissionError, folder.name):
                check_private(folder)
        windows.setattr(tempfile, "tempdir", str(home / "temporary"))
        with private_folder() as folder:
            assert folder.parent == home / "temporary"
        windows.setattr(tempfile, "tempdir", str(tmp_path / "other"))
        with refused(RuntimeError, "TMPDIR"), private_folder():
            pass
