#include <stdio.h>
#include <stdlib.h>
#include "coadjoint_runs.h"

static void check(int code) {
    if (code == COADJOINT_OK) return;
    fprintf(stderr, "%s\n", coadjoint_message());
    exit(1);
}

int main(void) {
    static char table[1 << 20];
    FILE *file = fopen("top.json", "rb");
    const size_t length = file ? fread(table, 1, sizeof table, file) : 0;
    double x[6] = {0.3, 0.2, 1.0, 0.6, 0.0, 0.8}, saved[10][6];
    double v[6] = {1.0}, gradient[6] = {0.0, 0.0, 0.0, 0.0, 0.0, 1.0};
    coadjoint_run *run;

    check(coadjoint_create(table, length, &run));
    check(coadjoint_set_state(run, x, 6));
    check(coadjoint_save(run, 10, 100, saved[0], 60));          /* 1000 steps, every hundredth state */
    printf("%.17g %.17g\n", saved[9][0], saved[9][1]);
    check(coadjoint_vjp(run, 100, x, gradient));                /* of the last number after 100 steps */
    check(coadjoint_jvp(run, 100, x, v, 1));                    /* along the first number */
    printf("%.12f %.12f\n", gradient[0], v[5]);
    coadjoint_destroy(run);
    return 0;
}
