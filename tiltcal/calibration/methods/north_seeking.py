"""S4's north-seeker: azimuth from the Earth's rate that a FOG sees at two, four or more positions
of a vertical table.
"""

from collections.abc import Sequence

import numpy as np

from tiltcal.calibration.methods.common import pick_sensor, whitening, wrap_up
from tiltcal.calibration.methods.north_checks import (
    north_notes,
    north_tests,
    split_dwells,
    walk_covariance,
    walk_density,
    walk_note,
    wrapped,
)
from tiltcal.calibration.methods.reversal import (
    attitudes,
    dwell_angles,
    mount_of,
    require_vertical,
)
from tiltcal.calibration.methods.turntable import Turntable, solve, start_of
from tiltcal.calibration.result import Calibration
from tiltcal.calibration.screen.data import data_tests
from tiltcal.calibration.validity import verdict_of
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import DEG
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.references import References
from tiltcal.recordings.segmentation import Segment, dwells, find_segments
from tiltcal.recordings.static_poses import Poses, find_poses
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup

NAME = "north"
POLE = 85 * DEG


def north(
    recording: Recording,
    setup: Setup,
    *,
    segments: Sequence[Segment] | None = None,
    sensor: str | None = None,
    level: str | None = None,
    tilt: bool = True,
    near_deg: float | None = None,
    near_error_deg: float = 60.0,
) -> Calibration:
    """Azimuth of the instrument, and with accelerometers on the same table the tilt of its base,
    from the same turn.

    Model: ``fog = b + u . R_wb' W``, ``force = c + P R_wb' (0, 0, g)``, ``R_wb = Rx(roll) Ry(pitch)
    Rz(outer) R_mount``; W is the Earth's rate in a world turned by the unknown heading. All dwells
    and both sensors are fitted together.

    Args:
        recording: dwells at two positions half a turn apart, better four a quarter turn apart.
        setup: table ``vertical``, site with latitude (its heading is not used), a FOG, an
            accelerometer or inclinometer with x, y.
        segments: dwells to use.
        sensor: which FOG, when several fit.
        level: which accelerometer, when several fit.
        tilt: False leaves the tilt correction out.
        near_deg: azimuth known beforehand (a compass): decides between the two solutions of two
            positions, where only one of them lies within its error.
        near_error_deg: largest error of that compass.

    Raises:
        TiltcalError: another table, no latitude or one near a pole, one position only.

    Errors:
        Two positions give the azimuth's cosine only, and nothing near north: sigma = N / (sqrt(2 T)
        Omega cos(lat) |sin psi|).
            Without tilt correction a tilt e along the FOG's axis changes the azimuth by
            tan(lat)/|sin psi| e; an angle of the FOG's axis out of the table's plane is bias.

    Source: Transducer and Microsystem Technologies 2009 28(12) p. 86 (docs/sources.md, "Dual-axis
    tilt and north"); docs/physics.md, "North".
    """
    require_vertical(setup, NAME, "use a table that turns about Up")
    fog = pick_sensor(setup, recording, ("fog",), sensor, NAME)
    found = list(find_segments(recording)) if segments is None else dwells(segments)
    accel = _level(recording, setup, level) if tilt else None
    live = [
        *data_tests(recording, fog),
        *(data_tests(recording, accel, axes="xy") if accel is not None else ()),
    ]
    table, poses, walk = _turntable(recording, setup, fog, accel, found)
    roll, pitch, heading, rivals = start_of(table)
    sure = len(rivals) == 1
    if near_deg is not None:
        off = {h: abs(wrapped(table.azimuth(h, roll, pitch) - near_deg * DEG)) for h in rivals}
        heading = min(off, key=lambda h: off[h])
        sure = sum(angle <= near_error_deg * DEG for angle in off.values()) == 1
    fit, converged = solve(table, heading, roll, pitch)
    unit = recording.sensor(fog).units[0]
    tests = [*north_tests(table, fit, rivals, (roll, pitch), fog, unit), *live]
    notes = north_notes(table, fit, rivals, sure, roll, pitch)
    notes.append(walk_note(walk, table.angles))
    return wrap_up(
        NAME,
        verdict_of(tests, sure and converged and not fit.dropped),
        fit,
        [_unit(n, fog.name) for n in fit.names],
        tests,
        notes,
        poses,
        recording,
        equation=(
            f"{fog.name} = bias + u . R_wb' W(azimuth), R_wb = Rx(roll) Ry(pitch) Rz(outer) R_mount"
        ),
        inverse="rate = reading - bias",
    )


