/* Steps of an exported run, run.h, whose functions begin with `run`: MODE STEPS h x1 x2 ... MODE 0 takes all steps by one
   call, 1 each by a call of its own. */
#include "program.h"
#include "run.h"

int main(int argc, char **argv) {
    const int mode = (int)number(argc, argv, 1);
    const long steps = (long)number(argc, argv, 2);
    const double h = number(argc, argv, 3);
    double x[RUN_SIZE], begun;
    for (int i = 0; i < RUN_SIZE; i++) x[i] = number(argc, argv, 4 + i);
    begun = seconds();
    if (mode == 0)
        run_run(x, h, (unsigned long)steps);
    else
        for (long k = 0; k < steps; k++) run_step(x, h);
    report(seconds() - begun, steps, x, RUN_SIZE);
    return 0;
}
