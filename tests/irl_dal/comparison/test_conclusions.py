import io

import pytest
from rich.console import Console

from irl_dal.comparison.presentation import best_projection, comparison_tables, conclusions
from tests.irl_dal.conftest import Compared


def results(**modes: tuple[float, float, float]) -> dict[str, object]:
    """Results of settings with the shield: success, energy and time of each mode."""
    arms = {
        f"trigger-{mode}-shield": {
            "activation": "trigger",
            "projection": mode,
            "shielded": True,
            "guided": True,
            "success": success,
            "success_ci95": [success - 0.1, success + 0.1],
            "latency_plan_p50_ms": time,
        }
        for mode, (success, _, time) in modes.items()
    }
    states = {mode: {"state_plan_energy": energy} for mode, (_, energy, _) in modes.items()}
    return {"settings": {"activations": ["trigger"]}, "arms": arms, "states": states}


def test_success_comes_first() -> None:
    """A mode whose interval does not reach the best is out, whatever its energy."""
    assert (
        best_projection(results(x0=(0.9, 5.0, 9.0), final=(0.7, 1.0, 3.0), none=(1.0, 0.0, 1.0)))
        == "x0"
    )


def test_among_equals_energy_then_time() -> None:
    """Modes that no interval can tell apart are judged by their plans, then by their cost."""
    assert best_projection(results(x0=(0.9, 1.0, 9.0), xt=(0.95, 2.0, 9.0))) == "x0"
    assert best_projection(results(x0=(0.9, 1.0, 9.0), adaptive=(0.9, 1.0, 5.0))) == "adaptive"


def test_the_finding_states_both_rates(compared: Compared) -> None:
    """Its numbers are the results'."""
    sentence = conclusions(compared.results)[0]
    rate = compared.results["arms"]["alone-none-bare"]["command_violation_rate"]
    assert f"{100.0 * rate:.1f} % broke a bound" in sentence
    assert "not one command" in sentence


def test_what_guidance_did_is_said(compared: Compared) -> None:
    """Successes and energies of the same mode with and without it."""
    sentence = conclusions(compared.results)[2]
    states, arms = compared.results["states"], compared.results["arms"]
    for name in ("x0", "x0, unguided"):
        assert f"{states[name]['state_plan_energy']:.2f}" in sentence
    for end in ("", "-unguided"):
        assert f"{100.0 * arms[f'alone-x0-shield{end}']['success']:.0f} %" in sentence
    blind = {name: {k: v for k, v in s.items() if "energy" not in k} for name, s in states.items()}
    assert "energy" not in conclusions({**compared.results, "states": blind})[-1]


def test_no_difference_is_not_an_interval(compared: Compared) -> None:
    """Two episodes that end alike are said to, instead of an interval of no width."""
    arms = compared.results["arms"]
    assert arms["trigger-x0-shield"]["success_vs_none_ci95"] == [0.0, 0.0]
    assert "paired difference 0 in every episode" in conclusions(compared.results)[1]


@pytest.mark.parametrize("width", [80, 120])
def test_the_tables_fit_a_terminal(compared: Compared, width: int) -> None:
    """Nothing is cut off, every setting has a row, with numbers as long as they come."""
    console = Console(width=width, record=True, file=io.StringIO())
    long = {
        **{"success": 1.0, "collisions_per_1k_steps": 10.25, "comfort_rms_jerk": 34.3},
        **{"ade_m": 16.19, "fde_m": 13.49, "latency_plan_p50_ms": 91.8},
        **{"latency_plan_p99_ms": 279.2, "nominal_violation_rate": 1.0},
        **{"nominal_violation_rate_planner": 1.0, "command_violation_rate": 1.0},
    }
    arms = {name: arm | long for name, arm in compared.results["arms"].items()}
    longest = max(arms, key=lambda name: len(arms[name]["label"]))
    arms[longest] = arms[longest] | {"label": "adaptive + shield, unguided"}
    for table in comparison_tables({**compared.results, "arms": arms}):
        console.print(table.printed())
    text = console.export_text()
    assert "…" not in text
    for words, times in (("279.2", len(arms)), ("[m/s²]", 2), ("10.25", len(arms))):
        assert text.count(words) == times, words
    assert text.count("x0 + shield, unguided") == 2
    assert text.count("adaptive + shield, unguided") == 2
    assert "planner alone, 2 episodes" in text
