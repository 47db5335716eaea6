"""What one command writes the others read: a few of the scenarios that
``python -m tests.closed_commands`` draws by the hundred.
"""

import numpy as np
import pytest

from tests.closed_commands import broken_rules, random_scenario


@pytest.mark.parametrize("number", [2, 6, 18])
def test_a_random_scenario_goes_through_every_command(number, tmp_path):
    scenario = random_scenario(np.random.default_rng([1, number]))
    assert broken_rules(scenario, tmp_path) == []


def test_a_broken_rule_is_seen(tmp_path):
    """A scenario that no simulator takes breaks the first rule."""
    scenario = random_scenario(np.random.default_rng([1, 2])) | {"rig": {"table": "none"}}
    (broken,) = broken_rules(scenario, tmp_path)
    assert broken.rule == "it is simulated"
