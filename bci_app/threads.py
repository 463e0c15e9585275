"""Importing this limits linear algebra to one thread; import it before anything that loads NumPy.

The loop's processes share few cores, and the order of a sum, so its last bit, must not depend on how many threads a
machine happens to offer.
"""

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"
os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
