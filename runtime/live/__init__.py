"""The stack against the wall clock, in processes of its own: `headland live` and `headland shadow --bus`.

machine (simulation) ──sensors──► perception ──tracks──► planning     each ──► is a ring in shared memory that its
    ▲   └──────sensors──────────► localization ─pose──►  (mission)    writer never waits for, and all rings ──► log
    └─ CAN, udp_multicast ──────► safety: supervisor and gateway
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"  # before any of them is loaded: more processes than cores as it is
