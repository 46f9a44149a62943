"""What was driven so far, one JSON file per episode: an interrupted comparison goes on.

<out>/settings.json               what the results depend on
<out>/states/<seed>.json          the expert's path, and plans in its risky states
<out>/episodes/<arm>/<seed>.json  rows of every number of one episode
<out>/compare.json, index.html    written at the end
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from irl_dal.config import ConfigError
from irl_dal.storage.atomic import write_json

__all__ = ["ComparisonStore"]

FORMAT = 1
"""Raised whenever this version could misread the files of an older one."""


@dataclass(frozen=True, slots=True)
class ComparisonStore:
    """The folder of a comparison.

    Attributes:
        folder: Made on the first write.
    """

    folder: Path

    @property
    def report(self) -> Path:
        """The numbers."""
        return self.folder / "compare.json"

    @property
    def page(self) -> Path:
        """The page."""
        return self.folder / "index.html"

    @property
    def film(self) -> Path:
        """The side-by-side video; the page embeds it."""
        return self.folder / "film.webm"

    def open(self, settings: Mapping[str, object]) -> None:
        """Begin a comparison or go on with one.

        Args:
            settings: All that one episode's numbers depend on, ready for JSON.

        Raises:
            ConfigError: The folder holds something else, or results under other settings.
        """
        path = self.folder / "settings.json"
        wanted = json.loads(json.dumps({"format": FORMAT, **settings}))
        where = f"out = {str(self.folder)!r}"
        if not path.exists():
            if self.folder.exists() and (not self.folder.is_dir() or any(self.folder.iterdir())):
                raise ConfigError(f"{where}: not empty and not the folder of a comparison")
            write_json(path, wanted)
            return
        known = _read(path)
        if known is None:
            raise ConfigError(f"{where}: settings.json is damaged")
        ours, theirs = _flat(wanted), _flat(known)
        for key in {**ours, **theirs}:
            if theirs.get(key) != ours.get(key):
                was, now = (_short(content.get(key)) for content in (theirs, ours))
                raise ConfigError(
                    f"{where}: holds a comparison with {key} = {was}, asked for is {now}; "
                    "choose another folder"
                )

    def states(self, seed: int) -> dict[str, Any] | None:
        """What is known of an expert's episode; None if nothing is."""
        return _read(self._states(seed))

    def episode(self, arm: str, seed: int) -> dict[str, Any] | None:
        """What is known of an arm's episode; None if it was not driven yet."""
        return _read(self._episode(arm, seed))

    def keep_states(self, seed: int, content: Mapping[str, object]) -> None:
        """Remember an expert's episode."""
        write_json(self._states(seed), content)

    def keep_episode(self, arm: str, seed: int, content: Mapping[str, object]) -> None:
        """Remember an arm's episode."""
        write_json(self._episode(arm, seed), content)

    def missing_states(self, seeds: Sequence[int], arms: Sequence[str]) -> list[int]:
        """Seeds whose risky states some arm has not planned in."""
        return [
            seed
            for seed in seeds
            if (known := self.states(seed)) is None or not set(arms) <= set(known["plans"])
        ]

    def missing_episodes(self, arm: str, seeds: Sequence[int]) -> list[int]:
        """Seeds that an arm has not driven."""
        return [seed for seed in seeds if self.episode(arm, seed) is None]

    def _states(self, seed: int) -> Path:
        return self.folder / "states" / f"{seed}.json"

    def _episode(self, arm: str, seed: int) -> Path:
        return self.folder / "episodes" / arm / f"{seed}.json"


def _read(path: Path) -> dict[str, Any] | None:
    """A file's content; None if it is missing or damaged, then it is made anew."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError):
        return None
    return dict(content) if isinstance(content, dict) else None


def _flat(content: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested settings under dotted names."""
    flat: dict[str, Any] = {}
    for key, value in content.items():
        name = f"{prefix}{key}"
        flat |= _flat(value, f"{name}.") if isinstance(value, dict) else {name: value}
    return flat


def _short(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
