"""Add a constraint of your own: a speed limit that varies along the horizon.

A car at 9 m/s plans to speed up although the limit ahead falls to 6 m/s. The projection keeps the
limit together with everything that the actuators can follow, and says so where it cannot.
"""

import numpy as np

from shield import UNBOUNDED, ActuatorLimits, HorizonProjector, Rows

HORIZON = 16


class SpeedLimit:
    """v_t <= limit_t: one row per step, which picks the speed out of (δ0, v0, δ1, v1, ...)."""

    def __init__(self, limit: np.ndarray) -> None:
        self.limit = limit

    def rows(self, actions: np.ndarray, previous: np.ndarray) -> Rows:
        """Return lower <= matrix @ z <= upper."""
        matrix = np.eye(actions.size)[1::2]
        return Rows(matrix, np.full(len(actions), -UNBOUNDED), self.limit)


def main() -> None:
    """Project the same plan without and with the speed limit, and from too close."""
    limits = ActuatorLimits()
    limit = np.where(np.arange(HORIZON) < HORIZON // 2, 10.0, 6.0)
    plan = np.tile([0.02, 11.0], (HORIZON, 1))
    free = HorizonProjector(limits, HORIZON)
    bound = HorizonProjector(limits, HORIZON, constraints=[SpeedLimit(limit)])
    for name, projector, speed in (
        ("without the limit", free, 9.0),
        ("with the limit", bound, 9.0),
        ("with it, but too fast", bound, 12.0),
    ):
        got = projector.project(plan, [0.0, speed])
        excess = max(0.0, float((got.actions[:, 1] - limit).max()))
        print(f"{name}: {got.status}, {excess:.2f} m/s above it; {got.reason or 'all kept'}")
        print("   ", " ".join(f"{v:.1f}" for v in got.actions[:, 1]))


if __name__ == "__main__":
    main()
