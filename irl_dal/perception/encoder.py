"""Camera, LiDAR and speed to the policy's 512 features, as a stable-baselines3 extractor."""

import gymnasium
import numpy as np
import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn
from torch.nn.functional import conv1d, conv2d

from irl_dal.perception.adaptive_mask import LearnableAdaptiveMask
from irl_dal.perception.config import PerceptionConfig

FEATURES = 512  # Size of the fused state s_t
LIDAR_FEATURES = 32  # Size of z_lidar
# Output channels of the three layers. The paper gives kernels and strides only.
CONVOLUTION_CHANNELS = (16, 32, 32)
# Mean brightness after exposure, and the one below which nothing is amplified any more
EXPOSURE, DARKNESS = 0.3, 0.01
# Hidden units of the fusion: half the arithmetic of going from z_vision to 512 at once
FUSION_WIDTH = 256


def channels_first(image: Tensor) -> Tensor:
    """Bring a batch of RGB images to float (B, 3, height, width) in [0, 1].

    uint8 images are divided by 255. Floating-point images are taken as already divided, which is
    what stable-baselines3 hands over. `ValueError` for other types and layouts.
    """
    if image.ndim != 4 or 3 not in (image.shape[1], image.shape[3]):
        raise ValueError(
            "`image` must be (B, 3, height, width) or (B, height, width, 3). "
            f"Got {tuple(image.shape)}."
        )
    if image.shape[1] != 3:
        image = image.permute(0, 3, 1, 2)
    if image.is_floating_point():
        return image
    if image.dtype != torch.uint8:
        raise ValueError(f"`image` must be uint8 or floating point. Got {image.dtype}.")
    return image.to(torch.get_default_dtype()) / 255.0


