"""Which tables the columns of a recording may belong to."""

from tiltcal.recordings.recording import Recording
from tiltcal.setup.tables import Table, angle_channel, axis_names, tables


def tables_of(recording: Recording) -> list[Table]:
    """The tables whose axes are those that the recording reads; none where it reads no angle."""
    read = {a for a in axis_names() if recording.channel(angle_channel(a)) is not None}
    return [t for t in tables().values() if t.axes and set(t.axis_names) == read]


def other_tables(recording: Recording, stated: str) -> str:
    """What to do instead where the columns are those of other tables than the stated one; empty
    where they are not.
    """
    names = [t.name for t in tables_of(recording)]
    if not names or stated in names:
        return ""
    wanted = " or ".join(f'"{name}"' for name in names)
    return f"; or set table = {wanted}, which its columns fit"
