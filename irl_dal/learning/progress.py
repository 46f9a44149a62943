"""Observers of a training run: their interface, and a progress bar in the terminal."""

import time
from collections.abc import Mapping
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

__all__ = ["Observer", "ProgressBar"]

SHOWN = {  # key metrics of the bar, in this order
    "rollout/success_rate": "success {:.0%}",
    "rollout/episode_return": "return {:.0f}",
    "bc/loss": "BC {:.4f}",
    "planner/loss": "planner {:.3f}",
    "rollout/intervention_rate": "planner on {:.1%}",
    "discriminator/accuracy": "D {:.0%}",
    "count/command_violations": "violations {:.0f}",
}


class Observer(Protocol):
    """Receives what a pipeline does; must not disturb it."""

    def begin(self, phase: str, step: int, last: int) -> None:
        """A phase begins at `step` and ends at `last`."""

    def advance(self, step: int) -> None:
        """`step` environment steps are done."""

    def metrics(self, step: int, values: Mapping[str, float]) -> None:
        """A row of metrics was written."""

    def end(self) -> None:
        """The run is over, complete or not."""


class ProgressBar:
    """Phase, bar, steps per second, time left and key metrics.

    Where there is no terminal, a line for every `every` rows of metrics.
    """

    def __init__(self, console: Console, every: int = 4) -> None:
        self.console, self.every = console, every
        self._shown: dict[str, float] = {}
        self._rows = self._last = 0
        self._phase = ""
        self._clock = (0, time.monotonic())
        self._bar = Progress(
            TextColumn("[bold]{task.description}"),
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[metrics]}"),
            console=self.console,
            refresh_per_second=4,
            disable=not self.console.is_terminal,
        )
        self._task = self._bar.add_task("", total=None, metrics="")

    def begin(self, phase: str, step: int, last: int) -> None:
        """Show the phase."""
        self._phase, self._last = phase, last
        self._clock = (step, time.monotonic())
        if not self.console.is_terminal:
            self.console.print(f"{phase}: {step} of {last} steps")
        self._bar.start()
        self._bar.reset(self._task, description=phase, completed=step, total=last)

    def advance(self, step: int) -> None:
        """Move the bar."""
        self._bar.update(self._task, completed=step)

    def metrics(self, step: int, values: Mapping[str, float]) -> None:
        """Show the newest of the key metrics."""
        self._shown |= {key: float(value) for key, value in values.items() if key in SHOWN}
        self._rows += 1
        if not self.console.is_terminal and self._rows % self.every:
            return
        (earlier, then), now = self._clock, time.monotonic()
        self._clock = (step, now)
        text = f"{(step - earlier) / max(now - then, 1e-9):.0f} steps/s  " + "  ".join(
            form.format(self._shown[k]) for k, form in SHOWN.items() if k in self._shown
        )
        self._bar.update(self._task, metrics=text)
        if not self.console.is_terminal:
            self.console.print(f"{self._phase}  {step}/{self._last}  {text}")

    def end(self) -> None:
        """Take the bar away."""
        self._bar.stop()
