"""The memory that is available: what the system, its groups of processes and the limits of the process leave."""

from pathlib import Path

import pytest

from coadjoint import memory
from refusals import refused


def test_available_memory_of_this_machine():
    assert 2**20 < memory.available() <= memory.NO_LIMIT


MEMINFO = "MemTotal:       16000000 kB\nMemFree:         1000000 kB\nMemAvailable:    3000000 kB\nSwapFree: 9 kB\n"


@pytest.fixture
def files(monkeypatch):
    """Contents of the files in which the system reports memory; others do not exist."""
    found = {}

    def read(self, **kwargs):
        if str(self) not in found:
            raise FileNotFoundError(str(self))
        return found[str(self)]

    monkeypatch.setattr(Path, "read_text", read)
    return found


def test_sources_of_available_memory(files, monkeypatch):
    """Memory without swapping, in bytes; the total if that is not reported; a limit of the shell."""
    sizes = {"SC_PHYS_PAGES": 1000, "SC_PAGE_SIZE": 4096}
    monkeypatch.setattr("os.sysconf", sizes.__getitem__)
    assert memory.available() == 4096 * 1000
    files["/proc/meminfo"] = "MemAvailable: unknown kB\n"
    assert memory.available() == 4096 * 1000
    files["/proc/meminfo"] = MEMINFO
    assert memory.available() == 1024 * 3000000
    monkeypatch.setattr("resource.getrlimit", lambda which: (2**30, 2**40))
    monkeypatch.setattr("resource.getpagesize", lambda: 4096)
    assert memory.available() == 1024 * 3000000, "the memory taken is not known"
    files["/proc/self/statm"] = "1000 90 80 70 60 50 40\n"
    assert memory.available() == 2**30 - 1000 * 4096
    files["/proc/self/statm"] = f"{2**20} 90 80 70 60 50 40\n"
    assert memory.available() == 0, "never negative"
    monkeypatch.setattr("resource.getrlimit", lambda which: (-1, -1))
    assert memory.available() == 1024 * 3000000


def test_smallest_cgroup_limit_counts(files, monkeypatch):
    """Groups of both versions at every depth, parents included; groups without a limit are ignored."""
    groups = {
        "/sys/fs/cgroup": (9000, 1000, 0),
        "/sys/fs/cgroup/user": (5000, 4000, 500),
        "/sys/fs/cgroup/user/job": (9000, 100, 0),
        "/sys/fs/cgroup/memory": (8000, 0, 0),
        "/sys/fs/cgroup/memory/own": (8000, 6000, 1000),
    }
    names = {False: ("memory.max", "memory.current", "file"), True: ("memory.limit_in_bytes", "memory.usage_in_bytes")}

    def put(group, most, used, cached):
        old = group.startswith("/sys/fs/cgroup/memory")
        files[f"{group}/{names[old][0]}"], files[f"{group}/{names[old][1]}"] = f"{most}\n", f"{used}\n"
        files[f"{group}/memory.stat"] = f"anon 1\n{'total_cache' if old else 'file'} {cached}\ncache 7\n"

    for group, numbers in groups.items():
        put(group, *numbers)
    files["/proc/meminfo"] = MEMINFO
    files["/proc/self/cgroup"] = "5:cpu,memory:/own\n4:cpuset:/none\n0::/user/job\n"
    left = {group: most - used + cached for group, (most, used, cached) in groups.items()}
    assert memory.available() == min(left.values()) == 1500
    for group in groups:
        for other, numbers in groups.items():
            put(other, *(numbers if other != group else (1200, 300, 20)))
        assert memory.available() == 920, group
    for group, numbers in groups.items():
        put(group, *numbers)
    files["/sys/fs/cgroup/user/memory.max"] = "max\n"
    assert memory.available() == 3000
    put("/sys/fs/cgroup/user/job", 1200, 300, 20)
    files["/proc/self/cgroup"] = "0::/../user/job\n"
    assert memory.available() == 920, "paths of other namespaces lie above the root"


def test_requests_up_to_the_limit_are_accepted(monkeypatch):
    """The limit itself fits; small requests are not checked."""
    monkeypatch.setattr("coadjoint.memory.available", lambda: 10**9)
    for count in (0, memory.UNCHECKED_BYTES, 10**9):
        memory.check_available_memory(count, "it")
    with refused(ValueError, "it needs about 1.0 GB", "1.0 GB free", "take less"):
        memory.check_available_memory(10**9 + 1, "it", "take less")
    monkeypatch.setattr("coadjoint.memory.available", lambda: 0)
    memory.check_available_memory(memory.UNCHECKED_BYTES, "it")
    with refused(ValueError, "it needs about 67 MB", "0 MB free"):
        memory.check_available_memory(memory.UNCHECKED_BYTES + 1, "it")
