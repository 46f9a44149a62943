"""Returns of expert and random actions, remembered so that no evaluation drives them twice."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from irl_dal.storage.atomic import write_json

__all__ = ["ReferenceCache"]

FILE_NAME = "references.json"


@dataclass(frozen=True, slots=True)
class ReferenceCache:
    """A JSON file {city: {driver: {seed: return}}} beside the runs.

    Attributes:
        path: The file; it need not exist.
        city: Hash of everything that the returns depend on.
    """

    path: Path
    city: str

    @classmethod
    def beside(cls, runs: Path, city: str) -> ReferenceCache:
        """The cache in a folder of runs."""
        return cls(runs / FILE_NAME, city)

    def known(self, driver: str) -> dict[int, float]:
        """Returns of a driver by seed, as far as they are known."""
        return self._read().get(self.city, {}).get(driver, {})

    def add(self, driver: str, returns: Mapping[int, float]) -> None:
        """Remember returns by seed."""
        content = self._read()
        content.setdefault(self.city, {}).setdefault(driver, {}).update(returns)
        write_json(self.path, content)

    def _read(self) -> dict[str, dict[str, dict[int, float]]]:
        """What the file holds: nothing if it is missing or damaged, it is only a cache."""
        try:
            content = json.loads(self.path.read_text(encoding="utf-8"))
            return {
                city: {
                    driver: {int(seed): float(value) for seed, value in returns.items()}
                    for driver, returns in drivers.items()
                }
                for city, drivers in content.items()
            }
        except (FileNotFoundError, ValueError, TypeError, AttributeError):
            return {}
