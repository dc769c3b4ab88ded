"""Draw `docs/decaying_turbulence.png`, which takes minutes: ``python docs/draw_turbulence.py``."""

from __future__ import annotations

import io
from pathlib import Path

from PIL import Image

from coadjoint.pictures.gallery import piece

PICTURE = Path(__file__).with_name("decaying_turbulence.png")

if __name__ == "__main__":
    made = piece("decaying_turbulence")
    drawn = io.BytesIO()
    made.figure.savefig(drawn, format="png", dpi=62)
    Image.open(drawn).convert("RGB").quantize(256).save(PICTURE, optimize=True)
    print(made.run)
