"""Work against precision: what an answer of a given accuracy costs here and in other integrators, one thread each."""

import os

# before JAX is imported
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
os.environ["OMP_NUM_THREADS"] = "1"
