"""What Skygain's documents say in numbers, and the code that measures it.

``python -m benchmarks`` lists the studies, ``python -m benchmarks NAME …`` runs one of them and
writes its record to benchmarks/results. NumPy and PyTorch compute in one thread.
"""

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")  # before NumPy loads
