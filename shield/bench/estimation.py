"""How often raw and tracked clearances raise false alarms, miss, and come late."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shield.errors import Array
from shield.estimation.clearance import ClearanceTracker
from shield.estimation.scan import DEFAULT_SCANNER

__all__ = ["ScanFaults", "disc_ranges", "simulate_drive", "tracking_against_raw"]

DT = 0.1  # [s] period of the scans
STEPS = 200  # [-] scans of a drive
OBSTACLES = 12  # [-] circles beside the path: parked cars and poles
THRESHOLD = 3.0  # [m] clearance below which to alarm
CLEAR = 0.3  # [m] above the threshold, from which on a scan is truly clear


@dataclass(frozen=True, slots=True)
class ScanFaults:
    """What goes wrong in a scan.

    Attributes:
        noise: Standard deviation of a range [m].
        dropout: Share of beams that give nothing in a scan (NaN).
        spurious: Share of beams that give a random short range in a scan.
        stuck: Beams that repeat one range for the whole drive.
    """

    noise: float = 0.05
    dropout: float = 0.05
    spurious: float = 0.01
    stuck: int = 2


def simulate_drive(rng: np.random.Generator, faults: ScanFaults) -> tuple[Array, Array]:
    """Simulate scans of a drive past parked cars and poles, at a speed that varies.

    Obstacles are circles beside and across the path; they pass the field of view of 180° in front
    of the sensor and disappear behind it.

    Returns:
        Scans (`STEPS`, n) and the true clearances (`STEPS`,) [m].
    """
    beams, max_range = DEFAULT_SCANNER.beams, DEFAULT_SCANNER.max_range
    ahead, aside = rng.uniform(8.0, 160.0, OBSTACLES), rng.uniform(2.0, 8.0, OBSTACLES)
    centres = np.column_stack([ahead, aside * rng.choice([-1, 1], OBSTACLES)])
    radii = rng.choice([0.15, 0.5, 1.0], OBSTACLES)
    speed = rng.uniform(3.0, 10.0)
    scans, truth = np.empty((STEPS, beams)), np.empty(STEPS)
    broken = rng.choice(beams, faults.stuck, replace=False)
    held = rng.uniform(0.5, max_range, faults.stuck)
    for step in range(STEPS):
        exact = np.minimum(disc_ranges(centres, radii, DEFAULT_SCANNER.angles), max_range)
        truth[step] = exact.min()
        scan = np.where(exact < max_range, exact + rng.normal(0.0, faults.noise, beams), exact)
        spurious = rng.random(beams) < faults.spurious
        scan = np.where(spurious, rng.uniform(0.3, max_range, beams), scan)
        scan[rng.random(beams) < faults.dropout] = np.nan
        scan[broken] = held
        scans[step] = scan
        centres[:, 0] -= speed * DT
        speed = float(np.clip(speed + rng.normal(0.0, 0.2), 1.0, 12.0))
    return scans, truth


def disc_ranges(centres: Array, radii: Array, angles: Array) -> Array:
    """Return the range of each beam to the nearest circle, infinite where there is none."""
    along = centres[:, :1] * np.cos(angles) + centres[:, 1:] * np.sin(angles)
    across = (centres**2).sum(axis=1, keepdims=True) - along**2
    inside = radii[:, None] ** 2 - across
    hit = (inside > 0.0) & (along > 0.0)
    distance = np.where(hit, along - np.sqrt(np.where(hit, inside, 0.0)), np.inf)
    return np.asarray(distance.min(axis=0))


def tracking_against_raw(rng: np.random.Generator, *, drives: int = 50) -> dict[str, float]:
    """Compare the alarm `clearance < THRESHOLD` on raw and on tracked clearances.

    The raw clearance is the smallest valid range, the tracked one is `clearance - std`. The delay
    of a true crossing is the number of scans from it to the first alarm.

    Returns:
        False alarm and miss rates, delays in scans, and the ratio of the false alarms.
    """
    counts = {"raw": np.zeros(4), "tracked": np.zeros(4)}
    delays: dict[str, list[int]] = {"raw": [], "tracked": []}
    for _ in range(drives):
        scans, truth = simulate_drive(rng, ScanFaults())
        tracker = ClearanceTracker(DT)
        estimates = [tracker.update(scan) for scan in scans]
        nearest = {
            "raw": np.nanmin(scans, axis=1),
            "tracked": np.array([estimate.clearance - estimate.std for estimate in estimates]),
        }
        clear, risky = truth >= THRESHOLD + CLEAR, truth < THRESHOLD
        onsets = np.flatnonzero(risky[1:] & ~risky[:-1]) + 1
        for name, clearance in nearest.items():
            alarm = clearance < THRESHOLD
            outcomes = alarm & clear, clear, ~alarm & risky, risky
            counts[name] += [outcome.sum() for outcome in outcomes]
            delays[name] += [_delay(alarm[onset:], risky[onset:]) for onset in onsets]
    result: dict[str, float] = {}
    for name, (false, clear_steps, missed, risky_steps) in counts.items():
        result[f"{name}_false_alarm_rate"] = float(false / clear_steps)
        result[f"{name}_miss_rate"] = float(missed / risky_steps)
        result[f"{name}_delay_mean_steps"] = float(np.mean(delays[name]))
        result[f"{name}_delay_max_steps"] = float(np.max(delays[name]))
    raw = counts["raw"][0]
    result["false_alarms_tracked_over_raw"] = float(counts["tracked"][0] / raw) if raw else np.nan
    return result


def _delay(alarm: NDArray[np.bool_], risky: NDArray[np.bool_]) -> int:
    """Return the scans until the first alarm, or how long the risk lasted if there is none."""
    length = int(np.argmin(risky)) if not risky.all() else risky.size
    return int(np.argmax(alarm[:length])) if alarm[:length].any() else length
