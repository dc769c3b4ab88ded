"""Folders in which other users can change or replace files are recognised, wherever they lie above a file."""

import errno
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

import coadjoint as co
from coadjoint.optional_packages import installed
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


WAYS = ["link", "relative link", "link to link", "above/b/c", "above/b/beside", "a/b/c", "a/../above/b/c", "link/"]


def linked(folders):
    """Make links to the last folder, to one above it, and to another link; return the folder that has them."""
    top = folders[0].parent
    (top / "link").symlink_to(folders[-1])
    (top / "relative link").symlink_to(os.path.join("a", "b", "c"))
    (top / "link to link").symlink_to("link")
    (top / "above").symlink_to(folders[0])
    (folders[1] / "beside").symlink_to(os.path.join("..", "b", "c"))
    return top


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("absolute", [True, False])
def test_temporary_folders_by_any_name(folders, monkeypatch, way, absolute):
    """TMPDIR may be a link or a relative path: its real folder counts, as /tmp is a link on some systems."""
    top = linked(folders)
    monkeypatch.chdir(top)
    monkeypatch.setenv("TMPDIR", f"{top}/{way}" if absolute else way)
    monkeypatch.setattr(tempfile, "tempdir", None)
    with private_folder() as own:
        assert own.parent == folders[-1] and own.name.startswith("coadjoint-")
        (own / "file").touch()
    folders[1].chmod(0o777)
    with pytest.raises(RuntimeError, match=rf"{folders[-1]} are not safe \({folders[1]} can be changed by other users"):
        with private_folder():
            pass
    assert not os.listdir(folders[-1])


def test_links_where_others_can_replace_them(folders, monkeypatch):
    """The folder was made behind the link, and stays where it is."""
    (folders[0] / "link").symlink_to(folders[-1])
    other = folders[0].parent / "other"
    other.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folders[0] / "link"))
    with private_folder() as own:
        (folders[0] / "link").unlink()
        (folders[0] / "link").symlink_to(other)
        assert own.parent == folders[-1] and own.is_dir()


@pytest.mark.parametrize("case", ["missing", "file", "below a file", "link to nothing", "link to itself", "unwritable"])
def test_temporary_folders_that_cannot_be_made(folders, monkeypatch, case):
    """The reason is in the error, which is one line."""
    place = folders[-1] / "place"
    if case in ("file", "below a file"):
        place.touch()
    elif case.startswith("link"):
        place.symlink_to({"link to nothing": "none", "link to itself": "place"}[case])
    elif case == "unwritable":
        place.mkdir()
        mkdir = os.mkdir

        def refused(path, *args, **kwargs):
            if str(path).startswith(str(place)):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), path)
            mkdir(path, *args, **kwargs)

        monkeypatch.setattr(os, "mkdir", refused)
    before = sorted(folders[-1].rglob("*"))
    reasons = {"missing": errno.ENOENT, "link to nothing": errno.ENOENT, "link to itself": errno.ELOOP}
    reasons |= {"unwritable": errno.EACCES}
    reason = re.escape(os.strerror(reasons.get(case, errno.ENOTDIR)))
    monkeypatch.setattr(tempfile, "tempdir", str(place / "below" if case == "below a file" else place))
    with pytest.raises(
        RuntimeError, match=rf"^no temporary folder can be made \(.*{reason}.*\); set TMPDIR to a folder"
    ):
        with private_folder():
            pass
    assert sorted(folders[-1].rglob("*")) == before


@pytest.mark.parametrize("error", [OSError, PermissionError, RuntimeError, KeyboardInterrupt])
def test_errors_of_what_uses_a_temporary_folder(folders, monkeypatch, error):
    """They are raised as they are, and nothing stays behind."""
    monkeypatch.setattr(tempfile, "tempdir", str(folders[-1]))
    with pytest.raises(error, match="of the user"), private_folder() as own:
        (own / "file").touch()
        raise error("of the user")
    assert not os.listdir(folders[-1])


def test_a_temporary_folder_that_cannot_be_removed(folders, monkeypatch):
    """A library in use, for instance: the result counts."""
    monkeypatch.setattr(tempfile, "tempdir", str(folders[-1]))

    def busy(*args, **kwargs):
        raise OSError(errno.EBUSY, "Device or resource busy")

    with monkeypatch.context() as patched:
        with private_folder() as own:
            patched.setattr(os, "rmdir", busy)
        assert own.is_dir()


def test_a_temporary_folder_that_is_taken_away(folders, monkeypatch):
    """It cannot be examined, which is as bad as one that others can change."""
    monkeypatch.setattr(tempfile, "tempdir", str(folders[-1]))

    def gone(path):
        raise FileNotFoundError(errno.ENOENT, "No such file or directory", str(path))

    monkeypatch.setattr("coadjoint.private_folders.check_private", gone)
    with pytest.raises(RuntimeError, match=rf"temporary files in {folders[-1]} are not safe \(.*No such file"):
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
