#define COMPILES_ELEMENTARY
#include "numbers/elementary.hpp"
