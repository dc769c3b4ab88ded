// The rotation of a step of a free body, and the derivatives of the step, in single precision (docs/c.md). It prints
//     1  0.98939 -0.07189 -0.12580 0.01030
//     -0.01586 0.00045
#include <cstdio>
#include "coadjoint.h"

int main() {
    const float inverse[3] = {1.0f, 0.5f, 0.25f};           // of the moments of inertia; 0 along a rod
    float momentum[3] = {0.3f, 1.0f, -0.2f}, turn[4], J[9], G[9];
    const long pieces = coadjoint_body_jacobianf(inverse, -0.5f, momentum, turn, J, G);
    std::printf("%ld  %.5f %.5f %.5f %.5f\n", pieces, turn[0], turn[1], turn[2], turn[3]);
    std::printf("%.5f %.5f\n", J[1], G[1]);                 // of momentum 1 and of the rotation about axis 1, by momentum 2
}
