#include "coadjoint.h"

long body_step(const double *inverse, double h, double *momentum, double *attitude);
long body_step(const double *inverse, double h, double *momentum, double *attitude) {
    return coadjoint_body_step(inverse, h, momentum, attitude);
}
