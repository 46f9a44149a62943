import json

import numpy as np
import pytest

from irl_dal.evaluation.episode import Episode, LoggedPlan
from irl_dal.evaluation.metrics import (
    METRICS,
    STATISTICS,
    cloning_row,
    compute_metrics,
    episode_record,
    join_rows,
    plan_rows,
)
from shield import ActuatorLimits, Status
from tests.irl_dal.evaluation.small import logged_plan, written_episode

LIMITS = ActuatorLimits()

DESIGN_KEYS = (
    "success",
    "collisions_per_1k_steps",
    "normalized_return",
    "bc_loss",
    "action_similarity",
    "ade_m",
    "fde_m",
    "command_violation_rate",
    "nominal_violation_rate",
    "intervention_rate",
    "projection_active_rate",
    "correction_norm",
)


def report(*episodes: Episode, **parts: object) -> dict[str, object]:
    """The numbers with a fixed bootstrap, from what JSON keeps."""
    records = [episode_record(episode, LIMITS) for episode in episodes]
    kept = json.loads(json.dumps({"episodes": records, **parts}))
    return dict(compute_metrics(rng=np.random.default_rng(0), **kept))


def test_every_name_of_the_design_is_there_with_its_interval() -> None:
    """The report is flat, finite JSON with the agreed names."""
    numbers = report(written_episode())
    for key in DESIGN_KEYS:
        assert key in numbers and f"{key}_ci95" in numbers
    for key in ("episodes", "steps", "seeds"):
        assert key in numbers
    assert json.loads(json.dumps(numbers, allow_nan=False)) == numbers


def test_shares_of_episodes_and_steps() -> None:
    """Success counts episodes, collisions are events per thousand steps."""
    episodes = [
        written_episode(400, seed=10),
        written_episode(100, seed=11, success=False, collision=True, at_fault=True),
        written_episode(300, seed=12, success=False, off_road=True, departed=True),
        written_episode(200, seed=13, success=False),
    ]
    numbers = report(*episodes)
    assert (numbers["episodes"], numbers["steps"]) == (4, 1000)
    assert numbers["seeds"] == [10, 11, 12, 13]
    assert numbers["episode_success"] == [True, False, False, False]
    rates = ("collision_rate", "off_road_rate", "timeout_rate", "at_fault_rate", "departure_rate")
    for key in ("success", *rates):
        assert numbers[key] == 0.25
    assert numbers["collisions_per_1k_steps"] == pytest.approx(1.0)
    low, high = numbers["success_ci95"]
    assert 0.0 <= low < 0.25 < high <= 1.0


def test_normalized_return_is_two_hundred_for_the_expert_and_zero_for_chance() -> None:
    """200 (R - R_random) / (R_expert - R_random) of the means, clipped to [0, 200]."""
    episodes = [written_episode(4), written_episode(8)]  # returns 4 and 8

    def normalized(expert: list[float], random: list[float]) -> object:
        references = list(zip(random, expert, strict=True))
        return report(*episodes, references=references)["normalized_return"]

    assert normalized([4.0, 8.0], [0.0, 0.0]) == 200.0
    assert normalized([10.0, 10.0], [4.0, 8.0]) == 0.0
    assert normalized([10.0, 14.0], [0.0, 0.0]) == pytest.approx(100.0)
    assert normalized([3.0, 3.0], [0.0, 0.0]) == 200.0
    assert report(*episodes)["normalized_return"] is None


def test_bc_loss_balances_the_modes() -> None:
    """Mean squared error over components and states, each mode with the same weight."""
    first = written_episode(2, mode=np.array([0, 0]))
    second = written_episode(3, mode=np.array([0, 0, 3]))
    answers = np.zeros((3, 2))
    answers[2] = [0.6, 0.2]  # the only state of its mode: (0.36 + 0.04) / 2
    rows = [cloning_row(first, np.zeros((2, 2))), cloning_row(second, answers)]
    numbers = report(written_episode(), cloning=rows)
    assert numbers["bc_loss"] == pytest.approx(0.2 / 2.0)


