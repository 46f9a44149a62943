"""Put the shield behind a planner of your own: project its horizon, execute one command, repeat.

The planner here is a bad one on purpose. It wants to swerve around an obstacle in one step, at a
speed that no tyre holds, and now and then it returns NaN.
"""

import numpy as np

from shield import ActuatorLimits, HorizonProjector, KinematicBicycle, SafetyFilter

HORIZON = 8


def careless_planner(step: int, rng: np.random.Generator) -> np.ndarray:
    """Return a horizon (H, 2) of steering [rad] and speed [m/s] without a thought for limits."""
    plan = np.tile([0.0, 12.0], (HORIZON, 1))
    if 10 <= step < 20:
        plan[:, 0] = 0.4
    elif 20 <= step < 30:
        plan[:, 0] = -0.4
    if step % 13 == 12:
        plan[3, 1] = np.nan
    return plan + rng.normal(0.0, [0.05, 0.5], plan.shape)


def main() -> None:
    """Drive four seconds and print what the shield did."""
    limits = ActuatorLimits()
    projector = HorizonProjector(limits, HORIZON)
    shield = SafetyFilter(limits)
    bicycle = KinematicBicycle(limits.wheelbase, limits.dt)
    rng = np.random.default_rng(0)
    shield.reset([0.0, 9.0])
    pose = np.zeros(3)
    print("  t [s]   nominal         executed        lateral [m/s²]  status")
    for step in range(40):
        plan = careless_planner(step, rng)
        previous = shield.previous
        projection = projector.project(plan, previous)
        certificate = shield.filter(projection.actions[0], projection.actions)
        command = certificate.safe_action
        assert not limits.violated(command, previous)
        pose = bicycle.rollout(pose, command[None])[-1]
        lateral = float(limits.lateral_acceleration(command))
        print(
            f"  {step * limits.dt:5.1f}   ({plan[0, 0]:5.2f}, {plan[0, 1]:5.1f})"
            f"   ({command[0]:5.2f}, {command[1]:5.1f})   {lateral:14.2f}  "
            f"{projection.status}{': ' + projection.reason if projection.reason else ''}"
        )
    print(f"at x = {pose[0]:.1f} m, y = {pose[1]:.1f} m, without a single broken bound")


if __name__ == "__main__":
    main()
