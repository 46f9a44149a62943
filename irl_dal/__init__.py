"""IRL-DAL: imitation, reinforcement and guided diffusion planning under a safety shield."""

import os

# GNU OpenMP reads this when torch is loaded: how long an idle thread waits actively. Its default is
# 300,000 turns, milliseconds in which it takes the core from whatever else runs there. What a short
# wait is worth beside other runs: docs/decisions.md.
os.environ.setdefault("GOMP_SPINCOUNT", "20000")
