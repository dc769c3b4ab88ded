"""The notebooks of the built site, run as a reader does: ``python tests/browsed/notebooks.py build/site [NAME ...]``.

Each runs in a kernel of its own, and must end without errors or warnings in `EACH` seconds, those of systems with one
figure; all of them in `TOGETHER` seconds.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError
from traitlets.config import Config

EACH, TOGETHER = 180, 1200
# Kernels that no other user of the machine can reach, as they could through ports.
SETTINGS = Config({"ConnectionFileMixin": {"transport": "ipc"}})


def faults(path: Path, seconds: float) -> list[str]:
    """Run a notebook; return what is wrong with it."""
    notebook = nbformat.read(path, as_version=4)
    try:
        NotebookClient(notebook, timeout=int(seconds), kernel_name="python3", config=SETTINGS).execute()
    except CellTimeoutError:
        return [f"it is not at its end after {seconds:.0f} seconds"]
    except (CellExecutionError, DeadKernelError) as error:
        return [str(error).strip().rpartition("\n")[2]]
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    pictures = sum("image/png" in output.get("data", {}) for output in outputs)
    found = [f"it shows {pictures} figures"] if pictures != notebook.metadata.get("figures", 1) else []
    printed = [output.text.strip() for output in outputs if output.output_type == "stream"]
    # A busy machine may announce a long wait.
    return found + [f"it prints {text}" for text in printed if "LongWait: " not in text]


def main() -> int:
    """Run all notebooks; print what is wrong."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*", help="of systems and pages; all by default")
    given = parser.parse_args()
    paths = {path.stem: path for path in sorted(given.folder.glob("_downloads/*/*.ipynb"))}
    names = given.names or list(paths)
    if not names or (missing := set(names) - set(paths)):
        print(f"{given.folder} has no notebooks {', '.join(sorted(missing)) if names else ''}", file=sys.stderr)
        return 2
    wrong, began = [], time.monotonic()
    for count, name in enumerate(names):
        left = TOGETHER - (time.monotonic() - began)
        if left < 1:
            wrong.append(f"{len(names) - count} notebooks are left after {TOGETHER} seconds, from {name} on")
            break
        wrong += [f"{name}: {fault}" for fault in faults(paths[name], min(EACH, left))]
    print(*wrong, sep="\n")
    print(f"{len(names)} notebooks, {len(wrong)} faults, {time.monotonic() - began:.0f} s")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
