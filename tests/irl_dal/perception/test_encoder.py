import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3 import PPO

from irl_dal.perception import DrivingFeaturesExtractor, PerceptionConfig
from irl_dal.perception.encoder import EXPOSURE, ImageEncoder, channels_first, exposed


def observation_space() -> spaces.Dict:
    """The city's observation space."""
    return spaces.Dict(
        {
            "image": spaces.Box(0, 255, (64, 64, 3), np.uint8),
            "lidar": spaces.Box(0.0, 40.0, (180,), np.float32),
            "speed": spaces.Box(-2.0, 20.0, (1,), np.float32),
            "context": spaces.Box(-3.0, 3.0, (64,), np.float32),
        }
    )


def observations(batch: int = 4) -> dict[str, torch.Tensor]:
    """A batch as stable-baselines3 hands it over."""
    generator = torch.Generator().manual_seed(3)
    return {
        "image": torch.rand(batch, 3, 64, 64, generator=generator),
        "lidar": 40 * torch.rand(batch, 180, generator=generator),
        "speed": 12 * torch.rand(batch, 1, generator=generator),
        "context": torch.rand(batch, 64, generator=generator),
    }


class Drive(gymnasium.Env[dict[str, np.ndarray], np.ndarray]):
    """The smallest environment with the city's spaces."""

    observation_space = observation_space()
    action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    def reset(self, *, seed=None, options=None):  # type: ignore[no-untyped-def]
        """First observation."""
        self.observation_space.seed(seed)
        return self.observation_space.sample(), {}

    def step(self, action):  # type: ignore[no-untyped-def]
        """Another observation."""
        return self.observation_space.sample(), 0.0, False, False, {}


def test_features_have_the_paper_s_size_and_all_inputs_matter() -> None:
    """s_t has 512 entries, and image, LiDAR and speed each move it."""
    torch.manual_seed(0)
    extractor = DrivingFeaturesExtractor(observation_space())
    batch = observations()
    with torch.no_grad():
        features = extractor(batch)
        assert features.shape == (4, 512)
        for key, value in batch.items():
            moved = extractor({**batch, key: 0.5 * value})
            assert float((moved - features).abs().max()) > 1e-4, key


def test_layouts_and_types_of_the_image_agree() -> None:
    """The camera's uint8 image and stable-baselines3's float channels-first one give the same."""
    torch.manual_seed(0)
    extractor = DrivingFeaturesExtractor(observation_space())
    batch = observations()
    raw = (batch["image"] * 255).round().to(torch.uint8)
    with torch.no_grad():
        expected = extractor({**batch, "image": raw.float() / 255})
        np.testing.assert_allclose(extractor({**batch, "image": raw}), expected, atol=1e-6)
        last = raw.permute(0, 2, 3, 1).contiguous()
        np.testing.assert_allclose(extractor({**batch, "image": last}), expected, atol=1e-6)


@pytest.mark.parametrize("shape", [(4, 64, 64), (4, 1, 64, 64), (3, 64, 64)])
def test_wrong_image_is_refused(shape: tuple[int, ...]) -> None:
    """An image without three channels, or of an integer type that is not uint8, is refused."""
    with pytest.raises(ValueError, match="`image` must be"):
        channels_first(torch.zeros(shape))
    with pytest.raises(ValueError, match="uint8"):
        channels_first(torch.zeros((1, 3, 8, 8), dtype=torch.int32))


def test_mask_is_trained_through_the_image() -> None:
    """A loss on the features reaches both alphas."""
    torch.manual_seed(0)
    extractor = DrivingFeaturesExtractor(observation_space())
    extractor(observations()).square().mean().backward()
    assert extractor.mask is not None
    for alpha in (extractor.mask.alpha_speed, extractor.mask.alpha_lidar):
        assert alpha.grad is not None and float(alpha.grad.abs()) > 0


def test_ablation_has_no_mask() -> None:
    """With the mask off the image keeps its three channels and there are no alphas to learn."""
    extractor = DrivingFeaturesExtractor(observation_space(), PerceptionConfig(adaptive_mask=False))
    assert not [name for name, _ in extractor.named_parameters() if "alpha" in name]
    assert extractor(observations()).shape == (4, 512)


def test_incomplete_space_is_refused() -> None:
    """A space without LiDAR, or with a grey image, is refused at construction."""
    space = observation_space()
    with pytest.raises(ValueError, match="Missing \\['lidar'\\]"):
        DrivingFeaturesExtractor(spaces.Dict({k: v for k, v in space.items() if k != "lidar"}))
    grey = spaces.Box(0, 255, (64, 64, 1), np.uint8)
    with pytest.raises(ValueError, match="three channels"):
        DrivingFeaturesExtractor(spaces.Dict({**space.spaces, "image": grey}))


def test_ppo_learns_through_it() -> None:
    """A PPO update with MultiInputPolicy moves the alphas; its optimizer owns them."""
    model = PPO(
        "MultiInputPolicy",
        Drive(),
        n_steps=16,
        batch_size=16,
        n_epochs=1,
        seed=1,
        policy_kwargs={
            "features_extractor_class": DrivingFeaturesExtractor,
            "features_extractor_kwargs": {"config": PerceptionConfig()},
        },
    )
    model.learn(16)
    mask = model.policy.features_extractor.mask
    assert float(mask.alpha_speed.detach()) != 0.5
    assert float(mask.alpha_lidar.detach()) != 0.5


def test_exposure_makes_evening_and_day_alike() -> None:
    """A fifth of the light gives the same picture; without exposure the features differ more."""
    seen = observations(2)
    dark = {**seen, "image": 0.2 * seen["image"]}
    assert exposed(seen["image"])[:, :, 32:].mean() == pytest.approx(EXPOSURE, rel=0.05)
    assert torch.allclose(exposed(seen["image"]), exposed(dark["image"]), rtol=0.1)
    changes = {}
    for switch in (True, False):
        torch.manual_seed(0)
        extractor = DrivingFeaturesExtractor(observation_space(), PerceptionConfig(exposure=switch))
        changes[switch] = float((extractor(seen) - extractor(dark)).abs().mean().detach())
    assert changes[True] < 0.5 * changes[False]


def test_the_mask_is_a_fourth_channel() -> None:
    """Output and gradients are those of one convolution over image and mask (Eq. 4channel)."""
    torch.manual_seed(0)
    encoder = ImageEncoder(4, 64, 64).double()
    image = torch.rand(3, 3, 64, 64, dtype=torch.float64)
    mask = torch.rand(3, 1, 64, 1, dtype=torch.float64, requires_grad=True)
    joined = torch.cat([image, mask.expand(-1, -1, -1, 64)], dim=1)
    known = [mask, *encoder.parameters()]
    ours, theirs = encoder(image, mask), encoder.layers(joined)
    assert torch.allclose(ours, theirs, atol=1e-12)
    for one, two in zip(
        torch.autograd.grad(ours.square().sum(), known),
        torch.autograd.grad(theirs.square().sum(), known),
        strict=True,
    ):
        assert torch.allclose(one, two, atol=1e-10)


@pytest.mark.parametrize("fused", [True, False])
def test_the_estimates_enter_the_fusion_where_they_are_asked_for(fused: bool) -> None:
    """What the context says changes the features, or nothing."""
    encoder = DrivingFeaturesExtractor(observation_space(), PerceptionConfig(fuse_context=fused))
    seen = observations()
    other = {**seen, "context": 1.0 - seen["context"]}
    assert torch.equal(encoder(seen), encoder(other)) != fused