def _unit(name: str, fog: str) -> str:
    """Unit of a parameter."""
    if name.startswith(fog):
        return "rad_s"
    return "rad" if name.startswith("base.") else "m_s2"


def _level(recording: Recording, setup: Setup, name: str | None) -> Sensor | None:
    """The sensor that sees the tilt; None when there is none with x and y."""
    kinds = ("accelerometer", "inclinometer")
    if name is not None:
        return pick_sensor(setup, recording, kinds, name, NAME)
    fitting = [s for s in setup.sensors(*kinds) if recording.has(s) and {"x", "y"} <= set(s.axes)]
    return fitting[0] if fitting else None


def _turntable(
    recording: Recording,
    setup: Setup,
    fog: Sensor,
    level: Sensor | None,
    segments: Sequence[Segment],
) -> tuple[Turntable, Poses, float]:
    """Means of all dwells by FOG and accelerometers, the poses of the FOG, and the density of its
    bias walk, (rad/s)^2/s.
    """
    latitude = _latitude(setup)
    poses = find_poses(recording, setup, fog, segments)
    angles = dwell_angles(poses, recording)
    walk = _walk(recording, setup, fog, segments)
    start = np.array([s.start_s for s in poses.spans])
    end = np.array([s.end_s for s in poses.spans])
    covariance = np.diag(poses.covariances[:, 0, 0]) + walk_covariance(start, end, walk)
    force, references = None, (poses.references, References())
    if level is not None:
        seen = find_poses(recording, setup, level, segments)
        if len(seen) != len(poses):
            raise TiltcalError(
                recording.source,
                found=f"{len(seen)} dwells of {level.name} and {len(poses)} of {fog.name}",
                need="both sensors at every position",
                do="record both throughout",
            )
        force, of_level = _horizontal(seen)
        references = poses.references, of_level
    table = Turntable(
        angles,
        mount_of(recording, setup),
        fog.input_vector,
        poses.means[:, 0],
        whitening(covariance),
        force,
        setup.site.gravity,
        latitude,
        (fog.name, "" if level is None else level.name),
        references,
    )
    return table, poses, walk


def _walk(recording: Recording, setup: Setup, fog: Sensor, segments: Sequence[Segment]) -> float:
    """Density of the random walk of the FOG's bias, from parts of the dwells, (rad/s)^2/s."""
    parts = find_poses(recording, setup, fog, split_dwells(dwells(segments)))
    angles = dwell_angles(parts, recording)
    axes = attitudes(0.0, 0.0, angles, mount_of(recording, setup)) @ fog.input_vector
    columns = np.column_stack([np.ones(len(axes)), axes[:, :2]])
    time = np.array([(s.start_s + s.end_s) / 2 for s in parts.spans])
    seen = np.linalg.norm(columns, axis=0) > 1e-9
    return walk_density(parts.means[:, 0], parts.covariances[:, 0, 0], time, columns[:, seen])


def _latitude(setup: Setup) -> float:
    """Latitude, rad; refuses none, and one near a pole."""
    stated = setup.site.latitude_deg
    if stated is None or abs(stated) * DEG > POLE:
        found = "no latitude" if stated is None else f"latitude {stated:g} deg"
        raise TiltcalError(
            "site", found=found, need="one within 85 deg of the equator", do="state latitude_deg"
        )
    return stated * DEG


def _horizontal(poses: Poses) -> tuple[tuple[Array, Array], References]:
    """Mean forces along x and y, (m, 2), their whitening, (m, 2, 2), and their references."""
    ij = [poses.sensor.axes.index(a) for a in ("x", "y")]
    whiten = whitening(poses.covariances[:, ij][:, :, ij])
    return (poses.means[:, ij], whiten), poses.references.of(ij)
