"""``python -m coadjoint``: the command-line interface."""

from coadjoint.cli import run

if __name__ == "__main__":
    run()
