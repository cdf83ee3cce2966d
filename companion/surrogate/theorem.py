"""The convergence theorem as arithmetic: four conditions on the surrogate's gradient, and the steps that each promises.

The four are the theorem as printed, with the sign of its derivation corrected, with its sharp constant, and the bound
on the distance itself. Each allows the surrogate a gradient with components of at most b, and so holds only beyond a
distance from every threat, which is computed here as well. docs/convergence.md has the proofs; `companion certify`
applies the conditions to a mission.

The functions take lengths in metres per guidance step, as the theorem sets its time step to 1: v = speed times step,
delta = the targets' speed bound times step, b bounds each component of dF*/dU, and beta = sqrt(2) b its length.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from companion.surrogate.networks import SIGMOID_SLOPE_MAX
from companion.surrogate.profiles import AnalyticProfile, PairwiseNetwork, RadialProfile

SQRT2 = math.sqrt(2.0)
BISECTIONS = 60
"""Number of halvings of a bracket: more than the bits of a float can resolve."""


@dataclass(frozen=True)
class Pace:
    """Distances moved in one guidance step, and the arrival radius; all in m and positive, `target_m` may be 0."""

    speed_m: float
    """v, the distance that an agent flies in one step."""
    target_m: float
    """delta, the greatest distance that a target moves in one step."""
    arrival_m: float
    """D_min, the mission's arrival radius; the theorem itself takes v for it."""


@dataclass(frozen=True)
class Condition:
    """A condition on b, and the functions that give the bounds which follow from it."""

    name: str
    title: str
    source: str
    """Equation of the paper, or docs/convergence.md."""
    unit: str
    """Unit of the decrease: m^2 if it is of the squared distance, m if of the distance."""
    largest_b_m: Callable[[Pace], float]
    """Returns the b below which the condition holds, m; 0 if it never does."""
    decrease: Callable[[Pace, float], float]
    """Returns the least decrease per step at b (m), in `unit`; -inf where the proof says nothing."""
    steps: Callable[[Pace, float, float], int]
    """Returns the greatest number of steps at b (m) from a distance (m) beyond the arrival radius, if it holds."""
    ends_at_v: bool
    """Whether an agent counts as arrived within v of its target, so that the arrival radius must not be less than v."""


def printed_decrease_m2(pace: Pace, b_m: float) -> float:
    """Return epsilon of the theorem as printed, m^2 (paper: thm_2_1; its two terms in delta cancel but for delta^2)."""
    return _theorem_decrease_m2(pace, b_m, 1.0 + (pace.target_m / pace.speed_m) ** 2)


def corrected_decrease_m2(pace: Pace, b_m: float) -> float:
    """Return epsilon with the sign that the paper's own derivation gives, m^2 (docs/method.md section 2, point 4)."""
    ratio = pace.target_m / pace.speed_m
    return _theorem_decrease_m2(pace, b_m, 1.0 + 4.0 * SQRT2 * ratio + ratio**2)


def sharp_decrease_m2(pace: Pace, b_m: float) -> float:
    """Return the least decrease of the squared distance in any step from beyond v, m^2.

    It is v^2 - (delta + v sqrt(2 - 2c))^2 with c = sqrt(1 - 2 (b/v)^2): no greater epsilon is true
    (docs/convergence.md).
    """
    beta_m = SQRT2 * b_m
    if beta_m > pace.speed_m:
        return -math.inf
    return pace.speed_m**2 - worst_next_distance_m(pace, b_m, pace.speed_m) ** 2


def tight_decrease_m(pace: Pace, b_m: float) -> float:
    """Return q, the least decrease of distance in a step from beyond D_min, m (docs/method.md section 2, point 4)."""
    if SQRT2 * b_m > pace.arrival_m:
        return -math.inf
    return pace.arrival_m - worst_next_distance_m(pace, b_m, pace.arrival_m)


def worst_next_distance_m(pace: Pace, b_m: float, distance_m: float) -> float:
    """Return the greatest distance after one step from a distance of at least sqrt(2) b, m.

    In this worst case the gradient is perpendicular to the step and of its greatest length, and the target moves
    straight away from the agent.
    """
    beta_m = SQRT2 * b_m
    along_m = math.sqrt(distance_m**2 - beta_m**2)
    return pace.target_m + math.hypot(along_m - pace.speed_m, beta_m)


