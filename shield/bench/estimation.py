"""How often raw and tracked clearances raise false alarms, miss, and come late."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shield.estimation.clearance import ClearanceTracker

__all__ = ["ScanFaults", "simulate_drive", "tracking_against_raw"]

Array = NDArray[np.float64]


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


def simulate_drive(
    rng: np.random.Generator,
    faults: ScanFaults,
    *,
    steps: int = 200,
    beams: int = 180,
    max_range: float = 40.0,
    dt: float = 0.1,
) -> tuple[Array, Array]:
    """Simulate scans of a drive past parked cars and poles, at a speed that varies.

    Obstacles are circles beside and across the path; they pass the field of view of 180° in front
    of the sensor and disappear behind it.

    Args:
        rng: Source of randomness.
        faults: What goes wrong.
        steps: Number of scans.
        beams: Beams in a scan.
        max_range: Range reported where nothing returns [m].
        dt: Period of the scans [s].

    Returns:
        Scans (steps, beams) and the true clearances (steps,) [m].
    """
    angles = np.linspace(-np.pi / 2, np.pi / 2, beams)
    count = 12
    centres = np.column_stack(
        [rng.uniform(8.0, 160.0, count), rng.uniform(2.0, 8.0, count) * rng.choice([-1, 1], count)]
    )
    radii = rng.choice([0.15, 0.5, 1.0], count)
    speed = rng.uniform(3.0, 10.0)
    scans, truth = np.empty((steps, beams)), np.empty(steps)
    broken = rng.choice(beams, faults.stuck, replace=False)
    held = rng.uniform(0.5, max_range, faults.stuck)
    for step in range(steps):
        exact = np.minimum(_ranges(centres, radii, angles), max_range)
        truth[step] = exact.min()
        scan = np.where(exact < max_range, exact + rng.normal(0.0, faults.noise, beams), exact)
        spurious = rng.random(beams) < faults.spurious
        scan = np.where(spurious, rng.uniform(0.3, max_range, beams), scan)
        scan[rng.random(beams) < faults.dropout] = np.nan
        scan[broken] = held
        scans[step] = scan
        centres[:, 0] -= speed * dt
        speed = float(np.clip(speed + rng.normal(0.0, 0.2), 1.0, 12.0))
    return scans, truth


def _ranges(centres: Array, radii: Array, angles: Array) -> Array:
    """Return the range of each beam to the nearest circle, infinite where there is none."""
    along = centres[:, :1] * np.cos(angles) + centres[:, 1:] * np.sin(angles)
    across = (centres**2).sum(axis=1, keepdims=True) - along**2
    inside = radii[:, None] ** 2 - across
    hit = (inside > 0.0) & (along > 0.0)
    distance = np.where(hit, along - np.sqrt(np.where(hit, inside, 0.0)), np.inf)
    nearest: Array = distance.min(axis=0)
    return nearest


def tracking_against_raw(
    rng: np.random.Generator,
    *,
    drives: int = 50,
    threshold: float = 3.0,
    sigma_factor: float = 1.0,
    faults: ScanFaults | None = None,
) -> dict[str, float]:
    """Compare the alarm `clearance < threshold` on raw and on tracked clearances.

    A scan is truly clear from 0.3 m above the threshold on and truly risky below it. The raw
    clearance is the smallest valid range, the tracked one `clearance - sigma_factor * std`. The
    delay of a true crossing is the number of scans from it to the first alarm.

    Args:
        rng: Source of randomness.
        drives: Simulated drives of 200 scans.
        threshold: Clearance below which to alarm [m].
        sigma_factor: Standard deviations taken off the tracked clearance.
        faults: What goes wrong in the scans. Default: `ScanFaults()`.

    Returns:
        False alarm and miss rates, delays in scans, and the ratio of the false alarms.
    """
    counts = {"raw": np.zeros(4), "tracked": np.zeros(4)}
    delays: dict[str, list[int]] = {"raw": [], "tracked": []}
    for _ in range(drives):
        scans, truth = simulate_drive(rng, faults or ScanFaults())
        tracker = ClearanceTracker(0.1)
        estimates = [tracker.update(scan) for scan in scans]
        alarms = {
            "raw": np.nanmin(scans, axis=1) < threshold,
            "tracked": np.array(
                [one.clearance - sigma_factor * one.std < threshold for one in estimates]
            ),
        }
        clear, risky = truth >= threshold + 0.3, truth < threshold
        onsets = np.flatnonzero(risky[1:] & ~risky[:-1]) + 1
        for name, alarm in alarms.items():
            counts[name] += [
                (alarm & clear).sum(),
                clear.sum(),
                (~alarm & risky).sum(),
                risky.sum(),
            ]
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
