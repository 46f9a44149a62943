"""Where the processor time of some work goes."""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from typing import Any
from unittest.mock import patch


def time_parts(
    parts: Mapping[str, Sequence[tuple[type, str]]], work: Callable[[], object]
) -> dict[str, float]:
    """Processor time that `work()` spends in the methods of each part, and in the rest [s]."""
    spent = dict.fromkeys(parts, 0.0)

    def timed(call: Callable[..., Any], part: str) -> Callable[..., Any]:
        def watched(*args: Any, **kwargs: Any) -> Any:
            begun = time.process_time()
            result = call(*args, **kwargs)
            spent[part] += time.process_time() - begun
            return result

        return watched

    with ExitStack() as stack:
        for part, methods in parts.items():
            for owner, name in methods:
                watched = timed(getattr(owner, name), part)
                stack.enter_context(patch.object(owner, name, watched))
        begun = time.process_time()
        work()
        total = time.process_time() - begun
    return spent | {"rest": total - sum(spent.values())}
