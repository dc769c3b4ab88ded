// The step of Taylor schemes of the library, and its address for the tables. What it uses is instantiated here.
#define COMPILES_SERIES
#include "../../src/coadjoint/methods/taylor.cpp"

EXPORT void* taylor_address() { return reinterpret_cast<void*>(&coadjoint::taylor_step); }
