"""Does the installed package work on this machine? Checks that ship with it, behind `coadjoint selftest`."""
