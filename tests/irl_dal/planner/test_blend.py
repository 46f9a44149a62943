import math

import numpy as np
import pytest

from irl_dal.planner.blend import ActionBlend, BlendConfig


def test_table_ii_is_the_default() -> None:
    """d_critical, s_1, s_2 and k_tanh are the paper's."""
    config = BlendConfig()
    assert config.critical_clearance == 1.5
    assert (config.distance_scale, config.deviation_scale, config.deviation_gain) == (2.0, 0.2, 0.3)


def test_critical_distance_hands_over() -> None:
    """Just below d_critical the planner drives alone, at it the formula holds again."""
    blend = ActionBlend()
    assert blend.instantaneous(1.4999, 0.0) == 1.0
    assert blend.instantaneous(1.5, 0.0) == pytest.approx(0.5 + 0.5 * math.exp(-0.75))


def test_hazard_at_its_corners() -> None:
    """Eq. blend_hazard: contact gives 1, a lost lane adds k_tanh, an open road nothing."""
    blend = ActionBlend()
    assert blend.hazard(math.inf, 0.0) == 0.0
    assert blend.hazard(0.0, 0.0) == 1.0
    assert blend.hazard(math.inf, math.inf) == pytest.approx(0.3)
    assert blend.hazard(2.0, -0.2) == pytest.approx(math.exp(-1.0) + 0.3 * math.tanh(1.0))
    assert blend.hazard(2.0, 0.2) == blend.hazard(2.0, -0.2)


def test_weight_never_exceeds_one() -> None:
    """However the numbers are chosen, the weight stays a share."""
    blend = ActionBlend(BlendConfig(deviation_gain=50.0))
    assert blend.instantaneous(1.5, 10.0) == 1.0


def test_average_is_exponential() -> None:
    """The first weight counts in full, later ones by half."""
    blend = ActionBlend()
    near, far = blend.instantaneous(2.0, 0.0), blend.instantaneous(10.0, 0.0)
    assert blend.weight(2.0, 0.0) == near
    assert blend.weight(10.0, 0.0) == pytest.approx(near + 0.5 * (far - near))


def test_average_is_forgotten_when_the_trigger_releases() -> None:
    """After a reset the past does not count."""
    blend = ActionBlend()
    far = blend.instantaneous(10.0, 0.0)
    blend.weight(1.0, 0.0)
    assert blend.weight(10.0, 0.0) > far
    blend.reset()
    assert blend.weight(10.0, 0.0) == far


def test_critical_weight_is_not_delayed_unless_asked() -> None:
    """In a critical state the average jumps to 1; as printed it only moves towards it."""
    prompt, printed = ActionBlend(), ActionBlend(BlendConfig(smooth_critical=True))
    for blend in (prompt, printed):
        blend.weight(10.0, 0.0)
    assert prompt.weight(1.0, 0.0) == 1.0
    far = printed.instantaneous(10.0, 0.0)
    assert printed.weight(1.0, 0.0) == pytest.approx(0.5 * (1.0 + far))


def test_the_planner_drives_alone_where_the_policy_does_not_get_on() -> None:
    """At once, whatever the average; afterwards the policy gets its share back step by step."""
    blend = ActionBlend(BlendConfig(smooth_critical=True))
    usual = blend.weight(20.0, 0.0)
    assert blend.weight(20.0, 0.0, stalled=True) == 1.0
    assert usual < blend.weight(20.0, 0.0) < 1.0


def test_what_is_no_number_counts_as_the_worst() -> None:
    """A NaN clearance is contact, a NaN lane deviation a lost lane."""
    blend = ActionBlend()
    assert blend.weight(math.nan, 0.0) == 1.0
    assert blend.instantaneous(5.0, math.nan) == blend.instantaneous(5.0, math.inf)


def test_blend_at_its_ends() -> None:
    """Weight 0 is the policy's action, 1 the planner's, a half the middle."""
    planned, nominal = np.array([0.4, 2.0]), np.array([-0.2, 6.0])
    np.testing.assert_array_equal(ActionBlend.blend(planned, nominal, 0.0), nominal)
    np.testing.assert_array_equal(ActionBlend.blend(planned, nominal, 1.0), planned)
    np.testing.assert_allclose(ActionBlend.blend(planned, nominal, 0.5), [0.1, 4.0])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("distance_scale", 0.0),
        ("deviation_scale", -0.2),
        ("deviation_gain", -1.0),
        ("base", 1.5),
        ("critical_clearance", math.nan),
    ],
)
def test_config_refuses_nonsense(name: str, value: float) -> None:
    """An impossible number is refused by name and value."""
    with pytest.raises(ValueError, match=f"`{name}` must .* Got {value}"):
        BlendConfig(**{name: value})  # type: ignore[arg-type]