def test_action_similarity_compares_the_agents_own_action() -> None:
    """Opposite ends of the action space are 0, equality is 1, whatever was executed."""
    ones = np.ones((4, 2))
    same = written_episode(agent_action=ones, expert_action=ones, executed_command=0.3 * ones)
    opposite = written_episode(agent_action=-ones, expert_action=ones)
    assert report(same)["action_similarity"] == 1.0
    assert report(opposite)["action_similarity"] == 0.0
    assert report(same, opposite)["action_similarity"] == 0.5


def test_ade_is_the_mean_and_fde_the_final_distance() -> None:
    """Distances between two paths, mean over stretches."""
    numbers = report(written_episode(), distances=[[2.5, 5.0, 0.0], [0.0, 0.0, 0.0]])
    assert numbers["ade_m"] == pytest.approx(1.25)
    assert numbers["fde_m"] == 0.0
    assert report(written_episode(), distances=[[2.5, 0.0, 5.0]])["fde_m"] == pytest.approx(5.0)


def test_a_violation_of_one_ulp_counts() -> None:
    """There is no tolerance: the next float above a bound is a violation, the bound is none."""
    rate = LIMITS.max_steering_rate * LIMITS.dt
    commands = np.zeros((4, 2))
    commands[1, 0] = rate
    commands[3, 0] = np.nextafter(rate, 1.0)
    numbers = report(written_episode(executed_command=commands))
    assert numbers["command_violation_rate"] == 0.25
    assert numbers["nominal_violation_rate"] == 0.0


def test_each_source_is_judged_on_the_steps_on_which_it_spoke() -> None:
    """A silent source has no rate, a speaking one the share of its own steps."""
    entries = np.full((4, 4), -1, np.int8)
    entries[:, 0] = [0, 0, 0, 1]
    entries[2:, 1] = [0, 1]
    numbers = report(written_episode(nominal_violations=entries))
    assert numbers["nominal_violation_rate_policy"] == 0.25
    assert numbers["nominal_violation_rate_planner"] == 0.5
    assert numbers["nominal_violation_rate_expert"] is None


def test_shield_and_planner_rates() -> None:
    """Shares of steps and of plans, and the correction in normalised units."""
    nominal = np.tile([0.0, 6.0], (4, 1))
    executed = nominal.copy()
    executed[0] = [LIMITS.max_steering, 6.0]  # one unit of normalised steering away
    numbers = report(
        written_episode(
            nominal_command=nominal,
            executed_command=executed,
            projected=np.array([True, False, False, False]),
            triggered=np.array([True, True, False, False]),
            plans=(
                logged_plan(latency=0.010, status=Status.PROJECTED),
                logged_plan(latency=0.030),
            ),
            shield_time=np.array([1e-3, 1e-3, 1e-3, 5e-3]),
        )
    )
    assert numbers["intervention_rate"] == 0.5
    assert numbers["projection_active_rate"] == 0.25
    assert numbers["plan_projection_rate"] == 0.5
    assert numbers["correction_norm"] == pytest.approx(0.25)
    assert numbers["latency_plan_p50_ms"] == pytest.approx(20.0)
    assert numbers["latency_plan_max_ms"] == pytest.approx(30.0)
    assert numbers["latency_shield_p50_ms"] == pytest.approx(1.0)
    assert numbers["latency_shield_max_ms"] == pytest.approx(5.0)


def test_comfort_of_a_known_drive() -> None:
    """Jerk, lateral acceleration and steering rate of a drive with known derivatives."""
    dt, steps = LIMITS.dt, 400
    time = dt * np.arange(steps + 1)
    jerk, turn = 0.7, 0.2
    pose = np.zeros((steps + 1, 3))
    pose[:, 2] = np.angle(np.exp(1j * (3.0 + turn * time)))  # crosses pi
    previous = np.zeros((steps, 2))
    executed = previous + [0.03, 0.0]
    speed = 5.0 + 0.5 * jerk * time**2
    episode = written_episode(
        steps, pose=pose, speed=speed, previous_command=previous, executed_command=executed
    )
    numbers = report(episode)
    sideways = turn * jerk * time[1:-1]
    size = np.sqrt(np.mean(jerk**2 + sideways**2))
    assert numbers["comfort_rms_jerk"] == pytest.approx(size, rel=0.01)
    assert numbers["comfort_harsh_rate"] == pytest.approx(0.0, abs=0.01)
    assert numbers["mean_speed"] == pytest.approx(speed[1:].mean())
    fastest = 5.0 + 0.25 * jerk * (time[-1] ** 2 + time[-2] ** 2)
    assert numbers["comfort_max_lateral_acceleration"] == pytest.approx(turn * fastest, rel=1e-9)
    assert numbers["comfort_rms_steering_rate"] == pytest.approx(0.3)


