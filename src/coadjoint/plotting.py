"""Pictures of runs: kinds of pictures, the gallery, and figures with Matplotlib (``co.plotting``).

`Picture` names a kind of picture with its options, for ``sol.plot(pictures=...)`` and for `GalleryEntry`; `kind`
registers a kind of your own; `gallery` draws the ready-made systems, and `draw_bonds` crystals.
"""

from __future__ import annotations

from coadjoint.errors import refuse_others
from coadjoint.pictures.crystal_figure import draw_bonds
from coadjoint.pictures.gallery import gallery
from coadjoint.pictures.kinds.coadjoint_orbit import level_surface
from coadjoint.pictures.kinds.quantities import draw_modified_energy
from coadjoint.pictures.register import CannotShow, kind, kinds
from coadjoint.systems.gallery_entry import GalleryEntry, Picture

__all__ = [
    "CannotShow",
    "GalleryEntry",
    "Picture",
    "draw_bonds",
    "draw_modified_energy",
    "gallery",
    "kind",
    "kinds",
    "level_surface",
]

TYPE_CHECKING = False

if not TYPE_CHECKING:  # type checkers know the names above and must report any other
    __getattr__, __dir__ = refuse_others("co.plotting", __all__)
