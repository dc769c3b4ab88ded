"""The check-cases, one file each; `coadjoint.checkcases.registry` finds them."""
