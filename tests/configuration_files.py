"""Configuration files of ready-made systems, of an algebra of its own, and of a motion that overflows."""

import coadjoint as co
from command import command

BODY = """
[system]
name = "rigid_body"
[initial]
x = [1.0, 0.1, 0.5]
[run]
t_span = [0.0, 1.0]
step = 0.1
"""

READY_MADE = """
[system]
name = "rigid_body"
[system.parameters]
inertia = [1.0, 2.0, 2.5]
[initial]
x = [1.0, 0.1, 0.5]
[method]
name = "Splitting"
order = 4
[run]
t_span = [0, 1]
step = 0.1
"""

OWN = """
name = "mine"
sign = -1
[algebra]
dim = 3
brackets = ["[e1, e2] = e3", "[e2, e3] = e1", "[e3, e1] = e2"]
[hamiltonian]
M = [1.0, 0.5, 0.25]
[casimirs]
"|x|^2" = "x1^2 + x2^2 + x3^2"
[initial]
x = [1.0, 0.1, 0.5]
[run]
t_span = [0.0, 1.0]
step = 0.1
"""

# [e1, e2] = e2 with H = x1 gives x2' = x2, which overflows at t = 709.78, in step 710.
GROWING = """
sign = -1
[algebra]
dim = 2
brackets = ["[e1, e2] = e2"]
[hamiltonian]
linear = [1.0, 0.0]
[initial]
x = [1.0, 1.0]
[run]
t_span = [0.0, 1000.0]
step = 1.0
save_every = 100
"""

BRACKETS = 'brackets = ["[e1, e2] = e3", "[e2, e3] = e1", "[e3, e1] = e2"]'


def changed(text, *changes):
    """Return a text with parts replaced, each of which must occur."""
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    return text


class ConfigurationFiles:
    """Configuration files in the working folder, and what the installed command makes of them."""

    def __init__(self, folder, capsys):
        self.folder, self.capsys = folder, capsys

    def write(self, text, *changes, name="run.toml"):
        (self.folder / name).write_text(changed(text, *changes), encoding="utf-8", newline="")
        return name

    def run(self, text, *changes, out="run.nc", name="run.toml"):
        """Run a file with `--out`, and return the stored solution."""
        found = command(self.capsys, "run", self.write(text, *changes, name=name), "--out", out, "--quiet")
        assert (found.status, found.out) == (0, ""), found
        return co.load(out)

    def plan(self, text, *changes):
        """Check a file, and return the printed lines by their labels."""
        found = command(self.capsys, "check", self.write(text, *changes))
        assert found.status == 0, found
        return dict(line.split(maxsplit=1) for line in found.out.splitlines() if line[0] != " ")

    def refusals(self, text, *changes, by="check", name="run.toml"):
        """Return the printed lines of a refused file without its name; nothing is run or written."""
        self.write(text, *changes, name=name)
        before = sorted(self.folder.rglob("*"))
        found = command(self.capsys, by, name)
        assert (found.status, found.out) == (2, ""), found
        assert sorted(self.folder.rglob("*")) == before
        lines = found.err.splitlines()
        assert lines and all(line.startswith(f"{name}: ") and line.isprintable() for line in lines), found.err
        return [line.removeprefix(f"{name}: ") for line in lines]

    def refused(self, text, *changes, by="check"):
        """Return the one line of a file with one error."""
        (line,) = self.refusals(text, *changes, by=by)
        return line
