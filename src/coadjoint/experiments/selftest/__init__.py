"""Self-test of the installed package, run by `coadjoint selftest`."""
