"""The FSM-partitioned replay buffer."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from expert.modes import Mode
from expert.replay import ReplayBatch, ReplayBuffer, Transition

FOLLOWING, AVOIDING, STRAIGHT, RETURNING = Mode


def small_buffer(capacity: int = 100, **arguments: int) -> ReplayBuffer:
    """A buffer of 2x2 images and four beams."""
    return ReplayBuffer(capacity, image_shape=(2, 2, 3), beams=4, context_size=3, **arguments)


def transition(
    number: int,
    *,
    mode: Mode = FOLLOWING,
    episode: int = 0,
    step: int | None = None,
    reward: float = 1.0,
    terminated: bool = False,
    intervened: bool = False,
    expert_drove: bool = True,
) -> Transition:
    """A transition whose label and context carry `number`."""
    return Transition(
        image=np.full((2, 2, 3), number % 256, np.uint8),
        lidar=np.full(4, number, np.float32),
        speed=np.full(1, number, np.float32),
        context=np.full(3, number, np.float32),
        label=np.full(2, number, np.float32),
        command=np.full(2, number, np.float32),
        mode=mode,
        episode=episode,
        step=number if step is None else step,
        reward=reward,
        terminated=terminated,
        intervened=intervened,
        expert_drove=expert_drove,
    )


def numbers(batch: ReplayBatch) -> list[int]:
    """Which transitions a batch holds."""
    return sorted(set(batch.labels[:, 0].astype(int).tolist()))


def test_sampling_is_balanced_over_modes_and_uniform_over_transitions() -> None:
    """A mode with 1 % of the data is a third of a balanced batch, 1 % of a uniform one."""
    buffer, rng = small_buffer(1000), np.random.default_rng(0)
    for number in range(900):
        buffer.add(transition(number))
    for number in range(900, 910):
        buffer.add(transition(number, mode=AVOIDING))
    for number in range(910, 1000):
        buffer.add(transition(number, mode=RETURNING))
    balanced = np.bincount(buffer.sample(rng, 3000).modes, minlength=4)
    assert balanced.tolist() == [1000, 1000, 0, 1000]
    uniform = np.bincount(buffer.sample(rng, 20_000, balanced=False).modes, minlength=4)
    assert uniform / 20_000 == pytest.approx([0.9, 0.01, 0.0, 0.09], abs=0.01)


def test_within_a_mode_every_transition_is_as_likely() -> None:
    """Ten transitions of one mode come up equally often."""
    buffer = small_buffer()
    for number in range(10):
        buffer.add(transition(number))
    drawn = buffer.sample(np.random.default_rng(0), 20_000).labels[:, 0].astype(int)
    assert np.bincount(drawn) / 20_000 == pytest.approx(np.full(10, 0.1), abs=0.01)


def test_a_batch_carries_what_was_stored() -> None:
    """Images, ranges, labels, commands and modes of a row belong together."""
    buffer = small_buffer()
    for number in range(20):
        buffer.add(transition(number, mode=Mode(number % 4)))
    batch = buffer.sample(np.random.default_rng(0), 64)
    expected = batch.labels[:, 0]
    assert np.array_equal(batch.images[:, 1, 1, 2], expected)
    assert np.array_equal(batch.lidar[:, 3], expected)
    assert np.array_equal(batch.speeds[:, 0], expected)
    assert np.array_equal(batch.commands[:, 1], expected)
    assert np.array_equal(batch.modes, expected % 4)


def test_a_full_buffer_drops_the_oldest_of_the_fullest_partition() -> None:
    """Rare modes survive a flood of a common one, and the newest of the common mode stay."""
    buffer = small_buffer(50)
    for number in range(10):
        buffer.add(transition(number, mode=AVOIDING))
    for number in range(10, 500):
        buffer.add(transition(number))
    assert len(buffer) == 50
    assert buffer.sizes == {FOLLOWING: 40, AVOIDING: 10, STRAIGHT: 0, RETURNING: 0}
    kept = numbers(buffer.sample(np.random.default_rng(0), 5000))
    assert kept == [*range(10), *range(460, 500)]


def test_episodes_may_come_in_turns() -> None:
    """Stretches and returns are those of each episode, whatever is stored between its steps."""
    buffer = small_buffer(horizon=3)
    for step in range(6):
        for episode in (2, 3):
            number = 100 * episode + step
            buffer.add(
                transition(number, episode=episode, step=step, reward=episode, terminated=step == 5)
            )
    _, commands = buffer.chunks(np.random.default_rng(0), 200)
    stretches = commands[..., 0].astype(int)
    assert np.all(np.diff(stretches, axis=1) == 1)
    assert set(stretches[:, 0]) == {200, 201, 202, 203, 300, 301, 302, 303}
    slots, values = buffer.returns(0.5)
    of = dict(zip(buffer.gather(slots).labels[:, 0].astype(int), values, strict=True))
    assert [of[205], of[204], of[303]] == [2.0, 3.0, 5.25]


def test_whole_episodes_are_held_out() -> None:
    """One episode in ten is never sampled for training and is all that validation sees."""
    buffer, rng = small_buffer(400), np.random.default_rng(0)
    for number in range(400):
        buffer.add(transition(number, episode=number // 20))
    held_out = {n for n in range(400) if n // 20 % 10 == 1}
    assert len(held_out) == 40
    assert set(numbers(buffer.sample(rng, 4000, held_out=True))) == held_out
    assert held_out.isdisjoint(numbers(buffer.sample(rng, 4000)))
    assert buffer.count(held_out=True) == 40
    assert buffer.count() == 360


def test_sources_select_who_drove() -> None:
    """Samples can be restricted to the expert's driving or to marked corrections."""
    buffer, rng = small_buffer(), np.random.default_rng(0)
    for number in range(30):
        buffer.add(transition(number, expert_drove=number < 10, intervened=number >= 25))
    assert numbers(buffer.sample(rng, 500, source="expert")) == list(range(10))
    corrected = buffer.sample(rng, 500, source="corrected")
    assert numbers(corrected) == list(range(25, 30))
    assert corrected.intervened.all()


