"""What all tests begin with."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: on small matrices threads only wait for each other
