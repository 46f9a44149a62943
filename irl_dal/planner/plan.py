"""What the planner hands back."""

from dataclasses import dataclass

from irl_dal.planner.arrays import Array
from shield import Status


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A horizon of commands with how it came about. Arrays are read-only."""

    # Commands (H, 2) [rad, m/s]; only the first is executed. In mode `none` they are the sample as
    # it is, admissible or not.
    actions: Array
    # The last clean estimate before its projection (H, 2) [rad, m/s]; equal to `actions` in mode
    # `none` and for a fallback
    nominal: Array
    # Of the last projection; `NOMINAL` in mode `none`; `FALLBACK` when there was no usable sample
    status: Status
    reason: str  # Why it is a fallback or what the projection said, else empty
    energy: float  # Of `actions`; NaN for a fallback
    energy_nominal: float  # Of `nominal`; NaN for a fallback
    # Of the network's last estimate before its last guidance step; NaN without guidance and for a
    # fallback
    energy_unguided: float
    candidates: Array  # All candidates as (N, H, 2) [rad, m/s]
    latency: float  # Wall time of the whole call [s]

    def __post_init__(self) -> None:
        for name in ("actions", "nominal", "candidates"):
            getattr(self, name).setflags(write=False)

    @property
    def correction(self) -> Array:
        """What the last projection changed, `actions - nominal` (H, 2) [rad, m/s]."""
        return self.actions - self.nominal

    @property
    def is_fallback(self) -> bool:
        """Whether there was no usable sample, or no plan that keeps every bound."""
        return self.status is Status.FALLBACK
