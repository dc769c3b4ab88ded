// The step of Taylor schemes of the library, and its address for the tables.
#include "../../src/coadjoint/methods/taylor.cpp"

EXPORT void* taylor_address() { return reinterpret_cast<void*>(&coadjoint::taylor_step); }