def test_chunks_are_consecutive_expert_commands_of_one_episode() -> None:
    """No chunk crosses the end of an episode or a step that the expert did not drive."""
    buffer = small_buffer(horizon=4)
    number = 0
    for episode, length in ((0, 6), (2, 5), (3, 3)):
        for step in range(length):
            buffer.add(transition(number, episode=episode, step=step))
            number += 1
    for step in range(10):
        drove = step != 5
        buffer.add(transition(100 + step, episode=4, step=step, expert_drove=drove))
    contexts, chunks = buffer.chunks(np.random.default_rng(0), 2000)
    assert chunks.shape == (2000, 4, 2)
    first = chunks[:, 0, 0]
    assert np.array_equal(chunks[:, :, 0] - first[:, None], np.tile(np.arange(4.0), (2000, 1)))
    assert np.array_equal(contexts[:, 0], first)
    assert set(first.astype(int).tolist()) == {0, 1, 2, 6, 7, 100, 101, 106}
    assert buffer.count(source="chunk") == 8


def test_chunks_do_not_bridge_what_was_dropped() -> None:
    """A chunk is made of what is stored: where a step was evicted there is no chunk across it."""
    buffer = small_buffer(40, horizon=3)
    for number in range(200):
        mode = AVOIDING if number % 10 == 0 else FOLLOWING
        buffer.add(transition(number, mode=mode))
    chunks = buffer.chunks(np.random.default_rng(0), 1000)[1][:, :, 0]
    assert np.array_equal(np.diff(chunks, axis=1), np.ones((1000, 2)))


