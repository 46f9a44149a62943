"""The experience buffer, one partition for each driving mode (paper: D_s, D_expert = union of D_s).

| here | paper |
|---|---|
| `Transition` | (o_t, a_t^final, a_t^*, r_t) with s_FSM,t and the correction marker |
| `Transition.label` | a_t^*, what behaviour cloning imitates |
| `Transition.command` | the executed action; the planner's chunks {a_t ... a_t+H-1} are of these |
| `balanced=True` | sampling evenly across the FSM states |

Storage is reserved at once but costs memory only as it fills: `np.zeros` commits on first write.
"""

import math
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from expert.modes import Mode
from shield.errors import check_within

Indices = NDArray[np.int64]

# Sources of samples: all transitions, those that the expert drove, intervened steps
SOURCES = ("all", "expert", "corrected")


@dataclass(frozen=True, slots=True)
class Transition:
    """One control step, as it is stored."""

    image: NDArray[np.uint8]  # Camera frame (64, 64, 3), uint8
    lidar: NDArray[np.float32]  # Ranges (180,) [m]
    speed: NDArray[np.float32]  # Measured speed (1,) [m/s]
    context: NDArray[np.float32]  # The planner's conditioning vector (64,), normalised
    # What the expert would do in this state, its set-point (2,), normalised
    label: NDArray[np.float32]
    command: NDArray[np.float32]  # What was executed (2,), normalised
    mode: Mode  # FSM state of the expert
    episode: int  # Number of the episode, never used twice
    step: int  # Step within the episode
    reward: float  # Environment reward of the step
    terminated: bool  # The step ended the episode (not by a time limit)
    intervened: bool  # The planner acted on this step: the marker of experience correction
    expert_drove: bool  # `command` is the expert's


@dataclass(frozen=True, slots=True)
class ReplayBatch:
    """B stored transitions (copies)."""

    images: NDArray[np.uint8]  # (B, 64, 64, 3) uint8
    lidar: NDArray[np.float32]  # (B, 180) [m]
    speeds: NDArray[np.float32]  # (B, 1) [m/s]
    contexts: NDArray[np.float32]  # Estimates (B, 64), normalised
    labels: NDArray[np.float32]  # Expert set-points (B, 2), normalised
    commands: NDArray[np.float32]  # Executed commands (B, 2), normalised
    modes: NDArray[np.int8]  # (B,)
    intervened: NDArray[np.bool_]  # (B,)

    def __len__(self) -> int:
        return len(self.labels)

    @classmethod
    def join(cls, first: Self, second: Self) -> Self:
        """Both batches, one after the other."""
        names = [entry.name for entry in fields(cls)]
        return cls(*(np.concatenate([getattr(b, name) for b in (first, second)]) for name in names))


