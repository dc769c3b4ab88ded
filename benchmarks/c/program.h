/* What every program here shares: arguments, the clock, and printing. */
#define _GNU_SOURCE
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static double number(int argc, char **argv, int place) {
    if (place >= argc) {
        fprintf(stderr, "%s: argument %d is missing\n", argv[0], place);
        exit(2);
    }
    return strtod(argv[place], NULL);
}

static double seconds(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec + 1e-9 * now.tv_nsec;
}

/* One line: nanoseconds a step, then the final state. */
static void report(double elapsed, long steps, const double *x, int size) {
    printf("%.6f", 1e9 * elapsed / steps);
    for (int i = 0; i < size; i++) printf(" %.17g", x[i]);
    printf("\n");
}