def test_returns_agree_with_the_sum_of_discounted_rewards() -> None:
    """Discounted returns against a direct sum; an unfinished tail goes on with the mean reward."""
    buffer, gamma = small_buffer(), 0.9
    rewards = np.random.default_rng(1).normal(size=12)
    for number, reward in enumerate(rewards):
        buffer.add(
            transition(number, episode=number // 6, reward=float(reward), terminated=number == 5)
        )
    slots, returns = buffer.returns(gamma)
    tail = float(rewards.astype(np.float32).mean()) / (1 - gamma)
    for slot, value in zip(slots, returns, strict=True):
        end = 6 if slot < 6 else 12
        direct = sum(gamma ** (k - slot) * rewards[k] for k in range(slot, end))
        direct += 0.0 if slot < 6 else gamma ** (12 - slot) * tail
        assert value == pytest.approx(direct, rel=1e-5)


@settings(max_examples=30, deadline=None)
@given(
    modes=st.lists(st.sampled_from(list(Mode)), min_size=1, max_size=120),
    shard=st.integers(min_value=1, max_value=40),
    capacity=st.integers(min_value=5, max_value=60),
)
def test_exports_rebuild_the_buffer_exactly(modes: list[Mode], shard: int, capacity: int) -> None:
    """A buffer restored from its shards draws the same samples and evicts the same transitions."""
    buffer, twin = small_buffer(capacity, horizon=2), small_buffer(capacity, horizon=2)
    shards, exported = [], 0
    for number, mode in enumerate(modes):
        buffer.add(transition(number, mode=mode, episode=number // 7, step=number % 7))
        if (number + 1) % shard == 0:
            shards.append(buffer.export_since(exported))
            exported = buffer.counter
    shards.append(buffer.export_since(exported))
    twin.restore(shards, buffer.live(), buffer.counter)
    for more in range(10):
        for copy in (buffer, twin):
            copy.add(transition(1000 + more, mode=Mode(more % 4), episode=100, step=more))
    for source in ("all", "expert", "chunk"):
        assert buffer.count(source=source) == twin.count(source=source)
    ours = buffer.sample(np.random.default_rng(3), 200)
    theirs = twin.sample(np.random.default_rng(3), 200)
    assert np.array_equal(ours.labels, theirs.labels)
    assert np.array_equal(ours.images, theirs.images)
    assert buffer.sizes == twin.sizes


def test_restore_refuses_shards_that_are_not_enough() -> None:
    """A missing shard is an error, not a smaller buffer."""
    buffer = small_buffer()
    for number in range(10):
        buffer.add(transition(number))
    with pytest.raises(ValueError, match="hold 5 of the 10"):
        small_buffer().restore([buffer.export_since(5)], buffer.live(), buffer.counter)


def test_wrong_shapes_and_sizes_are_refused() -> None:
    """Every refusal names the argument and shows the value."""
    with pytest.raises(ValueError, match="`capacity` must be .*at least 1. Got 0"):
        ReplayBuffer(0)
    with pytest.raises(ValueError, match="`held_out_every` must be .*at least 2. Got 1"):
        small_buffer(held_out_every=1)
    buffer = ReplayBuffer(10)
    with pytest.raises(ValueError, match=r"`image` must have shape \(64, 64, 3\)"):
        buffer.add(transition(0))
    with pytest.raises(ValueError, match="nothing stored qualifies"):
        small_buffer().sample(np.random.default_rng(0), 4)
    filled = small_buffer()
    filled.add(transition(0))
    with pytest.raises(ValueError, match="`source` must be one of"):
        filled.sample(np.random.default_rng(0), 4, source="other")


def test_joined_batches_keep_their_rows() -> None:
    """Joining is concatenation, field by field."""
    buffer, rng = small_buffer(), np.random.default_rng(0)
    for number in range(30):
        buffer.add(transition(number))
    first, second = buffer.sample(rng, 5), buffer.sample(rng, 3)
    joined = ReplayBatch.join(first, second)
    assert len(joined) == 8
    assert np.array_equal(joined.images[5:], second.images)
    assert np.array_equal(joined.labels[:5], first.labels)
