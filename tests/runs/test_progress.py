"""Progress reports: a bar on a terminal, plain lines in a log."""

import fcntl
import io
import os
import pty
import struct
import subprocess
import sys
import termios
from pathlib import Path

import pytest

import coadjoint as co
from coadjoint.runs import progress

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
    now = iter([0.0, 10.0, 30.0, 40.0, 59.0, 61.0, 62.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(now))
    with progress.progress_bar(8, True, "member") as done:
        for _ in range(5):
            done(1)
    assert capsys.readouterr().err.splitlines() == [
        "2 of 8 members (25 %) after 30 s",
        "5 of 8 members (62 %) after 61 s",
    ]


def test_last_line_is_written_on_errors(capsys):
    with pytest.raises(RuntimeError), progress.progress_bar(8, True) as done:
        done(3)
        raise RuntimeError
    assert capsys.readouterr().err.startswith("3 of 8 steps (38 %) after ")
    with progress.progress_bar(0, True):
        pass
    assert capsys.readouterr().err.startswith("0 of 0 steps after ")


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
