"""A guide that runs: samples come in beside the pages, which show its state."""

from collections.abc import Mapping
from pathlib import Path
from threading import Lock, Thread

from tiltcal.api.scenario import Scenario
from tiltcal.core.errors import TiltcalError
from tiltcal.guide.guide import Guide
from tiltcal.guide.sources import ServedTable, Source, TableDriver, open_source
from tiltcal.guide.state import GuideState


class Live:
    """A guide fed from a source until it is done, the source ends, or it is stopped.

    Args:
        scenario: site, rig and sensors.
        method: of the calibration.
        source: as ``open_source`` takes it.
        goal: of each kind of parameter.

    Raises:
        TiltcalError: the source is none, or the method cannot be guided.
    """

    def __init__(
        self, scenario: Scenario, method: str, source: str, goal: Mapping[str, str]
    ) -> None:
        self.guide = Guide(scenario, method, goal=goal)
        self.ended = ""
        self._samples: Source = open_source(source)
        self._stopped = False
        self._lock = Lock()
        self._state = self.guide.state
        Thread(target=self._run, daemon=True).start()

    @property
    def runs(self) -> bool:
        """Whether samples are still taken."""
        return not self.ended

    @property
    def by_head(self) -> bool:
        """Whether angles of a dividing head are typed."""
        return self._state.manner == "head"

    @property
    def state(self) -> GuideState:
        """What is to be shown now."""
        return self._state

    def stop(self) -> None:
        """Take no further samples."""
        self._stopped = True

    def set_angles(self, angles_deg: Mapping[str, float] | None) -> None:
        """State where the dividing head stands; at the proposed pose without angles."""
        with self._lock:
            self.guide.set_angles(angles_deg)
            self._state = self.guide.state

    def reject(self) -> None:
        """Leave the last dwell out."""
        with self._lock:
            self.guide.reject()
            self._state = self.guide.state

    def save(self, folder: Path) -> dict[str, Path]:
        """Write the recording and the calibration."""
        with self._lock:
            return self.guide.save(folder)

    def _run(self) -> None:
        samples = self._samples
        driver = TableDriver(samples) if isinstance(samples, ServedTable) else None
        said = "The source has ended."
        try:
            for arrival in samples:
                with self._lock:
                    arrival.give(self.guide)
                    self._state = self.guide.state
                if driver is not None:
                    driver.follow(self._state)
                if self._state.done:
                    said = "Done: every goal is reached."
                if self._state.done or self._stopped:
                    break
        except (TiltcalError, OSError) as error:
            said = str(error)
        finally:
            samples.close()
            self.ended = "Stopped." if self._stopped else said
