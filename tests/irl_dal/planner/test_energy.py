import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from irl_dal.planner.context import hazard
from irl_dal.planner.energy import EnergyConfig, TotalEnergy
from irl_dal.planner.energy.base import Energy
from irl_dal.planner.energy.clearance import ClearanceEnergy, cover
from irl_dal.planner.energy.lane import PREVIEW, LaneEnergy, open_lanes
from irl_dal.planner.energy.smoothness import ExpertEnergy, JerkEnergy, StabilityEnergy
from shield import ClearanceEstimate, ScannerGeometry, VehicleGeometry
from tests.irl_dal.planner.scenes import (
    BEAM_ANGLES,
    HORIZON,
    LIMITS,
    MAX_RANGE,
    SCANNER,
    chunks,
    context,
    lane,
    open_road,
    random_context,
)

Array = NDArray[np.float64]

DISC_CENTRES, DISC_RADIUS = cover(VehicleGeometry())

TERMS: tuple[type[Energy], ...] = (
    LaneEnergy,
    ClearanceEnergy,
    JerkEnergy,
    StabilityEnergy,
    ExpertEnergy,
)


def constant(steering: float, speed: float) -> Array:
    """The plan (1, H, 2) that holds a command [rad, m/s]."""
    return np.asarray(LIMITS.to_action(np.full((1, HORIZON, 2), (steering, speed))))


def finite_differences(energy: Energy, actions: Array) -> Array:
    """Central differences of the summed energy."""
    gradient, step = np.zeros_like(actions), 1e-6
    for index in np.ndindex(actions.shape):
        moved = [actions.copy(), actions.copy()]
        moved[0][index] += step
        moved[1][index] -= step
        up, down = (float(energy.evaluate(one)[0].sum()) for one in moved)
        gradient[index] = (up - down) / (2.0 * step)
    return gradient


@pytest.mark.parametrize("forms", ["rollout", "printed"])
@pytest.mark.parametrize("kind", TERMS)
@pytest.mark.parametrize("seed", range(4))
def test_gradients_against_finite_differences(kind: type[Energy], seed: int, forms: str) -> None:
    """Every energy's gradient is the derivative of its value."""
    rng = np.random.default_rng(seed)
    reference = np.tile([0.1, 4.0], (HORIZON, 1))
    scene = replace(random_context(rng), expert_reference=reference)
    energy = kind(scene, EnergyConfig(forms=forms), LIMITS, HORIZON)  # type: ignore[arg-type]
    actions = chunks(rng, scene, 3)
    value, gradient = energy.evaluate(actions)
    assert value.shape == (3,)
    np.testing.assert_allclose(gradient, finite_differences(energy, actions), atol=2e-5, rtol=1e-5)


@pytest.mark.parametrize("kind", TERMS)
def test_every_term_depends_on_the_plan(kind: type[Energy]) -> None:
    """Each energy has a gradient in steering and in speed."""
    reference = np.tile([0.1, 4.0], (HORIZON, 1))
    scene = replace(
        context(distance=3.0), expert_reference=reference, previous=np.array([0.02, 4.0])
    )
    energy = kind(scene, EnergyConfig(), LIMITS, HORIZON)
    _, gradient = energy.evaluate(constant(0.08, 6.0))
    assert float(np.abs(gradient[..., 0]).max()) > 1e-3
    assert float(np.abs(gradient[..., 1]).max()) > 1e-3


def test_printed_terms_ignore_the_plan() -> None:
    """As printed, lane and obstacle are the same for every plan and guide nothing."""
    scene = context(distance=1.0)
    silent = {"jerk_weight": 0.0, "stability_weight": 0.0}
    energy = TotalEnergy(scene, EnergyConfig(forms="printed", **silent), LIMITS, HORIZON)
    value, gradient = energy.evaluate(chunks(np.random.default_rng(0), scene, 5))
    weight = 1.0 + hazard(1.0)
    expected = weight * (2.0 / 2.0) ** 2 + weight * (scene.lane_deviation / 0.5) ** 2
    np.testing.assert_allclose(value, expected, rtol=1e-2)
    assert float(np.ptp(value)) == 0.0
    assert not gradient.any()


