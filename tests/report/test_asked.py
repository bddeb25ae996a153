"""What was asked of a response, in words: nothing that a number beside it contradicts."""

import numpy as np
import pytest

from necc_casadi.report.asked import asked_text, missed
from necc_casadi.synthesis.asked import Asked

LIMITS = np.array([[-3.0, 3.0]])


def asked(**known):
    given = {
        "rate": 4.0, "rate_reached": 1.04, "limits": LIMITS, "peaks": np.array([[-1.2, 1.7]]),
        "stopped_by": "input_peak", "held": np.array([0.7]), "unlimited": 4.61,
    }  # fmt: skip
    return Asked(**{**given, **known})


def test_a_rate_that_a_peak_stops():
    text = asked_text(asked())
    assert "rate 4 1/s asked, 1.04 1/s reached" in text
    assert "faster loops that were tried take more; with no limit 4.61 1/s is reached" in text
    assert missed(asked()) == "rate 4 1/s asked, 1.04 1/s reached"


def test_a_peak_that_is_not_kept_at_a_lower_rate_either():
    text = asked_text(asked(peaks=np.array([[-1.2, 3.2]])))
    assert "no loop keeps it; with no limit 4.61 1/s is reached" in text
    assert "tried take more" not in text


@pytest.mark.parametrize("rate", [None, 1.0])
def test_where_the_rate_is_reached_nothing_is_said_of_another(rate):
    """It is the peak alone that is not kept."""
    one = asked(rate=rate, peaks=np.array([[-1.2, 3.2]]), unlimited=8.28)
    text = asked_text(one)
    assert "no weight of the inputs that was tried keeps the peak" in text
    assert "8.28" not in text
    assert missed(one) == "the peak that was asked of u is not kept"


def test_what_holds_the_target_comes_first():
    assert "holding the target takes u = 5" in asked_text(asked(held=np.array([5.0])))
