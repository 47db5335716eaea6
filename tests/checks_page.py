"""The page of the checks of the data, docs/checks.md: made from the checks themselves.

python -m tests.checks_page            compare the page with the checks
python -m tests.checks_page --write    write it anew
"""

import sys
from pathlib import Path

from tiltcal.data_quality.registry import CHECKS

PAGE = Path(__file__).parents[1] / "docs" / "checks.md"
HEAD = """\
# Checks of the data

After this page you know which faults `import`, `calibrate`, `check` and `diagnose` look for in the
columns of a log before any model, at which size they are found, and what can be repaired.

There is one list of checks. Each states its finding in one sentence, which is the same wherever it
is printed. What a command makes of it differs:

- `import` prints it and changes nothing; `--repair NAME` repairs it.
- `calibrate` and `check` use readings at standstill of accelerometers and inclinometers, and all
  readings of rate sensors. Where a fault lies in what is used, the result is refused, or
  `suspect` by the test that the table names; elsewhere, and where it does no harm, the test passes
  and says it.
- `diagnose` repairs what is certain and reports it as an effect of the catalogue where there is
  one, else as a note.

Stamps that do not increase are refused by `calibrate` and `check` where the file is read, with the
row.

Checks stand in their order: what one of them repairs or explains, those after it do not see. Those
that count repeats do so at one in a million for each channel, the others have thresholds; none
finds a fault in five hundred sound logs of all units and kinds of rounding
(`tests/test_data_checks.py`). Faults that need a model are on the page on [faults](faults.md).

| check | what it is | looks at | found at | test of a calibration | repair |
|---|---|---|---|---|---|
"""
ANSWERS = {"refused": "refused", "suspect": "`suspect`", "note": "said"}


def page() -> str:
    """The text of the page."""
    rows = []
    for check in CHECKS:
        about = " ".join((check.__doc__ or "").split()).rstrip(".")
        repair = f"`{check.repair}`" if check.repair else "-"
        if check.is_certain:
            repair = f"{repair}, certain" if check.repair else "`diagnose` leaves it out"
        test = f"`{check.test}`: {ANSWERS[check.answer]}"
        cells = (f"`{check.name}`", about, check.looks_at, check.finds, test, repair)
        rows.append(f"| {' | '.join(cells)} |")
    return HEAD + "\n".join(rows) + "\n"


def main() -> int:
    """Write the page, or say whether it is as the checks say."""
    if "--write" in sys.argv:
        PAGE.write_text(page(), encoding="utf-8")
        return 0
    same = PAGE.read_text(encoding="utf-8") == page()
    print("the page is as the checks say" if same else "run python -m tests.checks_page --write")
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