class ReplayBuffer:
    """Transitions of all episodes, in partitions by FSM state.

    When the buffer is full, the oldest transition of the fullest partition leaves, so that rare
    modes stay. Every `held_out_every`-th episode is kept out of training, for validation; the
    split goes by episode because neighbouring frames are nearly the same.

    `capacity` counts the transitions over all partitions (Table II: 50,000), `horizon` is the
    length H of the planner's chunks (Table II: 8). `ValueError` for sizes that are not positive.
    """

    def __init__(
        self,
        capacity: int = 50_000,
        *,
        horizon: int = 8,
        image_shape: tuple[int, int, int] = (64, 64, 3),
        beams: int = 180,
        context_size: int = 64,
        held_out_every: int = 10,
    ) -> None:
        check_within(ValueError, 1, math.inf, capacity=capacity, horizon=horizon)
        check_within(ValueError, 2, math.inf, held_out_every=held_out_every)
        self.capacity, self.horizon = capacity, horizon
        self.held_out_every = held_out_every
        self._data: dict[str, NDArray[Any]] = {
            "image": np.zeros((capacity, *image_shape), np.uint8),
            "mode": np.zeros(capacity, np.int8),
            "reward": np.zeros(capacity, np.float32),
        }
        widths = {"lidar": beams, "speed": 1, "context": context_size, "label": 2, "command": 2}
        for name, width in widths.items():
            self._data[name] = np.zeros((capacity, width), np.float32)
        for name in ("episode", "step", "serial"):
            self._data[name] = np.zeros(capacity, np.int64)
        for name in ("terminated", "intervened", "expert_drove"):
            self._data[name] = np.zeros(capacity, np.bool_)
        self._following = np.full(capacity, -1, np.int64)
        self._queues: dict[Mode, deque[int]] = {mode: deque() for mode in Mode}
        self._cache: dict[tuple[object, ...], list[Indices]] = {}
        self._size = 0
        self.counter = 0  # Transitions ever added; the serial number of the next one
        self._latest: dict[int, int] = {}

    def __len__(self) -> int:
        return self._size

    @property
    def sizes(self) -> dict[Mode, int]:
        """Transitions in each partition."""
        return {mode: len(queue) for mode, queue in self._queues.items()}

    def add(self, transition: Transition) -> None:
        """Store a transition, dropping the oldest of the fullest partition if there is no room.

        `ValueError` for an array of another shape than the buffer's.
        """
        values = {entry.name: getattr(transition, entry.name) for entry in fields(transition)}
        for name, value in values.items():
            expected, got = self._data[name].shape[1:], np.shape(value)
            if got != expected:
                raise ValueError(f"`{name}` must have shape {expected}. Got {got}.")
        self._insert(values | {"serial": self.counter})

    def sample(
        self,
        rng: np.random.Generator,
        size: int,
        *,
        balanced: bool = True,
        held_out: bool = False,
        source: str = "all",
    ) -> ReplayBatch:
        """Draw B = `size` transitions of a source (one of `SOURCES`) with replacement.

        Balanced evenly over the modes that have any; otherwise each transition is as likely.
        `held_out` draws from the validation split. `ValueError` if nothing qualifies.
        """
        return self.gather(self._draw(rng, size, self._groups(source, held_out), balanced))

    def chunks(
        self,
        rng: np.random.Generator,
        size: int,
        *,
        balanced: bool = True,
        held_out: bool = False,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Draw B = `size` stretches of consecutive commands that the expert executed, as `sample`.

        Contexts of the first steps (B, 64) and commands (B, H, 2), normalised.
        """
        slots = self._draw(rng, size, self._groups("chunk", held_out), balanced)
        steps = [slots]
        for _ in range(self.horizon - 1):
            steps.append(self._following[steps[-1]])
        return self._data["context"][slots], self._data["command"][np.stack(steps, axis=1)]

    def count(self, *, held_out: bool = False, source: str = "all") -> int:
        """Transitions that `sample` would draw from ("chunk": stretches for `chunks`)."""
        return sum(len(group) for group in self._groups(source, held_out))

    def gather(self, slots: Indices) -> ReplayBatch:
        """The transitions at the given places."""
        names = ("image", "lidar", "speed", "context", "label", "command", "mode", "intervened")
        return ReplayBatch(*(self._data[name][slots] for name in names))

    def returns(self, gamma: float) -> tuple[Indices, NDArray[np.float32]]:
        """Discounted return of the environment reward for everything stored.

        Places for `gather` (N,) and returns (N,), newest first. Where a stretch stops without an
        end of the episode, the mean reward is taken to go on for ever. `gamma` is in [0, 1), else
        `ValueError`.
        """
        if not 0.0 <= gamma < 1.0:
            raise ValueError(f"`gamma` must be in [0, 1). Got {gamma}.")
        slots = self._in_order()[::-1]
        rewards, terminated = self._data["reward"], self._data["terminated"]
        tail = float(rewards[slots].mean()) / (1.0 - gamma) if len(slots) else 0.0
        values = np.zeros(self.capacity, np.float64)
        for slot in slots:
            following = self._following[slot]
            ahead = values[following] if following >= 0 else 0.0 if terminated[slot] else tail
            values[slot] = rewards[slot] + gamma * ahead
        return slots, values[slots].astype(np.float32)

    def export_since(self, counter: int) -> dict[str, NDArray[Any]]:
        """What was added since `counter` and is still here, oldest first, as arrays (N, ...)."""
        slots = self._in_order()
        slots = slots[self._data["serial"][slots] >= counter]
        return {name: values[slots] for name, values in self._data.items()}

    def live(self) -> Indices:
        """Serial numbers of everything stored, oldest first."""
        serials: Indices = self._data["serial"][self._in_order()]
        return serials

    def restore(
        self, shards: Iterable[Mapping[str, NDArray[Any]]], live: Indices, counter: int
    ) -> None:
        """Become the buffer that wrote the exports `shards`: what it samples next is the same.

        `live` and `counter` are that buffer's; what it had dropped is skipped. `ValueError` if this
        buffer is not empty, or the shards, oldest first, do not hold all of `live`.
        """
        if self._size:
            raise ValueError(f"`restore` needs an empty buffer. Got {self._size} transitions.")
        for shard in shards:
            for row in np.flatnonzero(np.isin(shard["serial"], live)):
                self._insert({name: shard[name][row] for name in self._data})
        if not np.array_equal(self.live(), live):
            raise ValueError(f"`shards` hold {self._size} of the {len(live)} stored transitions.")
        self.counter = counter

    def _insert(self, values: Mapping[str, Any]) -> None:
        mode = Mode(int(values["mode"]))
        slot = self._evict() if self._size == self.capacity else self._size
        for name, value in values.items():
            self._data[name][slot] = value
        self._queues[mode].append(slot)
        self._link(slot)
        self._size += 1
        self.counter = int(values["serial"]) + 1
        self._cache.clear()

    def _link(self, slot: int) -> None:
        """Join a transition to its episode's newest one; episodes may come in turns."""
        episode, step = int(self._data["episode"][slot]), self._data["step"]
        latest = self._latest.get(episode, -1)
        joined = latest >= 0 and step[latest] + 1 == step[slot]
        self._following[slot] = -1
        if joined:
            self._following[latest] = slot
        self._latest[episode] = slot

    def _evict(self) -> int:
        fullest = max(self._queues.values(), key=len)
        slot = fullest.popleft()
        self._following[self._following == slot] = -1
        episode = int(self._data["episode"][slot])
        if self._latest.get(episode) == slot:
            del self._latest[episode]
        self._size -= 1
        return slot

    def _in_order(self) -> Indices:
        slots = np.arange(self._size, dtype=np.int64)
        return slots[np.argsort(self._data["serial"][: self._size], kind="stable")]

    def _groups(self, source: str, held_out: bool) -> list[Indices]:
        """Places that qualify, one array for each mode that has any (kept until the next `add`)."""
        key = (source, held_out)
        if key not in self._cache:
            chosen = self._qualifies(source)
            split = self._data["episode"][: self._size] % self.held_out_every == 1
            chosen &= split if held_out else ~split
            modes = self._data["mode"][: self._size]
            order = self._in_order()
            groups = [order[(chosen & (modes == mode))[order]] for mode in Mode]
            self._cache[key] = [group for group in groups if len(group)]
        return self._cache[key]

    def _qualifies(self, source: str) -> NDArray[np.bool_]:
        drove = self._data["expert_drove"][: self._size].copy()
        if source == "all":
            return np.ones(self._size, np.bool_)
        if source == "expert":
            return drove
        if source == "corrected":
            return self._data["intervened"][: self._size].copy()
        if source == "chunk":
            qualifies, place = drove.copy(), np.arange(self._size, dtype=np.int64)
            for _ in range(self.horizon - 1):
                place = np.where(place >= 0, self._following[place], -1)
                qualifies &= (place >= 0) & drove[place]
            return qualifies
        raise ValueError(f"`source` must be one of {SOURCES}. Got {source!r}.")

    @staticmethod
    def _draw(
        rng: np.random.Generator, size: int, groups: list[Indices], balanced: bool
    ) -> Indices:
        if not groups:
            raise ValueError("nothing stored qualifies for this sample.")
        slots: Indices = np.concatenate(groups)
        if not balanced:
            return slots[rng.integers(len(slots), size=size)]
        which = (np.arange(size) + rng.integers(len(groups))) % len(groups)
        lengths = np.array([len(group) for group in groups])
        within = (rng.random(size) * lengths[which]).astype(np.int64)
        starts: Indices = np.cumsum(lengths) - lengths
        drawn: Indices = slots[starts[which] + within]
        return drawn
