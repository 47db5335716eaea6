"""Names of columns from a line that has one name too few or too many: only those that the numbers
prove.
"""

from collections.abc import Sequence

from tiltcal.recordings.formats.raw_table import Raw
from tiltcal.recordings.proposal.channels import meaning_of
from tiltcal.recordings.proposal.time_axis import holds_times


def proven_names(
    names: Sequence[str], columns: Sequence[tuple[str, Raw]]
) -> tuple[dict[int, str], str]:
    """Index of a column -> its name, and what is known of them, in words.

    One name is missing (or has no column), and nothing states which. Where a name means time, and
    times are in its own column and not in the one beside, that name is before (after) the rest of
    the time: the names on the other side of the time are then where they have to be.

    Args:
        names: in the order of the line, one more or one less than the columns.
        columns: of the data, by number, (n,) each.
    """
    shift = 1 if len(names) < len(columns) else -1
    times = {k for k, (_, raw) in enumerate(columns) if holds_times(raw)}
    for k, name in enumerate(names):
        if meaning_of(name).role != "time":
            continue
        if k + shift in times and k not in times:
            found = {j + shift: n for j, n in enumerate(names) if j >= k}
        elif k in times and k + shift not in times:
            found = {j: n for j, n in enumerate(names) if j <= k}
        else:
            continue
        column = next(c for c, n in found.items() if n == name)
        side = "after" if column != k else "before"
        return found, (
            f"the times in column {column + 1} show where '{name}' and the names {side} it"
            " belong; other columns go by number"
        )
    return {}, "columns go by number"
