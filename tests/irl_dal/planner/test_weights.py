"""The planner's loss, and which weights it plans with."""

import numpy as np
import pytest
import torch

from tests.irl_dal.planner.scenes import HORIZON, LIMITS, context, planner


def test_loss_trains_the_network_and_the_next_plan_sees_it() -> None:
    """Gradient steps lower the loss, and planning uses the new weights at once."""
    made = planner(width=16)
    scene = context()
    rng = torch.Generator().manual_seed(0)
    contexts = torch.from_numpy(scene.encode()).expand(64, -1)
    target = torch.tensor([0.1, 0.2]) + 0.02 * torch.randn((64, HORIZON, 2), generator=rng)
    optimizer = torch.optim.Adam(made.denoiser.parameters(), lr=1e-3)
    before = made.plan(scene).nominal
    losses = []
    for _ in range(60):
        loss = made.loss(contexts, target)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert np.mean(losses[-5:]) < 0.1 * losses[0]
    after = made.plan(scene).nominal
    target = LIMITS.to_command([0.1, 0.2])
    assert np.abs(after - target).mean() < 0.3 * np.abs(before - target).mean()


def test_written_weights_are_used_from_the_next_episode_on() -> None:
    """A weight written in place after a plan counts after `reset`."""
    made = planner(seed=1)
    plans = []
    for value in (None, 0.5):
        if value is not None:
            with torch.no_grad():
                made.denoiser.out.bias.fill_(value)
        made.reset()
        made.generator.manual_seed(9)
        plans.append(made.plan(context()).nominal)
    assert not np.array_equal(*plans)


def test_weights_travel() -> None:
    """A planner with another's weights makes another's plan, given the same noise."""
    first, second = planner(seed=1), planner(seed=2)
    second.plan(context())
    second.load_state_dict(first.denoiser.state_dict())
    for made in (first, second):
        made.generator.manual_seed(9)
    plans = [made.plan(context()) for made in (first, second)]
    np.testing.assert_array_equal(plans[0].nominal, plans[1].nominal)
    assert len(list(first.denoiser.parameters())) == len(first.denoiser.state_dict())


def test_loss_refuses_wrong_shapes() -> None:
    """Contexts and chunks of the wrong size are refused by name."""
    made = planner()
    with pytest.raises(ValueError, match=r"`contexts` must be \(4, 64\). Got \(4, 63\)"):
        made.loss(torch.zeros(4, 63), torch.zeros(4, 8, 2))
    with pytest.raises(ValueError, match=r"`chunks` must be \(4, 8, 2\). Got \(4, 6, 2\)"):
        made.loss(torch.zeros(4, 64), torch.zeros(4, 6, 2))


@pytest.mark.parametrize("prediction", ["x0", "epsilon"])
def test_loss_of_a_perfect_network_is_zero(
    prediction: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The loss compares with the clean chunk or with the noise, at the level it was noised to."""
    made = planner(prediction=prediction)
    chunks = torch.full((32, HORIZON, 2), 0.3)
    bar = torch.tensor(made._schedule.alpha_bar, dtype=torch.float32)

    def perfect(noisy: torch.Tensor, k: torch.Tensor, contexts: torch.Tensor) -> torch.Tensor:
        kept = bar[k][:, None, None]
        return chunks if prediction == "x0" else (noisy - kept.sqrt() * chunks) / (1 - kept).sqrt()

    monkeypatch.setattr(made, "denoiser", perfect)
    loss = made.loss(torch.zeros(32, 64), chunks)
    assert float(loss) < 1e-8
