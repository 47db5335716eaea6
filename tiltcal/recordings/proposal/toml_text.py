"""A proposed mapping as TOML: a reason on each line, and a mark for what cannot be known."""

import json
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tiltcal.recordings.proposal.propose import ColumnGuess, Proposal
    from tiltcal.recordings.proposal.time_axis import TimeGuess

_ABREAST = 28  # columns that a value takes before its reason


def proposal_text(proposal: "Proposal") -> str:
    """The text of the mapping."""
    lines = [
        f"# Mapping of {proposal.source}, proposed by `tiltcal import --propose`: check each line.",
        f"# {proposal.format}, {proposal.rows} rows.",
    ]
    lines += _file(proposal)
    lines += _time(proposal)
    for column in proposal.columns:
        lines += _column(column, proposal)
    if proposal.table is not None and proposal.table.table:
        lines += ["[metadata]", _line("table", proposal.table.table, proposal.table.reason)]
    lines += [""]
    lines += [f"# cannot know: {doubt}" for doubt in proposal.doubts]
    lines += [f"# found: {finding.statement}" for finding in proposal.findings]
    if proposal.left_out:
        lines.append(f"# left out: {', '.join(proposal.left_out)}")
    return "\n".join(lines) + "\n"


def _line(key: str, value: object, reason: str) -> str:
    text = f"{key} = {json.dumps(value, ensure_ascii=False)}"
    return f"{text:<{_ABREAST}} # {reason}" if reason else text


def _file(proposal: "Proposal") -> list[str]:
    main = _main(proposal)
    if proposal.dialect is None:
        return ["[file]", _line("table", main, "most channels stand there")] if main else []
    words, reasons = proposal.dialect.words, proposal.dialect.reasons
    stated = words.model_dump(exclude={"table", "ragged_lines"})
    always = ("separator", "decimal", "encoding", "header")
    shown = {k: v for k, v in stated.items() if k in always or v}
    lines = ["[file]", *(_line(k, v, reasons.get(k, "")) for k, v in shown.items())]
    if any(f.kind == "ragged_lines" for f in proposal.findings):
        why = 'some lines have another number of cells; "drop" leaves them out'
        lines.append(_line("ragged_lines", "refuse", why))
    return lines


def _main(proposal: "Proposal") -> str:
    """The table that most channels stand in."""
    names = [c.channel.table for c in proposal.columns]
    return max(names, key=names.count)


def _time(proposal: "Proposal") -> list[str]:
    time = proposal.time[_main(proposal)]
    if time.channel is None:
        if time.rate:
            return ["[time]", _line("rate_hz", time.rate, time.reason)]
        return ["[time]", _line("rate_hz", "?", f"cannot know: {time.doubts[0]}")]
    lines = ["[time]", _line("column", time.channel.source, time.reason)]
    if time.tick_s:
        lines.append(_line("tick_s", time.tick_s, time.unit_reason))
        return [*lines, _line("wraps_at", time.wraps_at, "it has 32 bits")]
    if not time.unit:
        return [*lines, _line("unit", "?", f"cannot know: {time.doubts[0]}")]
    return [*lines, _line("unit", time.unit, time.unit_reason)]


def _column(column: "ColumnGuess", proposal: "Proposal") -> list[str]:
    channel, main = column.channel, _main(proposal)
    lines = ["[[column]]", _line("from", channel.source, "")]
    if channel.table != main:
        lines.append(_line("table", channel.table, ""))
        lines += _own_time(proposal.time[channel.table], proposal.time[main])
    mark = "cannot know the unit, see the end; " if column.to.endswith("_?") else ""
    lines.append(_line("to", column.to, mark + column.reason))
    if column.scale != 1.0:
        lines.append(_line("scale", column.scale, ""))
    if column.offset:
        lines.append(_line("offset", column.offset, ""))
    return lines


def _own_time(own: "TimeGuess", main: "TimeGuess") -> list[str]:
    """The time column of another table where it has another name."""
    if own.channel is None or main.channel is None or own.channel.source == main.channel.source:
        return []
    return [_line("time", own.channel.source, own.reason)]
