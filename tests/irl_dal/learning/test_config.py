import pytest

from irl_dal.learning import LearningConfig


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("imitation_steps", 0),
        ("mixed_steps", -1),
        ("sampling", "other"),
        ("saec", "x"),
        ("first_seed", -1),
        ("log_interval", 0),
        ("n_envs", 0),
        ("mixed_steps", 29_999),
    ],
)
def test_impossible_values_are_refused(key: str, value: object) -> None:
    """The refusal names the key and the value."""
    with pytest.raises(ValueError, match=f"`{key}` must .*Got '?{value}'?"):
        LearningConfig(**{key: value})  # type: ignore[arg-type]


def test_the_default_schedule_is_that_of_table_2() -> None:
    """The numbers of Table II, written out once more."""
    config = LearningConfig()
    assert (config.imitation_steps, config.mixed_steps, config.total_steps) == (
        20_000,
        30_000,
        50_000,
    )
    assert (config.bc_interval_imitation, config.bc_interval_mixed) == (1000, 500)
    assert (config.diffusion_interval, config.discriminator_interval) == (500, 2000)
    assert (config.sync_interval, config.buffer_capacity) == (1000, 50_000)
    ppo = config.ppo
    assert (ppo.n_steps, ppo.batch_size, ppo.n_epochs) == (2048, 64, 10)
    assert (ppo.gamma, ppo.gae_lambda, ppo.clip_range) == (0.99, 0.95, 0.2)
    assert (ppo.ent_coef, ppo.vf_coef, ppo.max_grad_norm) == (0.01, 0.5, 0.5)
    assert ppo.learning_rate == config.cloning.learning_rate == 3e-4
    assert (config.cloning.l2, config.cloning.max_grad_norm, config.cloning.patience) == (
        1e-6,
        0.5,
        5,
    )
    assert (config.reward.w_irl, config.reward.w_env) == (0.3, 0.7)