def printed_largest_b_m(pace: Pace) -> float:
    """Return the b below which the theorem's condition as printed holds, m; 0 if it never does (paper: thm_2)."""
    ratio = pace.target_m / pace.speed_m
    return min(_theorem_largest_b_m(pace, 1.0 + ratio**2), _theorem_domain_m(pace))


def corrected_largest_b_m(pace: Pace) -> float:
    """Return the b below which the corrected condition holds, m; 0 if it never does: from delta = (3 - sqrt 8) v on."""
    ratio = pace.target_m / pace.speed_m
    return min(_theorem_largest_b_m(pace, 1.0 + 4.0 * SQRT2 * ratio + ratio**2), _theorem_domain_m(pace))


def sharp_largest_b_m(pace: Pace) -> float:
    """Return the b below which every step from beyond v brings an agent nearer, m; 0 if delta >= v."""
    ratio = pace.target_m / pace.speed_m
    if ratio >= 1.0:
        return 0.0
    cosine = 1.0 - (1.0 - ratio) ** 2 / 2.0
    return pace.speed_m * math.sqrt((1.0 - cosine**2) / 2.0)


def tight_largest_b_m(pace: Pace) -> float:
    """Return the b below which every step from beyond the arrival radius brings an agent nearer, m; 0 if none does."""
    v_m, delta_m, arrival_m = pace.speed_m, pace.target_m, pace.arrival_m
    if delta_m >= arrival_m:
        return 0.0
    cosine = (v_m**2 + 2.0 * arrival_m * delta_m - delta_m**2) / (2.0 * arrival_m * v_m)
    return 0.0 if cosine >= 1.0 else arrival_m * math.sqrt((1.0 - cosine**2) / 2.0)


def turn_needed_rad(pace: Pace, b_m: float) -> float:
    """Return the greatest turn of the wanted heading from one step to the next before arrival, rad, at most pi.

    Both headings are within asin(beta / D_min) of the bearing of the target, and the bearing itself turns by the motion
    of agent and target across it (docs/convergence.md). If this turn is within the turn limit, then the limit stays
    inactive once it was inactive in one step.
    """
    beta_m, arrival_m = SQRT2 * b_m, pace.arrival_m
    if arrival_m < pace.speed_m + pace.target_m or beta_m >= arrival_m:
        return math.pi
    across = (pace.speed_m * beta_m / arrival_m + pace.target_m) / arrival_m
    return min(math.pi, 2.0 * math.asin(beta_m / arrival_m) + math.asin(min(1.0, across)))


def bend_rad(b_m: float, attraction_m: float) -> float:
    """Return the greatest angle by which a gradient of length sqrt(2) b turns the direction off the target's, rad.

    `attraction_m` is the distance to the target, positive. The angle is at most pi / 2, which stands for any angle: a
    gradient as long as the attraction can turn the direction arbitrarily.
    """
    return math.asin(min(1.0, SQRT2 * b_m / attraction_m))


def _theorem_decrease_m2(pace: Pace, b_m: float, constant: float) -> float:
    """Return v^2 (2 sqrt(1 - 2 sqrt2 s) - constant - 4 s) with s = b/v: both forms of the theorem, m^2."""
    s = b_m / pace.speed_m
    inside = 1.0 - 2.0 * SQRT2 * s
    return pace.speed_m**2 * (2.0 * math.sqrt(inside) - constant - 4.0 * s) if inside >= 0.0 else -math.inf


def _theorem_largest_b_m(pace: Pace, constant: float) -> float:
    """Return the root of `_theorem_decrease_m2` in b, m: squared, it is a quadratic equation in s."""
    return max(0.0, pace.speed_m * (math.sqrt(2.0 * SQRT2 * constant + 6.0) - constant - SQRT2) / 4.0)


def _theorem_domain_m(pace: Pace) -> float:
    """Return the theorem's own upper limit of b, m; 0 unless v > sqrt(2) delta (paper: thm_2)."""
    return max(0.0, (pace.speed_m**2 - 2.0 * pace.target_m**2) / (2.0 * SQRT2 * pace.speed_m))


def _tight_steps(pace: Pace, b_m: float, distance_m: float) -> int:
    return math.ceil((distance_m - pace.arrival_m) / tight_decrease_m(pace, b_m))


