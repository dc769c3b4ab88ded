"""Every benchmark as Markdown: printed, stored in benchmarks/report/, and put into docs/measurements.md.

python benchmarks/run_all.py [--without cost_curves ...]
"""

from __future__ import annotations

import argparse
import datetime
import os
import platform
import subprocess
import sys
import time

import numpy
from c_programs import FLAGS, HERE, build
from measurements import PAGE, REPORT, SUBJECTS, page

TITLES = {name: title for sections in SUBJECTS.values() for name, title in sections.items()}
SECTIONS = [name for name in TITLES if (HERE / f"{name}.py").exists()]


def first_line(*command: str) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[0]


def processor() -> str:
    """Return the model name, family and model that lscpu prints."""
    plain = {**os.environ, "LC_ALL": "C"}
    printed = subprocess.run(["lscpu"], check=True, capture_output=True, text=True, env=plain).stdout
    lines = dict(line.split(":", 1) for line in printed.splitlines() if ":" in line)
    name, family, model = (lines[key].strip() for key in ("Model name", "CPU family", "Model"))
    return f"{name} (family {family}, model {model})"


def machine() -> str:
    """Return the date, the processor and the programs, in one line."""
    compiler = f"{first_line('gcc', '--version')} {' '.join(FLAGS)}"
    programs = f"Python {platform.python_version()}, NumPy {numpy.__version__}"
    return f"{datetime.date.today()}: {processor()}, {os.cpu_count()} cores; {compiler}; {programs}"


def measure(name: str) -> bool:
    """Run one benchmark in a process of its own, so that none warms or slows the next, and store what it prints."""
    begun = time.perf_counter()
    done = subprocess.run([sys.executable, str(HERE / f"{name}.py")], capture_output=True, text=True)
    print(f"{name}: {time.perf_counter() - begun:.0f} s", file=sys.stderr, flush=True)
    if done.returncode != 0:
        print(f"{name} failed: {done.stderr.strip().splitlines()[-1]}", file=sys.stderr, flush=True)
        return False
    parts = [machine()]
    figure = HERE / "build" / f"{name}.png"
    if figure.exists() and figure.stat().st_mtime > time.time() - (time.perf_counter() - begun) - 1:
        (REPORT / figure.name).write_bytes(figure.read_bytes())
        parts.append(f"![{TITLES[name]}](../benchmarks/report/{figure.name})")
    stored = "\n\n".join([*parts, done.stdout.strip()]) + "\n"
    (REPORT / f"{name}.md").write_text(stored)
    print(stored)
    return True


def main() -> None:
    parser = argparse.ArgumentParser(description="all benchmarks, as Markdown")
    parser.add_argument("--without", nargs="+", choices=SECTIONS, default=[])
    given = parser.parse_args()
    build("rigid_body")  # no compiler: say so before anything is measured
    good = [measure(name) for name in SECTIONS if name not in given.without]
    PAGE.write_text(page(), encoding="utf-8")
    if not all(good):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
