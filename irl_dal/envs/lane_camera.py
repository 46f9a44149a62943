r"""Lane pose and shape from the camera image, by classical means.

1. The road's grey gives the colour of the light; pixels are divided by it.
2. Yellow and white pixels below the horizon are put on the ground (inverse perspective).
3. A clothoid is fitted to them. With (s, d) of a pixel in the clothoid's coordinates and d_l the
   offset of the line that it belongs to, Gauss-Newton with Tukey's weights minimises

   .. math:: \sum_i w_i \frac{(d_i - d_l)^2}{\sigma_l^2} + \text{priors on } \kappa, \kappa'

   over the offset, the heading error, the curvature and its rate. The yellow line alone comes
   first; then white pixels near one of our own direction's white lines help.
   Points of the lines that were seen before and have gone out of view, beside the car and under
   it, are moved on with it and take part: without them the pose would be extrapolated from the
   nearest pixels, five metres ahead.
4. The inverse of the normal matrix is the covariance. Too few pixels, too large a deviation or a
   poor fit: no measurement.

Where the yellow line is out of view, white lines are told apart by the last fit, moved on with the
car, for at most `MAX_COAST` seconds; without one, the line with grass to its right is the road's
edge. A first fit that would put grass on the road is off by a lane and refused.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irl_dal.arrays import Array
from irl_dal.envs.road import HALF_WIDTH, HOME_LANE, LANE_WIDTH
from irl_dal.envs.scenery import CENTRE_WIDTH, EDGE_LINE, LINE_WIDTH, PAINT
from irl_dal.envs.sensors import Camera
from shield import LaneMeasurement
from shield.vehicle import carried

Mask = NDArray[np.bool_]

# Least yellowness min(R, G) - B and least brightness of a line, in units of the road's grey
YELLOW, WHITE = 1.35, 2.4
NEAR, FAR = 1.5, 32.0  # Ground that is looked at, from the rear axle [m]
WHITE_FAR = 16.0  # White dashes beyond are single pixels that could belong to anything [m]
MIN_YELLOW, MIN_WHITE = 5, 10  # Fewest pixels of a line
MAX_PIXELS = 80  # Pixels of one colour that take part; about as many give the road's grey
GATE = 1.1  # A white pixel this near to a line belongs to it [m]
# Time for which white lines alone are trusted [s]: a bend of 25 m hides the yellow one so long
MAX_COAST = 4.0
# Least ratio of green to red and blue of grass, and how much of it is taken for an obstacle
GREEN, MAX_GREEN = 1.25, 6
MAX_OFFSET_STD, MAX_HEADING_STD = 0.30, 0.08  # Beyond, there is no measurement [m], [rad]
VERGE = 1.0  # Distance to the right of the edge line at which there is grass behind the kerb [m]
DARKEST = 5.0  # Grey of the road below which nothing is measured [1/255]
PIXEL_ERROR = 0.29  # Standard deviation of a point within its pixel [px], uniform
SLANT = 0.25  # Tangent of the usual angle of line and view: share of a range's error sideways
WHITE_LINES = np.array([-LANE_WIDTH, -EDGE_LINE])  # From the yellow one, own direction [m]
# Deviations of a line's pixels from its middle [m]: uniform over its width, 0.03 m more for what
# is not known of the white ones
SIGMA_YELLOW = CENTRE_WIDTH / math.sqrt(12.0)
SIGMA_WHITE = LINE_WIDTH / math.sqrt(12.0) + 0.03
# Prior of a fit (d [m], psi [rad], kappa [1/m], kappa' [1/m^2]) about a straight road and about the
# last fit: offset and heading are free, a road bends with 25 m and more
PRIOR_STD, KEPT_STD = np.array([30.0, 1.0, 0.04, 0.0015]), np.array([30.0, 1.0, 0.012, 0.0012])
STEEPEST = np.array([0.12, 0.01])  # Largest curvature [1/m] and rate [1/m^2] of a fit
INFLATION = 0.7  # Of the covariance: neighbours share errors; chosen by the normalised errors
WIDTHS = (1.2, 0.5, 0.15)  # Of Tukey's weights beyond three deviations, round by round [m]
INLIER = 0.1  # A pixel nearer than this, beyond three deviations, supports a fit [m]
# Share of strays that the last fit's continuation may have; of support that a first fit needs
MAX_STRAYS, MIN_SUPPORT = 0.15, 0.6
# Ratio of lengths at an offset and on the line; beyond the centre of a bend there is none
MIN_STRETCH, MAX_STRETCH = 0.3, 3.0
MIN_OFFSET_STD, MIN_HEADING_STD = 0.04, 0.006  # Least deviations that are reported [m], [rad]
# Normal matrix of the first guess's prior, and its Cauchy weights' widths [m]
PARABOLA_PRIOR, PARABOLA_WIDTHS = np.diag([1e-6, 1.0, 400.0]), (3.0, 1.5, 0.8)
GREY_ASIDE, GREY_FAR = 2.0, 14.0  # Ground that gives the road's grey, to both sides and ahead [m]
MIN_GREEN = 0.6  # Least ratio of green to red of yellow paint: red and orange have less
LEVEL = 1e-6  # Sight lines flatter than this meet no ground
BEHIND = 3.0  # How far behind the rear axle passed points still take part [m]
ALONG = np.arange(-BEHIND - 1.0, FAR + 4.0, 1.0)  # Stations at which a clothoid is integrated [m]
HERE = int(np.flatnonzero(ALONG == 0.0)[0])
# Points are remembered every so often [m], so many at a time, from so far ahead of the camera [m]
KEEP_EVERY, KEEP, KEEP_FROM = 1.0, 12, 8.0
DRIFT = 0.02  # Of odometry: deviation of a passed point per metre driven since it was seen


@dataclass(frozen=True, slots=True)
class _Sighting:
    """Ground points (n, 3) of lines at offsets (n,) with deviations (n,), placed along a guess.

    The first `seen` of them are in view.
    """

    seen: int
    points: Array
    lines: Array
    sigma: Array
    guess: Array
    placed: tuple[Array, Array, Array]


@dataclass(frozen=True, slots=True)
class _Fit:
    """A clothoid (d, psi, kappa, kappa') of the yellow line; pixels for and against it.

    Those for it are points (n, 4): x, y, deviation, offset of their line [m].
    """

    x: Array
    covariance: Array
    supporters: Array
    strays: int

    @property
    def support(self) -> int:
        """Number of pixels for it."""
        return len(self.supporters)


class LaneCamera:
    """Measures the home lane in images of `Camera`, `size` [px] wide and high, `dt` [s] apart."""

    def __init__(self, size: int, dt: float) -> None:
        self._dt = dt
        ground, seen = _ground(size)
        self._top = int(np.flatnonzero(seen.any(axis=1))[0])
        self._seen: Mask = seen[self._top :].ravel()
        self._points = ground[self._top :].reshape(-1, 3)
        x, y, _ = self._points.T
        self._nearest: Mask = self._seen & (x < WHITE_FAR)
        near = np.flatnonzero(self._seen & (np.abs(y) < GREY_ASIDE) & (x < GREY_FAR))
        self._lane = near[:: 1 + len(near) // MAX_PIXELS]
        self._beside = _shifted(y.reshape(-1, size), VERGE)
        self.reset()

    def reset(self) -> None:
        """Forget the last episode."""
        self._last: Array | None = None
        self._passed: Array = np.zeros((0, 5))  # As `_Fit.supporters`, and the way driven since
        self._driven = KEEP_EVERY
        self._age = math.inf
        self._image: NDArray[np.uint8] | None = None

    def measure(
        self, image: NDArray[np.uint8], speed: float, yaw_rate: float
    ) -> LaneMeasurement | None:
        """Measure in an image (size, size, 3) uint8, after motion with `speed` and `yaw_rate`.

        None where the lane is not seen, or where the image repeats the last one bit by bit.
        """
        self._move(speed, yaw_rate)
        frozen = self._image is not None and bool(np.array_equal(image, self._image))
        self._image = image
        found = None if frozen else self._find(image)
        if found is None:
            return None
        fit, yellow = found
        std = np.sqrt(np.diag(fit.covariance))
        if std[0] > MAX_OFFSET_STD or std[1] > MAX_HEADING_STD:
            return None
        self._last = fit.x
        self._remember(fit.supporters)
        if yellow:
            self._age = 0.0
        return _home_lane(fit.x, float(std[0]), float(std[1]))

    def _move(self, speed: float, yaw_rate: float) -> None:
        """Move the last fit with the car."""
        self._age += self._dt
        if self._last is None or self._age > MAX_COAST:
            self._last, self._passed = None, self._passed[:0]
            return
        d, psi, bend, rate = self._last
        way = speed * self._dt
        along = way / max(MIN_STRETCH, 1.0 - bend * d)
        turn = yaw_rate * self._dt
        self._driven += abs(way)
        self._passed[:, :2] = carried(self._passed[:, :2], speed, yaw_rate, self._dt)
        self._passed[:, 4] += abs(way)
        self._passed = self._passed[self._passed[:, 0] > -BEHIND]
        offset = d + way * math.sin(psi + 0.5 * turn)
        self._last = np.array([offset, psi + turn - bend * along, bend + rate * along, rate])

    def _remember(self, points: Array) -> None:
        """Keep some of the points (n, 4) that are in view, for when they have gone out of it."""
        if self._driven < KEEP_EVERY:
            return
        self._driven = 0.0
        near = points[points[:, 0] < Camera.FORWARD + KEEP_FROM]
        kept = np.insert(near[:: 1 + len(near) // KEEP], 4, 0.0, axis=1)
        self._passed = np.concatenate([self._passed, kept])

    def _find(self, image: NDArray[np.uint8]) -> tuple[_Fit, bool] | None:
        """Fit the lines of an image, and whether the yellow one took part."""
        below = image[self._top :].reshape(-1, 3)
        middle = len(self._lane) // 2
        grey = np.partition(below[self._lane], middle, axis=0)[middle]
        if float(grey.min()) < DARKEST:
            return None
        red, green, blue = np.ascontiguousarray(below.T) / grey.astype(np.float32)[:, None]
        yellowness = np.minimum(red, green) - blue
        yellow = self._seen & (yellowness > YELLOW) & (green > MIN_GREEN * red)
        white = self._nearest & (np.minimum(np.minimum(red, green), blue) > WHITE)
        if self._last is not None:
            return self._fit(self._thinned(yellow), self._thinned(white), self._last)
        grass = green > GREEN * np.maximum(red, blue)
        edge, guess = self._thinned(white & grass[self._beside]), None
        if len(edge) >= MIN_WHITE:
            guess = _parabola(edge)
            guess[0] -= EDGE_LINE
        found = self._fit(self._thinned(yellow), self._thinned(white), guess)
        if found is None:
            return None
        s, d, _ = _coordinates(self._thinned(self._nearest & grass), found[0].x)
        covered = (d > -HALF_WIDTH + 0.5) & (d < 0.0) & (s > 0.0)
        return found if int(covered.sum()) <= MAX_GREEN else None

    def _thinned(self, mask: Mask) -> Array:
        """Points (n, 3), x, y and blur, of about `MAX_PIXELS` pixels of a mask at most."""
        chosen = np.flatnonzero(mask)
        return self._points[chosen[:: 1 + len(chosen) // MAX_PIXELS]]

    def _fit(self, yellow: Array, white: Array, start: Array | None) -> tuple[_Fit, bool] | None:
        if start is not None and len(yellow) >= MIN_YELLOW:
            joint = self._solve(self._associate(yellow, white, start), 2)
            if joint.strays <= MAX_STRAYS * (joint.support + joint.strays):
                return joint, True
        fit = self._fit_yellow(yellow, start) if len(yellow) >= MIN_YELLOW else None
        guess = start if fit is None else fit.x
        if guess is None:
            return None
        sighting = self._associate(yellow if fit is not None else yellow[:0], white, guess)
        if sighting.seen < (MIN_WHITE if fit is None else MIN_YELLOW):
            return None
        joint = self._solve(sighting, 4)
        if joint.support < joint.strays:
            return None
        return joint, fit is not None

    def _fit_yellow(self, yellow: Array, start: Array | None) -> _Fit | None:
        """The yellow line alone, from the last fit or from a parabola."""
        none = yellow[:0]
        for guess in (start, _parabola(yellow)):
            if guess is None:
                continue
            fit = self._solve(self._associate(yellow, none, guess), 3)
            if fit.support >= max(MIN_YELLOW, MIN_SUPPORT * len(yellow)):
                return fit
        return None

    def _solve(self, sighting: _Sighting, rounds: int) -> _Fit:
        """Gauss-Newton from the sighting's guess; the last rounds have the narrowest weights."""
        centre = np.zeros(4) if self._last is None else np.array([0.0, 0.0, *self._last[2:]])
        prior = 1.0 / (PRIOR_STD if self._last is None else KEPT_STD) ** 2
        x, sigma, placed = sighting.guess, sighting.sigma, sighting.placed
        for k in range(rounds):
            s, d, jacobian = placed if k == 0 else _coordinates(sighting.points, x)
            residual = d - sighting.lines
            width = 3.0 * sigma + WIDTHS[min(k + max(3 - rounds, 0), 2)]
            weight = np.maximum(1.0 - (residual / width) ** 2, 0.0) ** 2 / sigma**2
            weight *= s > -BEHIND
            weighted = weight[:, None] * jacobian
            inverse = np.linalg.inv(jacobian.T @ weighted + np.diag(prior))
            x = x - inverse @ (residual @ weighted + prior * (x - centre))
            x[2:] = np.clip(x[2:], -STEEPEST, STEEPEST)
        supports = (np.abs(residual) < 3.0 * sigma + INLIER)[: sighting.seen]
        points = sighting.points[: sighting.seen][supports, :2]
        about = np.stack([sigma, sighting.lines], axis=1)[: sighting.seen][supports]
        supporters = np.concatenate([points, about], axis=1)
        return _Fit(x, np.asarray(INFLATION * inverse), supporters, int((~supports).sum()))

    def _associate(self, yellow: Array, white: Array, x: Array) -> _Sighting:
        """Yellow pixels (n, 3), those white ones (m, 3) near a white line of `x`, passed points."""
        seen = np.concatenate([yellow, white])
        passed = self._passed[_out_of_view(self._passed)]
        points = np.concatenate([seen, passed[:, :3]])
        s, d, jacobian = _coordinates(points, x)
        lines = np.concatenate([np.zeros(len(seen)), passed[:, 3]])
        sigma = np.concatenate(
            [np.hypot(SIGMA_YELLOW, seen[:, 2]), np.hypot(passed[:, 2], DRIFT * passed[:, 4])]
        )
        whites = slice(len(yellow), len(seen))
        apart = d[whites, None] - WHITE_LINES
        which = np.argmin(np.abs(apart), axis=1)
        lines[whites] = WHITE_LINES[which]
        sigma[whites] = np.hypot(SIGMA_WHITE, white[:, 2])
        keep = np.ones(len(points), np.bool_)
        keep[whites] = np.abs(d - lines)[whites] < GATE
        placed = (s[keep], d[keep], jacobian[keep])
        return _Sighting(
            int(keep[: len(seen)].sum()), points[keep], lines[keep], sigma[keep], x, placed
        )


def _out_of_view(points: Array) -> Mask:
    """Which ground points (n, 2 or more) the camera does not see, to its sides and below it."""
    ahead, half = points[:, 0] - Camera.FORWARD, math.radians(0.5 * Camera.FIELD_OF_VIEW)
    nearest = (Camera.HEIGHT - PAINT) / math.tan(half + Camera.PITCH)
    depth = math.cos(Camera.PITCH) * ahead + math.sin(Camera.PITCH) * Camera.HEIGHT
    return np.asarray((ahead < nearest) | (np.abs(points[:, 1]) > math.tan(half) * depth))


def _ground(size: int) -> tuple[Array, Mask]:
    """Ground point and its blur (size, size, 3) of each pixel [m], and which have one.

    In the car's frame; the blur is a pixel's sideways uncertainty. The renderer samples the picture
    at the left lower corner of each pixel.
    """
    half, pitch, height = 0.5 * size, Camera.PITCH, Camera.HEIGHT - PAINT
    focal = half / math.tan(math.radians(0.5 * Camera.FIELD_OF_VIEW))
    u, v = (np.arange(size) - half) / focal, (np.arange(size) + 1.0 - half) / focal
    down = math.sin(pitch) + v * math.cos(pitch)
    ahead = math.cos(pitch) - v * math.sin(pitch)
    reach = height / np.maximum(down, LEVEL)
    x, y = np.broadcast_arrays((Camera.FORWARD + reach * ahead)[:, None], -u * reach[:, None])
    away = np.maximum(x - Camera.FORWARD, 0.0)
    blur = PIXEL_ERROR * np.hypot(away / focal, SLANT * away**2 / (height * focal))
    seen = (down > LEVEL)[:, None] & (x > NEAR) & (x < FAR)
    return np.stack([x, y, blur], axis=2), seen


def _parabola(points: Array) -> Array:
    """First guess (4,) from ground points (n, 3) of the yellow line, robust against strays."""
    x, y = points[:, 0], points[:, 1]
    terms = np.stack([np.ones_like(x), x, 0.5 * x**2], axis=1)
    weight = np.ones_like(x)
    for width in PARABOLA_WIDTHS:
        normal = terms.T @ (weight[:, None] * terms) + PARABOLA_PRIOR
        a, b, c = np.linalg.solve(normal, terms.T @ (weight * y))
        weight = 1.0 / (1.0 + ((y - terms @ (a, b, c)) / width) ** 2)
    psi = -math.atan(b)
    return np.array([-a * math.cos(psi), psi, c, 0.0])


def _coordinates(points: Array, x: Array) -> tuple[Array, Array, Array]:
    """Place points (n, 3) of the car's frame along the clothoid `x` (4,): s, d and d's Jacobian."""
    offset, psi, bend, rate = (float(value) for value in x)
    heading = (bend + 0.5 * rate * ALONG) * ALONG - psi
    cos, sin = np.cos(heading), np.sin(heading)
    way_x = np.concatenate([[0.0], np.cumsum(0.5 * (cos[1:] + cos[:-1]))])
    way_y = np.concatenate([[0.0], np.cumsum(0.5 * (sin[1:] + sin[:-1]))])
    way_x += -offset * math.sin(psi) - way_x[HERE]
    way_y += -offset * math.cos(psi) - way_y[HERE]
    px, py = points[:, 0], points[:, 1]
    s = np.interp(px, np.maximum.accumulate(way_x), ALONG)
    for _ in range(2):
        np.clip(s, ALONG[0], ALONG[-1], out=s)
        turn = (bend + 0.5 * rate * s) * s
        tangent_x, tangent_y = np.cos(turn - psi), np.sin(turn - psi)
        rest_x = px - np.interp(s, ALONG, way_x)
        rest_y = py - np.interp(s, ALONG, way_y)
        d = tangent_x * rest_y - tangent_y * rest_x
        s = s + (tangent_x * rest_x + tangent_y * rest_y) / np.clip(
            1.0 - (bend + rate * s) * d, MIN_STRETCH, MAX_STRETCH
        )
    jacobian = np.empty((len(points), 4))
    jacobian[:, 0] = np.cos(turn)
    jacobian[:, 1] = px * tangent_x + py * tangent_y
    jacobian[:, 2] = -0.5 * s * s
    jacobian[:, 3] = s * jacobian[:, 2] / 3.0
    return s, d, jacobian


def _shifted(y: Array, way: float) -> NDArray[np.int64]:
    """Flat index of the pixel `way` [m] to the right of each, for ground offsets `y` (m, n) [m]."""
    width = np.abs(np.diff(y, axis=1, append=2.0 * y[:, -1:] - y[:, -2:-1]))
    rows, columns = np.indices(y.shape)
    right = columns + np.rint(way / np.maximum(width, LEVEL)).astype(np.int64)
    return np.asarray((rows * y.shape[1] + np.minimum(right, y.shape[1] - 1)).ravel())


def _home_lane(x: Array, offset_std: float, heading_std: float) -> LaneMeasurement:
    """The yellow line's clothoid as that of the home lane, 5.25 m to its right."""
    d, psi, bend, rate = (float(value) for value in x)
    stretch = max(MIN_STRETCH, 1.0 - HOME_LANE * bend)
    return LaneMeasurement(
        lateral_offset=d - HOME_LANE,
        heading_error=psi,
        curvature=bend / stretch,
        curvature_rate=rate / stretch**3,
        offset_std=max(offset_std, MIN_OFFSET_STD),
        heading_std=max(heading_std, MIN_HEADING_STD),
    )
