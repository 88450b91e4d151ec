"""Imported first by every benchmark: one thread, and the checkout in the path, not its own folder.

Python puts a script's folder first, and there lie files with the names of the packages that they
measure. The threads have to be set before numpy and torch are imported.
"""

import os
import sys

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path[:] = [os.path.dirname(HERE), *(p for p in sys.path if os.path.abspath(p) != HERE)]
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"
