"""What one command writes the others read: a few of the scenarios that
``python -m tests.closed_commands`` draws by the hundred.
"""

import itertools

import numpy as np
import pytest

from tests.closed_commands import OutOfTime, Trial, limited, random_scenario


@pytest.mark.parametrize("number", [2, 6, 18])
def test_a_random_scenario_goes_through_every_command(number, tmp_path):
    scenario = random_scenario(np.random.default_rng([1, number]))
    assert Trial(scenario, tmp_path).run().broken == []


def test_a_broken_rule_is_seen(tmp_path):
    """A scenario that no simulator takes breaks the first rule."""
    scenario = random_scenario(np.random.default_rng([1, 2])) | {"rig": {"table": "none"}}
    (broken,) = Trial(scenario, tmp_path).run().broken
    assert broken.rule == "it is simulated"


def test_a_scenario_that_takes_too_long_is_stopped():
    with pytest.raises(OutOfTime), limited(0.05):
        for _ in itertools.count():  # in Python, where a signal is seen
            pass
