"""Put the shield around any gymnasium environment with continuous actions.

A random agent on `Pendulum-v1`, first as it is, then with a torque that may change by 20 N·m/s at
most. The shield works on the float32 actions that the environment receives, and counts exactly.
"""

from fractions import Fraction

import gymnasium
import numpy as np

from shield.gym import ShieldedEnv

RATE = 20.0
"""Largest rate of the torque [N·m/s]."""
DT = 0.05
"""Control period of the pendulum [s]."""


def broken_rates(actions: list[np.ndarray]) -> int:
    """Return how many actions move further than RATE · DT from the one before, exactly."""
    values = [Fraction(0), *(Fraction(float(action[0])) for action in actions)]
    step = Fraction(RATE * DT)
    return sum(abs(b - a) > step for a, b in zip(values, values[1:], strict=False))


def main() -> None:
    """Count broken rates without and with the shield, and tell what the shield did."""
    plain = gymnasium.make("Pendulum-v1")
    plain.action_space.seed(0)
    wishes = [plain.action_space.sample() for _ in range(200)]
    print(f"without the shield {broken_rates(wishes)} of 200 actions break the rate")
    env = ShieldedEnv(plain, rate=RATE, dt=DT)
    env.reset(seed=0)
    executed, statuses = [], {}
    for wish in wishes:
        info = env.step(wish)[-1]
        certificate = info["certificate"]
        executed.append(certificate.safe_action)
        statuses[certificate.status.value] = statuses.get(certificate.status.value, 0) + 1
    print(f"with the shield {broken_rates(executed)} of 200 do; statuses: {statuses}")
    env.close()


if __name__ == "__main__":
    main()
