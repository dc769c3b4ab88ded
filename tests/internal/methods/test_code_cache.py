"""The cache of compiled steps: no file or folder is used that another user can have written or can replace."""

import hashlib
import os
import shutil
import subprocess
import threading
import warnings

import pytest

from coadjoint.methods.step_compiler import cached_library
from coadjoint.private_folders import check_private
from refusals import refused

STRANGER, NAME = 65534, "step-0123"
BUILT, PLANTED = 1, 2

pytestmark = pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler is installed")
AS_ROOT = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file to another user")


@pytest.fixture(scope="module")
def libraries(tmp_path_factory):
    """Two libraries that say which they are."""
    folder = tmp_path_factory.mktemp("libraries")
    for number in (BUILT, PLANTED):
        code = f'extern "C" int which() {{ return {number}; }}'
        command = ["c++", "-shared", "-fPIC", "-o", str(folder / str(number)), "-x", "c++", "-"]
        subprocess.run(command, input=code.encode(), check=True, timeout=300)
    return folder


@pytest.fixture
def cache(tmp_path, monkeypatch, libraries):
    try:
        check_private(tmp_path.resolve())
    except PermissionError as reason:
        pytest.skip(f"the tests themselves are in a folder that others can change: {reason}")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return Cache(tmp_path / "cache", libraries)


class Cache:
    def __init__(self, base, libraries):
        self.base, self.folder, self.libraries, self.built = base, base / "coadjoint", libraries, 0

    @property
    def file(self):
        (found,) = self.folder.glob(f"{NAME}-*.so")
        return found

    def build(self, path):
        self.built += 1
        path.write_bytes((self.libraries / str(BUILT)).read_bytes())
        path.chmod(0o777)

    def load(self):
        """Return which library is loaded, and the warnings."""
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always")
            which = cached_library(NAME, self.build).which()
        assert all(warning.category is RuntimeWarning for warning in found)
        return which, [str(warning.message) for warning in found]

    def plant(self):
        """Put another library where the cache would have its own."""
        content = (self.libraries / str(PLANTED)).read_bytes()
        self.folder.mkdir(mode=0o700, exist_ok=True, parents=True)
        path = self.folder / f"{NAME}-{hashlib.sha256(content).hexdigest()[:32]}.so"
        path.write_bytes(content)
        path.chmod(0o600)

    def check_unused(self, named):
        """Check that the library is built outside of the cache, with one warning."""
        which, warned = self.load()
        assert which == BUILT and len(warned) == 1 and "\n" not in warned[0] and named in warned[0]


def mode(path):
    return path.stat().st_mode & 0o7777


@pytest.mark.parametrize("mask", [0, 0o022, 0o077])
def test_what_is_cached_is_private_and_found_again(cache, mask):
    old = os.umask(mask)
    try:
        assert cache.load() == (BUILT, [])
    finally:
        os.umask(old)
    assert [mode(path) for path in (cache.base, cache.folder, cache.file)] == [0o700, 0o700, 0o600]
    assert cache.load() == (BUILT, []) and cache.built == 1
    assert list(cache.folder.iterdir()) == [cache.file]


def test_own_files_are_used(cache):
    """Also those of folders that others can read, and behind a link of one's own."""
    cache.plant()
    cache.folder.chmod(0o755)
    cache.file.chmod(0o755)
    assert cache.load() == (PLANTED, [])
    cache.base.rename(cache.base.parent / "elsewhere")
    cache.base.symlink_to(cache.base.parent / "elsewhere")
    assert cache.load() == (PLANTED, []) and cache.built == 0


def test_on_windows_the_folder_of_the_user_is_private(cache, monkeypatch):
    """It shows neither owners nor modes of files, and has no flags for links."""
    monkeypatch.setenv("HOME", str(cache.base.parent))
    for name in ("geteuid", "O_NOFOLLOW", "O_NONBLOCK"):
        monkeypatch.delattr(os, name)
    assert cache.load() == (BUILT, []) == cache.load() and cache.built == 1
    monkeypatch.setenv("HOME", str(cache.base / "of another user"))
    with refused(RuntimeError, "folder of this user"):
        cache.load()


def as_link(cache):
    path = cache.file
    path.rename(cache.base / "theirs")
    path.symlink_to(cache.base / "theirs")


def as_pipe(cache):
    path = cache.file
    path.unlink()
    os.mkfifo(path, 0o600)


def as_folder(cache):
    path = cache.file
    path.unlink()
    path.mkdir(mode=0o700)


def behind_link(cache):
    open_folder = cache.base.parent / "open"
    open_folder.mkdir()
    open_folder.chmod(0o777)
    cache.folder.rename(open_folder / "theirs")
    cache.folder.symlink_to(open_folder / "theirs")


def given_away(where):
    return pytest.param(lambda cache: os.chown(getattr(cache, where), STRANGER, STRANGER), marks=AS_ROOT)


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    "change",
    [
        lambda cache: cache.file.chmod(0o620),
        lambda cache: cache.file.chmod(0o602),
        lambda cache: cache.folder.chmod(0o770),
        lambda cache: cache.folder.chmod(0o707),
        lambda cache: cache.folder.chmod(0o1777),
        lambda cache: cache.base.chmod(0o777),
        *(as_link, as_pipe, as_folder, behind_link),
        *map(given_away, ("file", "folder", "base")),
    ],
)
def test_what_others_can_have_written_is_not_loaded(cache, change):
    cache.plant()
    change(cache)
    before = sorted((path, os.lstat(path).st_mtime_ns) for path in cache.base.rglob("*"))
    cache.check_unused(str(cache.base.parent))
    assert cache.built == 1
    assert sorted((path, os.lstat(path).st_mtime_ns) for path in cache.base.rglob("*")) == before


@pytest.mark.thinned(1)
@pytest.mark.parametrize("given", ["", ".", "relative", "../relative", "~/cache"])
def test_a_relative_folder_is_ignored(cache, monkeypatch, given):
    home = cache.base.parent / "home"
    (home / "work").mkdir(parents=True)
    monkeypatch.chdir(home / "work")
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setenv("XDG_CACHE_HOME", given)
    assert cache.load() == (BUILT, [])
    assert [path.parent for path in home.rglob("*") if path.is_file()] == [home / ".cache" / "coadjoint"]


@pytest.mark.parametrize("damage", [lambda raw: b"", lambda raw: raw[: len(raw) // 2], lambda raw: raw[:-1] + b"?"])
def test_a_damaged_file_is_built_again(cache, damage):
    """Half of a library would end the process that loads it."""
    cache.plant()
    cache.file.write_bytes(damage(cache.file.read_bytes()))
    assert cache.load() == (BUILT, []) == cache.load() and cache.built == 1
    assert list(cache.folder.iterdir()) == [cache.file], "the damaged one is removed"


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_nothing_is_left_of_a_build_that_stopped(cache, error):
    def stopped(path):
        path.write_bytes(b"half of")
        raise error

    with pytest.raises(error):
        cached_library(NAME, stopped)
    assert list(cache.folder.iterdir()) == []


def test_two_builds_at_the_same_time(cache):
    """Both replace the file by a whole one, under a library that is in use."""
    gate, found = threading.Barrier(2), []

    def build(path):
        gate.wait(60)
        cache.build(path)

    threads = [threading.Thread(target=lambda: found.append(cached_library(NAME, build))) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [library.which() for library in found] == [BUILT, BUILT]
    assert list(cache.folder.iterdir()) == [cache.file] and cache.load() == (BUILT, [])
