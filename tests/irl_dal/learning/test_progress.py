"""The progress bar."""

from io import StringIO

from rich.console import Console

from irl_dal.learning.run_log import ProgressBar


def shown(terminal: bool) -> str:
    """What a bar draws for a short phase."""
    out = StringIO()
    console = Console(file=out, force_terminal=terminal, width=160)
    bar = ProgressBar(console)
    bar.begin("imitation", 0, 1000)
    numbers = {"time/steps_per_second": 81.6, "bc/loss": 0.0123, "count/command_violations": 0}
    for step in (250, 500, 750, 1000):
        bar.advance(step)
        bar.metrics(step, {**numbers, "time/total": 3.0})
    bar.end()
    return out.getvalue()


def test_a_terminal_gets_a_bar_with_phase_speed_and_key_metrics() -> None:
    """Phase, steps of steps, steps/s, losses."""
    text = shown(terminal=True)
    for part in ("imitation", "1000/1000", "82 steps/s", "BC 0.0123", "violations 0"):
        assert part in text


def test_a_file_gets_lines_without_escape_codes() -> None:
    """One line per phase and one for every fourth row of metrics."""
    lines = [line for line in shown(terminal=False).splitlines() if line.strip()]
    assert lines[0] == "imitation: 0 of 1000 steps"
    assert "1000/1000" in lines[1]
    assert len(lines) == 2
    assert "\x1b" not in "".join(lines)
