"""Progress reports: a bar on a terminal, plain lines in a log."""

import fcntl
import io
import itertools
import os
import pty
import struct
import subprocess
import sys
import termios
import time
from pathlib import Path

import numpy as np
import pytest

import coadjoint as co

BODY, X = co.systems.rigid_body(), (1.0, 0.2, 0.1)
RUN = """
import sys
import coadjoint as co
co.integrate(co.systems.rigid_body(), (1.0, 0.2, 0.1), (0, 1000), 0.01, save_every=1000, progress=True)
"""
ENVIRONMENT = os.environ | {"PYTHONPATH": str(Path(co.__file__).parents[1])}


def test_log_has_one_line_without_control_characters():
    done = subprocess.run([sys.executable, "-c", RUN], capture_output=True, env=ENVIRONMENT, timeout=120, check=True)
    log = done.stderr.decode()
    assert log.startswith("100000 of 100000 steps (100 %) after ") and log.endswith(" s\n") and log.count("\n") == 1
    assert all(letter.isprintable() or letter == "\n" for letter in log) and done.stdout == b""


def test_terminal_has_a_bar():
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    with subprocess.Popen([sys.executable, "-c", RUN], stderr=theirs, env=ENVIRONMENT) as process:
        os.close(theirs)
        output = b""
        while True:
            try:
                piece = os.read(ours, 4096)
            except OSError:  # the other end is closed
                break
            if not piece:
                break
            output += piece
        assert process.wait(120) == 0
    os.close(ours)
    assert b"\r" in output and b"100k/100k" in output


def test_log_has_a_line_every_thirty_seconds(monkeypatch, capsys):
    """By a clock of which each look takes 15 s; the bits are those of a run without a log."""
    looks = itertools.count()
    monkeypatch.setattr(time, "monotonic", lambda: 15.0 * next(looks))
    run, given = co.prepare(BODY, co.ExplicitRungeKutta("rk4"), 0.001, threads=1).run, (X, (0, 4e3), 10**5)
    sol = run(*given, progress=True)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) > 1 and lines[-1].startswith("4000000 of 4000000 steps (100 %) after ")
    done, shares, seconds = zip(*((int(w[0]), int(w[4][1:]), float(w[7])) for w in map(str.split, lines)), strict=True)
    assert list(done) == sorted(done) and all(abs(100 * d / 4e6 - s) <= 1 for d, s in zip(done, shares, strict=True))
    assert all(later - earlier == 30 for earlier, later in itertools.pairwise([0.0, *seconds[:-1]]))
    assert sol.x.tobytes() == run(*given).x.tobytes()


def test_last_line_is_written_on_errors(capsys):
    with pytest.raises(co.IntegrationError):
        co.integrate(BODY, X, (0, 8e3), 1e3, co.Taylor(order=8), progress=True)
    assert " of 8 steps " in capsys.readouterr().err
    co.integrate(BODY, X, (0, 0), 0.1, progress=True)
    assert "0 of 0 steps after " in capsys.readouterr().err


@pytest.mark.parametrize("stream", [None, "closed", "full"])
def test_unwritable_log_does_not_fail_the_run(monkeypatch, stream):
    class Full(io.StringIO):
        def write(self, text):
            raise OSError(28, "No space left on device")

    log = None if stream is None else io.StringIO() if stream == "closed" else Full()
    if stream == "closed":
        log.close()
    monkeypatch.setattr(sys, "stderr", log)
    sol = co.integrate(BODY, X, (0, 1), 0.125, progress=True)
    assert sol.x.tobytes() == co.integrate(BODY, X, (0, 1), 0.125).x.tobytes()


def test_failed_members_leave_the_others_under_a_bar():
    """The iteration does not converge for the second one."""
    found = {}
    for progress in (False, True):
        with pytest.raises(co.IntegrationError) as failed:
            co.integrate(BODY, [X, (1e9, 2e8, 1e8)], (0, 200), 0.1, co.GaussLegendre(2), progress=progress)
        found[progress] = failed.value.partial.x
    assert np.isfinite(found[True][:, 0]).all()
    np.testing.assert_equal(found[True], found[False])