CONDITIONS = (
    Condition(
        "printed",
        "as printed",
        "paper: thm_2, thm_2_1",
        "m^2",
        printed_largest_b_m,
        printed_decrease_m2,
        lambda pace, b_m, distance_m: math.floor(distance_m**2 / printed_decrease_m2(pace, b_m)),
        True,
    ),
    Condition(
        "corrected",
        "corrected",
        "docs/convergence.md",
        "m^2",
        corrected_largest_b_m,
        corrected_decrease_m2,
        lambda pace, b_m, distance_m: math.floor(distance_m**2 / corrected_decrease_m2(pace, b_m)),
        True,
    ),
    Condition(
        "sharp",
        "sharp",
        "docs/convergence.md",
        "m^2",
        sharp_largest_b_m,
        sharp_decrease_m2,
        lambda pace, b_m, distance_m: math.ceil(
            max(0.0, distance_m**2 - pace.speed_m**2) / sharp_decrease_m2(pace, b_m)
        ),
        True,
    ),
    Condition("tight", "tight", "docs/convergence.md", "m", tight_largest_b_m, tight_decrease_m, _tight_steps, False),
)


@dataclass(frozen=True)
class Sigmoids:
    """A radial profile as a sum of sigmoids of the scaled distance: |f'| is at most a sum of bells about their centres.

    The sum of the bells falls beyond the outermost centre even where f' itself ripples, which makes "beyond this
    distance" a statement about all of the plane outside, not about samples of it.
    """

    amplitude: np.ndarray  # (J,), |lambda w|, dimensionless
    steepness: np.ndarray  # (J,), |w|, positive
    centre: np.ndarray  # (J,), -theta / w, scaled distance

    @property
    def weight_sum(self) -> float:
        """sum_j |lambda_j w_j|, the left side of the corollary for one pair, dimensionless (paper: coro_condi)."""
        return float(np.sum(self.amplitude))

    @property
    def outermost(self) -> float:
        """Scaled distance beyond which every bell falls; at least 1, the disc's edge."""
        return float(np.max(self.centre, initial=1.0))

    def slope_bound(self, r: float) -> float:
        """Return a bound of |f'| at every scaled distance of at least r, dimensionless; r >= `outermost`."""
        decay = np.exp(-self.steepness * (r - self.centre))
        return float(np.sum(self.amplitude * decay / (1.0 + decay) ** 2))


def sigmoids_of(profile: RadialProfile) -> Sigmoids:
    """Return a flying profile as a sum of sigmoids; the analytic one is a single sigmoid about r = 1.

    Raises TypeError for a profile that is not a sum of sigmoids.
    """
    if isinstance(profile, AnalyticProfile):
        steepness = np.array([2.0 / profile.half_width])
        return Sigmoids(steepness, steepness, np.array([1.0]))
    if not isinstance(profile, PairwiseNetwork):
        raise TypeError(f"{type(profile).__name__} is no sum of sigmoids")
    weight, bias, output = profile.input_weight, profile.input_bias, profile.output_weight
    active = weight != 0.0  # the others are constants, without a slope
    return Sigmoids(np.abs(output * weight)[active], np.abs(weight[active]), -bias[active] / weight[active])


def quiet_distance_m(sigmoids: Sigmoids, penalties: Sequence[tuple[float, float]], allowed_m: float) -> float:
    """Return a distance from a threat or peer beyond which its part of |dF*/dU| is at most `allowed_m`, m.

    `penalties` are (weight in m^2, radius in m), one per disc about it; `allowed_m` is positive. Conservative: a bound
    of the slope is used, and if it is met at the outermost centre but not everywhere, that centre is the distance.
    """
    if SIGMOID_SLOPE_MAX * sigmoids.weight_sum * sum(weight / radius for weight, radius in penalties) <= allowed_m:
        return 0.0

    def too_near(distance_m: float) -> bool:
        parts = (weight / radius * sigmoids.slope_bound(distance_m / radius) for weight, radius in penalties)
        return sum(parts) > allowed_m

    near_m = sigmoids.outermost * max(radius for _, radius in penalties)
    if not too_near(near_m):
        return near_m
    far_m = 2.0 * near_m
    while too_near(far_m):
        far_m *= 2.0
    for _ in range(BISECTIONS):
        middle_m = (near_m + far_m) / 2.0
        near_m, far_m = (middle_m, far_m) if too_near(middle_m) else (near_m, middle_m)
    return far_m
