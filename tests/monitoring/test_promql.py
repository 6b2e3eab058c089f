"""The reader of expressions itself: it must not overlook what does not exist."""

import pytest

from tests.monitoring.known import complaints
from tests.monitoring.promql import Selector, named


def test_metrics_labels_and_groupings_are_found():
    found = named(
        'histogram_quantile(0.99, sum by (le, job) (rate(a_bucket{x="1", y!~"2|3"}[5m])))'
        " > 1e-3 and b unless on (job) c offset 5m"
    )
    assert found.selectors == [
        Selector("a_bucket", {"x": ("=", "1"), "y": ("!~", "2|3")}),
        Selector("b"),
        Selector("c"),
    ]
    assert found.grouping == {"le", "job"}


@pytest.mark.parametrize("expression", ["nosuch(a)", "a{", 'a{b="}', "sum", "a ? b"])
def test_what_cannot_be_read_is_an_error(expression):
    with pytest.raises(ValueError, match=r"."):
        named(expression)


@pytest.mark.parametrize(
    ("expression", "template"),
    [
        ("vcu_gateway_tick_total", ""),
        ("rate(vcu_gateway_tick_lateness_seconds_sum[5m])", ""),
        ('vcu_gateway_mode{state="active"}', ""),
        ('vcu_gateway_mode{mode="driving"}', ""),
        ('vcu_gateway_link_state{state=~"bus off|gone"}', ""),
        ("sum by (controller) (vcu_gateway_mode)", ""),
        ("vcu_gateway_mode", "{{ $labels.controller }}"),
        ("vcu_gateway_mode", "{{controller}}"),
        ("sum by (mode) (vcu_gateway_mode)", "{{ $labels.instance }}"),
    ],
)
def test_a_metric_label_or_value_that_does_not_exist_is_told(expression, template):
    assert len(complaints(expression, template)) == 1


def test_what_exists_is_not_complained_of():
    assert complaints('sum by (mode) (vcu_gateway_mode{mode="active"})', "{{mode}}") == []
    assert complaints('up{job="vcu-gateway"}', "{{ $labels.instance }}") == []
