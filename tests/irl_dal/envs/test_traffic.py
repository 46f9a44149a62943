"""Traffic is never empty, always leaves a way, and pedestrians wait for a gap."""

import numpy as np
import pytest

from irl_dal.envs import CityConfig, CityEnv
from irl_dal.envs.road import HALF_WIDTH, HOME_LANE, LANE_WIDTH
from irl_dal.envs.traffic import COMFORTABLE, Crossing, draw_crossing


@pytest.mark.parametrize("difficulty", ["easy", "paper", "hard"])
def test_there_is_traffic_and_a_way_through(difficulty: str) -> None:
    """Something to overtake in every episode, and nothing in the passing lane."""
    env = CityEnv(CityConfig(difficulty=difficulty))
    for seed in range(15):
        env.reset(seed=seed)
        scene = env.scene()
        own = [o for o in scene.obstacles if abs(o.d - HOME_LANE) < 0.5 * LANE_WIDTH]
        assert own and any(o.cruise < 0.0 for o in scene.obstacles)
        places = sorted(o.s for o in own)
        assert np.diff(places).min(initial=99.0) > 30.0
        for o in scene.obstacles:
            assert o in own or o.d > 0.0 or abs(o.d) > HALF_WIDTH, (o.kind, o.d)
    env.close()


def test_harder_means_more() -> None:
    """Obstacles per road grow with the difficulty; pedestrians and slow cars are among them."""
    counts = {}
    for difficulty in ("easy", "paper", "hard"):
        env = CityEnv(CityConfig(difficulty=difficulty, route_spread=0.0))
        kinds: list[str] = []
        for seed in range(10):
            env.reset(seed=seed)
            kinds += [o.kind if o.cruise == 0.0 else "moving" for o in env.scene().obstacles]
        env.close()
        counts[difficulty] = len(kinds)
        if difficulty != "easy":
            assert {"car", "barrel", "pedestrian", "moving"} <= set(kinds)
    assert counts["easy"] < counts["paper"] < counts["hard"]


def test_a_pedestrian_enters_only_where_the_car_can_stop() -> None:
    """Whatever the gap and the speed, entering the lanes leaves room for 2 m/s^2."""
    rng = np.random.default_rng(0)
    before_the_car = after_the_car = 0
    for _ in range(300):
        crossing = draw_crossing(rng, HALF_WIDTH)
        gap, speed, d = float(rng.uniform(5.0, 60.0)), float(rng.uniform(1.0, 12.0)), crossing.start
        inside = False
        while gap > -30.0 and not inside:
            d += 0.1 * crossing.pace(d, gap, speed, wait=False)
            inside = -HALF_WIDTH < d < 0.0
            gap -= 0.1 * speed
        if inside:
            gap += 0.1 * speed
            assert gap < -5.0 or gap > speed**2 / (2.0 * COMFORTABLE), (gap, speed)
            before_the_car += gap > 0.0
            after_the_car += gap < 0.0
    assert before_the_car > 20 and after_the_car > 20


def test_a_pedestrian_arrives() -> None:
    """With no car coming nearer it takes the way over the speed, and ends on the other side."""
    crossing = Crossing(-8.5, 8.5, 1.2, 35.0)
    d, steps = crossing.start, 0
    while crossing.pace(d, 35.0, 0.0, wait=False) != 0.0 and steps < 400:
        d += 0.1 * crossing.pace(d, 35.0, 0.0, wait=False)
        steps += 1
    assert d == pytest.approx(8.5, abs=0.2)
    assert steps == pytest.approx(17.0 / 0.12, abs=2)


def test_a_waiting_car_is_let_no_deadlock() -> None:
    """A standing car lets the pedestrian cross."""
    crossing = Crossing(-8.5, 8.5, 1.2, 35.0)
    assert crossing.pace(-7.6, 5.0, 0.0, wait=False) > 0.0
    assert crossing.pace(-7.6, 5.0, 6.0, wait=False) == 0.0
    assert crossing.pace(-7.6, 5.0, 0.0, wait=True) == 0.0


def test_slow_cars_wait_to_be_met() -> None:
    """A slow car far ahead stands until the ego is near, so that it can be overtaken."""
    env = CityEnv(CityConfig(difficulty="hard", lane_sensor="odometry"))
    env.camera_on = False
    for seed in range(30):
        env.reset(seed=seed)
        slow = [o for o in env.scene().obstacles if o.cruise > 0.0 and o.s > 100.0]
        if slow:
            break
    before = slow[0].s
    for _ in range(10):
        env.execute(np.array([0.0, 3.0]))
    assert slow[0].s == before and 2.0 <= slow[0].cruise <= 5.0
    env.close()