def advance(pose: torch.Tensor, bend: torch.Tensor, run: torch.Tensor) -> torch.Tensor:
    """The pose (x, y, yaw) after a piece of a circle."""
    mid = pose[2] + 0.5 * bend * run
    return torch.stack([pose[0] + run * mid.cos(), pose[1] + run * mid.sin(), pose[2] + bend * run])


def gap_to(points: torch.Tensor, pose: torch.Tensor) -> torch.Tensor:
    """Free distance between the car's discs and the nearest of the points."""
    direction = torch.stack([pose[2].cos(), pose[2].sin()])
    discs = pose[:2] + torch.tensor(DISC_CENTRES)[:, None] * direction
    return (discs[:, None] - points).norm(dim=2).min() - DISC_RADIUS


def torch_commands(actions: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Curvatures and speeds of normalised actions (H, 2)."""
    steering = LIMITS.max_steering * actions[:, 0]
    middle, half = LIMITS.max_speed + LIMITS.min_speed, LIMITS.max_speed - LIMITS.min_speed
    return torch.tan(steering) / LIMITS.wheelbase, 0.5 * (middle + half * actions[:, 1])


def torch_lane(scene, config: EnergyConfig, actions: torch.Tensor) -> torch.Tensor:  # type: ignore[no-untyped-def]
    """Mean square of where the heading leads, from the lane that the plan's end makes for."""
    e, psi, s = (
        torch.tensor(value, dtype=torch.float64)
        for value in (scene.lane.lateral_offset, scene.lane.heading_error, 0.0)
    )
    places = []
    for bend, speed in zip(*torch_commands(actions), strict=True):
        run = speed * LIMITS.dt
        relative = (bend - scene.lane.curvature - scene.lane.curvature_rate * (s + 0.5 * run)) * run
        e = e + run * torch.sin(psi + 0.5 * relative)
        psi, s = psi + relative, s + run
        places.append(e + PREVIEW * speed * psi.sin())
    target = min(open_lanes(scene), key=lambda one: abs(float(places[-1].detach()) - one))
    off = torch.stack(places) - target
    return config.lane_weight * (off / config.lane_scale).square().mean()


def torch_clearance(scene, config: EnergyConfig, actions: torch.Tensor) -> torch.Tensor:  # type: ignore[no-untyped-def]
    """Mean square of what is missing to the safe clearance, along the plan and a stop after it."""
    seen = scene.scan < MAX_RANGE
    angle, distance = torch.tensor(BEAM_ANGLES[seen]), torch.tensor(scene.scan[seen])
    ray = torch.stack([angle.cos(), angle.sin()], dim=1)
    near = int(distance.argmin())
    points = distance[:, None] * ray
    moves = ((points - points[near]).norm(dim=1) < 3.0).double()[:, None] * ray[near]
    away = scene.speed * ray[near, 0] - scene.clearance.closing_speed
    pose, clearances = torch.zeros(3).double(), []
    for i, (bend, speed) in enumerate(zip(*torch_commands(actions), strict=True)):
        pose = advance(pose, bend, speed * LIMITS.dt)
        now = points + torch.tensor(np.array([SCANNER.mount, 0.0]))
        now = now + moves * away * LIMITS.dt * (i + 1)
        clearances.append(gap_to(now, pose))
    for j in range(1, 5):  # four poses on the way to a stop at `braking`, the object braking too
        brake = config.braking or math.inf
        pose = advance(pose, bend, speed**2 / (2.0 * brake) / 4.0)
        time = scene.previous[1] / brake * (1.0 - math.sqrt(1.0 - j / 4.0))
        time = min(time, abs(away) / brake)
        way = math.copysign(abs(away) * time - 0.5 * brake * time**2, away)
        clearances.append(gap_to(now + moves * way, pose))
    gap = (config.safe_clearance - torch.stack(clearances)) / config.clearance_scale
    return config.clearance_weight * gap.clamp(min=0.0).square().mean()


def torch_energy(scene, config: EnergyConfig, actions: torch.Tensor) -> torch.Tensor:  # type: ignore[no-untyped-def]
    """The composite roll-out energy of one plan (H, 2), written a second time, step by step."""
    danger = 1.0 - math.tanh(scene.clearance.clearance / 3.0)
    half = torch.tensor([LIMITS.max_steering, 0.5 * (LIMITS.max_speed - LIMITS.min_speed)])
    centre = torch.tensor([0.0, 0.5 * (LIMITS.max_speed + LIMITS.min_speed)])
    last = (torch.tensor(scene.previous) - centre.double()) / half.double()
    steps = torch.cat([last[None], actions]).diff(dim=0)
    along_lane = math.atan(scene.lane.curvature * LIMITS.wheelbase) / LIMITS.max_steering
    cruise = max(float(scene.previous[1]), config.slowest_reference)
    steady = (cruise - centre[1].double()) / half[1].double()
    neutral = torch.stack([torch.tensor(along_lane, dtype=torch.float64), steady])
    hazardous = torch_lane(scene, config, actions) + torch_clearance(scene, config, actions)
    jerk = config.jerk_weight * steps.square().sum(1).mean()
    stability = config.stability_weight * (actions - neutral).square().sum(1).mean()
    return (1.0 + danger) * hazardous + jerk + stability


@pytest.mark.parametrize("seed", range(6))
def test_total_against_autograd(seed: int) -> None:
    """The composite and its closed-form gradient equal a step-by-step version under autograd."""
    rng = np.random.default_rng(100 + seed)
    scene = random_context(rng)
    scene = replace(
        scene, clearance=replace(scene.clearance, closing_speed=float(rng.uniform(-2.0, 9.0)))
    )
    config = EnergyConfig()
    actions = chunks(rng, scene, 3)
    value, gradient = TotalEnergy(scene, config, LIMITS, HORIZON).evaluate(actions)
    for index, one in enumerate(actions):
        leaf = torch.tensor(one, requires_grad=True)
        expected = torch_energy(scene, config, leaf)
        expected.backward()
        assert leaf.grad is not None
        assert float(value[index]) == pytest.approx(float(expected.detach()), rel=1e-9)
        np.testing.assert_allclose(gradient[index], leaf.grad, atol=1e-9)


def test_total_is_the_sum_of_its_parts() -> None:
    """Value and gradient add up over the terms by name."""
    rng = np.random.default_rng(1)
    scene = replace(context(distance=2.0), expert_reference=np.tile([0.0, 3.0], (HORIZON, 1)))
    total = TotalEnergy(scene, EnergyConfig(), LIMITS, HORIZON)
    actions = chunks(rng, scene, 2)
    parts = {type(term): term.evaluate(actions)[0] for term in total.terms}
    assert set(parts) == {LaneEnergy, ClearanceEnergy, JerkEnergy, StabilityEnergy, ExpertEnergy}
    np.testing.assert_allclose(total.value(actions), sum(parts.values()))


def test_lower_is_better() -> None:
    """Braking before an object, steering to the centre and matching the expert lower the energy."""
    config = EnergyConfig()
    scene = context(bearing=0.0, distance=4.0, speed=6.0)
    obstacle = ClearanceEnergy(scene, config, LIMITS, HORIZON)
    assert obstacle.evaluate(constant(0.0, 2.0))[0] < obstacle.evaluate(constant(0.0, 8.0))[0]
    adherence = LaneEnergy(open_road(lane=lane(heading_error=0.0)), config, LIMITS, HORIZON)
    assert adherence.evaluate(constant(-0.05, 6.0))[0] < adherence.evaluate(constant(0.05, 6.0))[0]


def test_clearance_is_that_of_the_outline() -> None:
    """Standing before a wall, the energy is that of the gap between bumper disc and wall."""
    scene = context(bearing=0.0, distance=2.0, speed=0.0, previous=np.array([0.0, 0.0]))
    energy = ClearanceEnergy(scene, EnergyConfig(), LIMITS, HORIZON)
    gap = SCANNER.mount + 2.0 - DISC_CENTRES[-1] - DISC_RADIUS
    expected = (1.0 + hazard(2.0)) * ((3.0 - gap) / 2.0) ** 2
    value, _ = energy.evaluate(constant(0.0, 0.0))
    assert float(value[0]) == pytest.approx(expected, rel=1e-3)


def test_a_leading_car_is_less_of_an_obstacle_than_a_parked_one() -> None:
    """What the closing speed says about the object's own motion enters the prediction."""
    config, plan = EnergyConfig(), constant(0.0, 6.0)
    energies = []
    for closing in (12.0, 6.0, 0.0):  # oncoming at 6 m/s, parked, driving ahead at 6 m/s
        scene = context(bearing=0.0, distance=11.0, speed=6.0)
        scene = replace(scene, clearance=replace(scene.clearance, closing_speed=closing))
        energies.append(float(ClearanceEnergy(scene, config, LIMITS, HORIZON).evaluate(plan)[0][0]))
    assert energies[0] > energies[1] > energies[2] == 0.0


def test_a_plan_leaves_room_to_brake() -> None:
    """An object beyond the plan's end counts if the car could not stop before it, else not."""
    scene = context(bearing=0.0, distance=12.0, speed=8.0)
    short, long = (
        ClearanceEnergy(scene, EnergyConfig(braking=braking), LIMITS, HORIZON)
        for braking in (None, 4.0)
    )
    fast, slow = constant(0.0, 8.0), constant(0.0, 3.0)
    assert float(short.evaluate(fast)[0][0]) == 0.0  # 6.4 m driven, 5.6 m left
    assert float(long.evaluate(fast)[0][0]) > 0.0  # 8 m more to stop
    assert float(long.evaluate(slow)[0][0]) == 0.0
    assert float(long.evaluate(fast)[1][0, -1, 1]) > 0.0


def test_hazard_raises_the_adaptive_weights() -> None:
    """With h_t the lane weight and the obstacle weight grow by 1 + h."""
    far, near = (
        replace(context(), clearance=ClearanceEstimate(d, 0.0, 0.1, 0.0, True)) for d in (40.0, 0.5)
    )
    plan = constant(0.0, 6.0)
    ratio = float(
        LaneEnergy(near, EnergyConfig(), LIMITS, HORIZON).evaluate(plan)[0][0]
        / LaneEnergy(far, EnergyConfig(), LIMITS, HORIZON).evaluate(plan)[0][0]
    )
    expected = 1.0 + (1.0 - math.tanh(0.5 / 3.0))
    np.testing.assert_allclose(ratio, expected, rtol=1e-6)


def test_a_lane_change_is_not_undone() -> None:
    """A plan heading for the passing lane is judged by that lane, one that holds by its own."""
    offset = 1.2
    straight = lane(lateral_offset=offset, heading_error=0.0, curvature=0.0, curvature_rate=0.0)
    leaving = replace(straight, heading_error=0.2)
    plan = constant(0.0, 6.0)

    def lateral_pull(pose) -> float:  # type: ignore[no-untyped-def]
        scene = open_road(lane=pose)
        _, gradient = LaneEnergy(scene, EnergyConfig(), LIMITS, HORIZON).evaluate(plan)
        return -float(gradient[0, 0, 0])

    assert lateral_pull(straight) < 0.0 < lateral_pull(leaving)


def test_terms_without_anything_to_say_are_left_out() -> None:
    """A lost lane, an empty scan and no reference leave jerk and stability."""
    scene = open_road(lane=lane(valid=False, lateral_offset=math.nan))
    total = TotalEnergy(scene, EnergyConfig(), LIMITS, HORIZON)
    assert [type(term) for term in total.terms] == [JerkEnergy, StabilityEnergy]
    value, gradient = total.evaluate(constant(0.1, 5.0))
    assert bool(np.isfinite(value).all()) and bool(np.isfinite(gradient).all())


def test_no_point_that_counts_is_left_out() -> None:
    """Dropping what cannot come near changes the energy of no plan, not even the fastest."""

    class Everything(ClearanceEnergy):
        def _reachable(self, points: Array, velocities: Array) -> tuple[Array, Array]:
            return points, velocities

    plans = np.concatenate([constant(steering, 12.0) for steering in (-0.3, 0.0, 0.3)])
    seen = []
    for distance in np.linspace(2.0, 39.0, 20):
        scene = context(bearing=0.0, distance=float(distance), speed=12.0)
        scene = replace(scene, clearance=replace(scene.clearance, closing_speed=12.0))
        some, every = (
            kind(scene, EnergyConfig(), LIMITS, HORIZON) for kind in (ClearanceEnergy, Everything)
        )
        expected, _ = every.evaluate(plans)
        got = some.evaluate(plans)[0] if some.active else np.zeros(3)
        np.testing.assert_allclose(got, expected)
        seen.append(float(expected.max()))
    assert seen[0] > 0.0 == seen[-1]


@pytest.mark.parametrize(
    ("name", "value"),
    [("lane_scale", 0.0), ("clearance_scale", math.nan), ("jerk_weight", -0.1), ("forms", "own")],
)
def test_config_refuses_nonsense(name: str, value: object) -> None:
    """An impossible number or form is refused by name and value."""
    with pytest.raises(ValueError, match=f"`{name}` must .* Got {value!r}"):
        EnergyConfig(**{name: value})  # type: ignore[arg-type]


def test_table_ii_is_the_default() -> None:
    """The weights and scales that the paper gives are the defaults."""
    config = EnergyConfig()
    assert (config.jerk_weight, config.stability_weight, config.expert_weight) == (0.1, 0.5, 2.0)
    assert (config.lane_scale, config.clearance_scale) == (0.5, 2.0)


def test_the_discs_cover_the_car_whatever_its_size() -> None:
    """Every point of the outline lies in a disc, and none reaches far beyond it."""
    for vehicle in (VehicleGeometry(), VehicleGeometry(length=6.0, width=2.4, front_bumper=5.0)):
        centres, radius = cover(vehicle)
        x = np.linspace(-vehicle.rear_overhang, vehicle.front_bumper, 50)
        for y in (0.0, 0.5 * vehicle.width):
            distances = np.hypot(x[:, None] - centres, y).min(axis=1)
            assert float(distances.max()) <= radius + 1e-12
        assert radius < 0.75 * vehicle.width


def test_a_longer_car_is_nearer_to_what_is_ahead() -> None:
    """The obstacle term follows the car's outline and the scanner's mount in the context."""
    scene = context(bearing=0.0, distance=4.0)
    longer = replace(scene, vehicle=VehicleGeometry(length=5.5, front_bumper=4.6))
    plan = constant(0.0, 2.0)
    energies = [
        float(ClearanceEnergy(s, EnergyConfig(), LIMITS, HORIZON).evaluate(plan)[0][0])
        for s in (scene, longer)
    ]
    assert energies[1] > energies[0] > 0.0


def test_a_short_ranged_scanner_sees_nothing_at_its_range() -> None:
    """Beams that report the scanner's own range are no obstacle, however short that range is."""
    scanner = ScannerGeometry(max_range=6.0)
    scene = open_road(scan=np.full(180, 6.0), scanner=scanner)
    assert not ClearanceEnergy(scene, EnergyConfig(), LIMITS, HORIZON).active
    assert ClearanceEnergy(replace(scene, scanner=None), EnergyConfig(), LIMITS, HORIZON).active
