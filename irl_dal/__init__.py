"""IRL-DAL: imitation, reinforcement and guided diffusion planning under a safety shield."""

import os

# GNU OpenMP reads this when torch is loaded. By default an idle thread waits actively for
# milliseconds; on cores that are busy with something else, gradient steps then take five times as
# long. With a short wait they take twice as long there, and no longer on idle cores.
os.environ.setdefault("GOMP_SPINCOUNT", "20000")