def exposed(image: Tensor) -> Tensor:
    """Bring images (B, 3, height, width) in [0, 1] to one brightness, that of the road below.

    Dark evenings then look like days with more noise, and what is learnt by day serves at night.
    The lower half of each image has the mean `EXPOSURE`.
    """
    level = image[:, :, image.shape[2] // 2 :].mean(dim=(1, 2, 3), keepdim=True)
    return image * (EXPOSURE / (level + DARKNESS))


class ImageEncoder(nn.Module):
    """Three convolutions (kernels 5, 3, 3, stride 2, ReLU) and a flatten: z_vision."""

    def __init__(self, channels: int, height: int, width: int) -> None:
        super().__init__()
        first, second, third = CONVOLUTION_CHANNELS
        self.layers = nn.Sequential(
            nn.Conv2d(channels, first, kernel_size=5, stride=2),
            nn.ReLU(),
            nn.Conv2d(first, second, kernel_size=3, stride=2),
            nn.ReLU(),
            nn.Conv2d(second, third, kernel_size=3, stride=2),
            nn.ReLU(),
            nn.Flatten(),
        )
        with torch.no_grad():
            self.features = int(self.layers(torch.zeros(1, channels, height, width)).shape[1])

    def forward(self, image: Tensor, mask: Tensor | None = None) -> Tensor:
        """Image (B, 3, height, width) and mask (B, 1, height, 1) or None to z_vision.

        The mask is Eq. 4channel's fourth channel. It is the same along each row, so its share of
        the first convolution is one down the rows; and the image then needs no gradient, which was
        a third of a training step.
        """
        first = self.layers[0]
        assert isinstance(first, nn.Conv2d)
        # Channels-last activations make the convolutions about 1.4 times faster on a CPU.
        image = image.contiguous(memory_format=torch.channels_last)
        hidden = conv2d(image, first.weight[:, :3], first.bias, first.stride)
        if mask is not None:
            down_rows = conv1d(mask[..., 0], first.weight[:, 3:].sum(dim=3), stride=first.stride[0])
            # Laid out in full and channels last: adding a broadcast one takes three times as long.
            rows = down_rows.transpose(1, 2)[:, :, None].expand(-1, -1, hidden.shape[3], -1)
            hidden = hidden + rows.contiguous().permute(0, 3, 1, 2)
        return self.layers[1:](hidden)


class LidarEncoder(nn.Module):
    """Three-layer MLP on the scan, normalised by and clipped to `max_range` [m]: z_lidar."""

    def __init__(self, beams: int, max_range: float) -> None:
        super().__init__()
        self.max_range = max_range
        self.layers = nn.Sequential(
            nn.Linear(beams, 64),
            nn.ReLU(),
            nn.Linear(64, 64),
            nn.ReLU(),
            nn.Linear(64, LIDAR_FEATURES),
            nn.ReLU(),
        )

    def forward(self, lidar: Tensor) -> Tensor:
        """Scan (B, beams) [m] to z_lidar (B, 32)."""
        return self.layers(lidar.clamp(0.0, self.max_range) / self.max_range)


class DrivingFeaturesExtractor(BaseFeaturesExtractor):
    """Eq. feature_fusion: s_t = MLP(concat[z_vision, z_lidar]) of 512 features.

    Made for stable-baselines3's `MultiInputPolicy`, whose images arrive channels first and divided
    by 255; the camera's own uint8 (B, 64, 64, 3) is accepted as well. `ValueError` for a space that
    lacks `image`, `lidar` [m], `speed` [m/s] or `context`, or whose image has no three channels.
    """

    def __init__(
        self, observation_space: gymnasium.spaces.Dict, config: PerceptionConfig | None = None
    ) -> None:
        super().__init__(observation_space, FEATURES)
        self.config = config or PerceptionConfig()
        image, lidar, context = _shapes(observation_space)
        height, width = image[1:] if image[0] == 3 else image[:2]
        self.mask = LearnableAdaptiveMask(self.config) if self.config.adaptive_mask else None
        self.image_encoder = ImageEncoder(3 if self.mask is None else 4, height, width)
        # The space ends where the scanner's range does.
        max_range = float(observation_space["lidar"].high.max())  # type: ignore[attr-defined]
        self.lidar_encoder = LidarEncoder(lidar[0], max_range)
        fused = self.image_encoder.features + LIDAR_FEATURES + int(self.config.fuse_speed)
        if self.config.fuse_context:
            fused += context
        self.fusion = nn.Sequential(
            nn.Linear(fused, FUSION_WIDTH), nn.ReLU(), nn.Linear(FUSION_WIDTH, FEATURES), nn.ReLU()
        )

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        """`image` as `channels_first` takes it, vectors (B, n) of the others to s_t (B, 512)."""
        lidar, speed = observations["lidar"], observations["speed"]
        image = channels_first(observations["image"])
        if self.config.exposure:
            image = exposed(image)
        mask = None if self.mask is None else self.mask(speed, lidar, rows=image.shape[2])
        parts = [self.image_encoder(image, mask), self.lidar_encoder(lidar)]
        if self.config.fuse_speed:
            parts.append((speed / self.config.max_speed).clamp(0.0, 1.0))
        if self.config.fuse_context:
            parts.append(observations["context"])
        return self.fusion(torch.cat(parts, dim=1))


def _shapes(space: gymnasium.spaces.Dict) -> tuple[tuple[int, ...], tuple[int, ...], int]:
    """Shapes of image and scan, size of the context, or a ValueError that says what is missing."""
    missing = sorted({"image", "lidar", "speed", "context"} - set(space.spaces))
    if missing:
        raise ValueError(
            f"`observation_space` must have image, lidar, speed and context. Missing {missing}."
        )
    image, lidar = space["image"].shape, space["lidar"].shape
    if image is None or len(image) != 3 or 3 not in (image[0], image[2]):
        raise ValueError(f"`observation_space['image']` must have three channels. Got {image}.")
    if lidar is None or len(lidar) != 1 or int(np.prod(lidar)) < 1:
        raise ValueError(f"`observation_space['lidar']` must be a vector. Got shape {lidar}.")
    return image, lidar, int(np.prod(space["context"].shape or ()))
