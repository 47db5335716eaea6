"""From recordings to what is observed in them: on a table, or turned by hand."""

from collections.abc import Sequence

from tiltcal.diagnosis.data.handheld_channels import HandheldObservations
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.data.table_channels import TableObservations
from tiltcal.effects.base import Effect
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording import Recording


def observe(
    scenario: Scenario,
    recordings: Sequence[Recording],
    known: Sequence[Effect] = (),
    block: int = 1,
) -> Observations:
    """The readings of these recordings that the scenario has a model for.

    Args:
        scenario: site, rig, sensors, what is adjustable.
        recordings: of one set-up.
        known: effects at stated values.
        block: samples that are averaged into one, on a table.
    """
    if scenario.rig.axes:
        return TableObservations(scenario, recordings, known).averaged(block)
    return HandheldObservations(scenario, recordings, known)
