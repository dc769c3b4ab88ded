"""``python -m coadjoint``: the command."""

from coadjoint.cli import run

if __name__ == "__main__":
    run()
