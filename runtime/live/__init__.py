"""Real-time operation in several processes: `headland live` and `headland shadow --bus`.

machine (simulation) ──sensors──► perception ──tracks──► planning     each ──► is a ring buffer in shared memory
    ▲   └──────sensors──────────► localization ─pose──►  (mission)    with a non-blocking writer; all rings ──► log
    └─ CAN, loopback ───────────► safety: supervisor and gateway
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"  # set before the libraries are loaded: there are more processes than cores already
