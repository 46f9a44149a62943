import numpy as np
import pytest

from irl_dal.planner.noise_schedule import NoiseSchedule, ScheduleKind

KINDS: tuple[ScheduleKind, ...] = ("cosine", "printed")


@pytest.mark.parametrize("kind", KINDS)
def test_signal_only_fades(kind: ScheduleKind) -> None:
    """alpha-bar starts at 1, falls at every step and its betas reproduce it."""
    schedule = NoiseSchedule.make(kind, 100)
    assert schedule.steps == 100
    assert schedule.alpha_bar[0] == 1.0
    assert bool(np.all(np.diff(schedule.alpha_bar) < 0))
    np.testing.assert_allclose(np.cumprod(1 - schedule.beta), schedule.alpha_bar, atol=1e-15)


def test_the_cosine_schedule_ends_in_noise_and_the_printed_one_does_not() -> None:
    """Cosine leaves less than 0.1 % of the signal at T; the paper's leaves 60 %."""
    left = {kind: np.sqrt(NoiseSchedule.make(kind, 100).alpha_bar[-1]) for kind in KINDS}
    assert left["cosine"] < 1e-3
    assert left["printed"] == pytest.approx(0.60, abs=0.01)


def test_printed_schedule_is_the_paper_s() -> None:
    """The printed betas run from 1e-4 to 0.02 linearly."""
    beta = NoiseSchedule.make("printed", 100).beta
    np.testing.assert_allclose(beta[1:], np.linspace(1e-4, 0.02, 100), rtol=1e-9)


def test_arrays_are_read_only() -> None:
    """A schedule cannot be changed by accident."""
    with pytest.raises(ValueError, match="read-only"):
        NoiseSchedule.make().alpha_bar[0] = 0.0


def test_nonsense_is_refused() -> None:
    """An unknown kind and a single step are refused by name and value."""
    with pytest.raises(ValueError, match="`schedule` must be one of .* Got 'linear'"):
        NoiseSchedule.make("linear", 100)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="`diffusion_steps` must be at least 2. Got 1"):
        NoiseSchedule.make("cosine", 1)