@pytest.mark.parametrize(("frequency", "passes"), [(0.3, 0.99), (2.0, 0.5), (4.5, 0.02)])
def test_jerk_counts_up_to_its_bandwidth(frequency: float, passes: float) -> None:
    """A swing of the acceleration passes whole, by half at 2 Hz, and not where sampling ends."""
    dt, steps, swing = LIMITS.dt, 600, 2.0
    time = dt * (np.arange(steps) + 0.5)
    acceleration = swing * np.sin(2.0 * np.pi * frequency * time)
    speed = 8.0 + np.concatenate([[0.0], np.cumsum(acceleration * dt)])
    numbers = report(written_episode(steps, speed=speed))
    whole = np.sqrt(np.mean(np.square(np.diff(acceleration) / dt)))
    assert numbers["comfort_rms_jerk"] == pytest.approx(passes * whole, rel=0.03, abs=0.03 * whole)


def test_no_episodes_is_an_error() -> None:
    """A report about nothing is refused."""
    with pytest.raises(ValueError, match="at least one episode"):
        report()


def test_plans_are_judged_from_the_last_command_on() -> None:
    """A jump from the executed command counts for a plan, and the correction is its removal."""
    step = LIMITS.max_steering_rate * LIMITS.dt
    wild = np.zeros((8, 2))
    wild[:, 0] = 2.0 * step  # constant: only the first command breaks the rate bound
    plans = (logged_plan(nominal=wild), logged_plan())
    numbers = report(written_episode(plans=plans))
    assert numbers["plan_nominal_violation_rate"] == 0.5
    assert numbers["plan_violation_rate"] == 0.0
    assert numbers["plan_correction_norm"] == pytest.approx(step / LIMITS.max_steering)
    assert numbers["plan_diversity_m"] is None
    assert numbers["state_plan_nominal_violation_rate"] is None
    logs: list[tuple[LoggedPlan, ...]] = [plans, (logged_plan(), logged_plan())]
    rows = join_rows(plan_rows(log, LIMITS, "state_") for log in logs)
    name = "state_plan_nominal_violation_rate"
    assert STATISTICS[name](rows[name][None])[0] == 0.25


def test_energies_leave_fallbacks_out() -> None:
    """Means over the plans that have an energy, before guidance, before projection, after."""
    plans = (
        logged_plan(energy_unguided=3.0, energy_nominal=2.0, energy=1.0),
        logged_plan(status=Status.FALLBACK),
        logged_plan(energy_unguided=5.0, energy_nominal=4.0, energy=3.0),
    )
    numbers = report(written_episode(plans=plans))
    assert [numbers[f"plan_energy{part}"] for part in ("_unguided", "_nominal", "")] == [4, 3, 2]
    assert numbers["plan_fallback_rate"] == pytest.approx(1 / 3)


def test_diversity_is_the_mean_distance_between_the_ends_of_candidates() -> None:
    """Three candidates straight on at 4, 5 and 7 m/s end 0.8, 1.6 and 2.4 m apart."""
    candidates = np.zeros((3, 8, 2))
    candidates[:, :, 1] = np.array([[4.0], [5.0], [7.0]])
    plan, expected = logged_plan(candidates=candidates), (0.8 + 1.6 + 2.4) / 3
    assert report(written_episode(plans=(plan,)))["plan_diversity_m"] == pytest.approx(expected)
    numbers = report(written_episode(plans=(plan, logged_plan(status=Status.FALLBACK))))
    assert numbers["plan_diversity_m"] == pytest.approx(expected / 2)


def test_rows_of_two_evaluations_can_be_joined() -> None:
    """The statistic of all rows is the number of all episodes."""
    episodes = [written_episode(4), written_episode(8, success=False), written_episode(2)]
    apart = [episode_record(episode, LIMITS)["rows"] for episode in episodes]
    numbers = report(*episodes)
    for name in METRICS:
        rows = np.concatenate([part[name] for part in apart])
        value = float(STATISTICS[name](rows[None])[0])
        assert numbers[name] == (value if np.isfinite(value) else None)
