"""Text of comparisons over conditions."""

from leactl.report.conditions import comparisons_text, merged_by_reason


def test_results_that_cannot_be_compared_for_one_reason_share_a_line():
    refused = ["loss: 3 values of 3: repeat them", "efficiency: 3 values of 3: repeat them", "power: no uncertainty"]
    assert merged_by_reason(refused) == ["loss, efficiency: 3 values of 3: repeat them", "power: no uncertainty"]
    assert comparisons_text("efficiency", [], refused).count("repeat them") == 1
