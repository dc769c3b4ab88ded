/* coadjoint_runs.h: runs of exported splittings by the compiled library coadjoint. C99 and C++.

MIT License

Copyright (c) 2026 The coadjoint developers

Permission is hereby granted, free of charge, to any person obtaining a copy of this software and associated
documentation files (the "Software"), to deal in the Software without restriction, including without limitation the
rights to use, copy, modify, merge, publish, distribute, sublicense, and/or sell copies of the Software, and to permit
persons to whom the Software is furnished to do so, subject to the following conditions: The above copyright notice and
this permission notice shall be included in all copies or substantial portions of the Software.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR IMPLIED, INCLUDING BUT NOT LIMITED TO THE
WARRANTIES OF MERCHANTABILITY, FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE AUTHORS OR
COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR
OTHERWISE, ARISING FROM, OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE SOFTWARE.

A run is created from the text of a table, as `coadjoint export run.toml -o run.json` or `coadjoint.export_table` writes
it. It has the bits of the library in Python. Functions that return int return a code: COADJOINT_OK, or what failed; then
coadjoint_message() is one sentence about the last failure in this thread, until the next one. No function ends the
process, prints, or throws.

Different runs may be used by different threads at the same time; one run only by one of them at a time, except for
coadjoint_jvp and coadjoint_vjp, which do not change it. Numbers must be rounded to nearest.

This interface does not change while COADJOINT_RUNS_VERSION remains the same; coadjoint_runs_version() is that of the
library. */
#ifndef COADJOINT_RUNS_H
#define COADJOINT_RUNS_H
#include <stddef.h>
#include <stdint.h>

#define COADJOINT_RUNS_VERSION 1

#ifndef COADJOINT_API
#define COADJOINT_API
#endif

#ifdef __cplusplus
extern "C" {
#endif

enum {
    COADJOINT_OK = 0,
    COADJOINT_WRONG_ARGUMENT = 1, /* an argument is out of range, or not finite */
    COADJOINT_WRONG_TABLE = 2,    /* the text is no table, or none that this version can run */
    COADJOINT_NO_MEMORY = 3,
    COADJOINT_FAILED = 4          /* the state is no longer finite, or a flow is too long */
};

typedef struct coadjoint_run coadjoint_run;

COADJOINT_API int coadjoint_runs_version(void);
COADJOINT_API const char *coadjoint_message(void);

/* Create a run from a table, a JSON text of `length` bytes. It starts at the state 0. */
COADJOINT_API int coadjoint_create(const char *table, size_t length, coadjoint_run **run);
/* Release a run; null is allowed. */
COADJOINT_API void coadjoint_destroy(coadjoint_run *run);

/* How many numbers a state has, the length of a step, and how many steps have been taken since the start. */
COADJOINT_API size_t coadjoint_size(const coadjoint_run *run);
COADJOINT_API double coadjoint_step_length(const coadjoint_run *run);
COADJOINT_API int64_t coadjoint_steps(const coadjoint_run *run);

/* Start again at a state of `size` numbers, and copy the present state. */
COADJOINT_API int coadjoint_set_state(coadjoint_run *run, const double *x, size_t size);
COADJOINT_API int coadjoint_get_state(const coadjoint_run *run, double *x, size_t size);

/* Take one step, or several. Any division of the steps into calls gives the same bits. */
COADJOINT_API int coadjoint_step(coadjoint_run *run);
COADJOINT_API int coadjoint_advance(coadjoint_run *run, int64_t steps);

/* Take `points` times `every` steps, and copy the state after each of these, row after row, to `saved`, which has
   `capacity` numbers, at least `points` times the size. */
COADJOINT_API int coadjoint_save(coadjoint_run *run, int64_t points, int64_t every, double *saved, size_t capacity);

/* Replace the state x by that after some steps from there, and each of `count` vectors, row after row, by the derivative
   in its direction. */
COADJOINT_API int coadjoint_jvp(const coadjoint_run *run, int64_t steps, double *x, double *vectors, size_t count);

/* Replace a covector, the gradient of a function of the state after some steps from x, by the gradient by x. Takes
   memory in proportion to the steps. */
COADJOINT_API int coadjoint_vjp(const coadjoint_run *run, int64_t steps, const double *x, double *covector);

#ifdef __cplusplus
}
#endif
#endif
