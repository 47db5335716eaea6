"""tiltcal: the metrologist. A Recording in, a Calibration and a Diagnosis out.

The rooms, left to right as they may import each other: units and frames; the records (recording,
    setup, sequence,
motion); kinematics and effects; chain and noise; fit and calibration; methods; scenario and
laboratory; verify and
report; cli. The simulator (package ``tiltsim``) imports tiltcal, never the other way round.
"""

__version__ = "0.1.0"
