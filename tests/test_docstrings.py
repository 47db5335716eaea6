"""The check of public docstrings finds what is missing, and the project passes it."""

import pytest

from tests.checks.docstrings import main, missing_in, modules

HEAD = "from tiltcal.core.arrays import Array\n\n\n"


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ('def f(x: Array) -> float:\n    """Its size."""\n', "shape of an array"),
        ('def f(x: Array) -> float:\n    """Its size. x: (n,)."""\n', None),
        ('def f(angle: float) -> float:\n    """Turned."""\n', "unit of angle"),
        ('def f(angle: float) -> float:\n    """Turned. angle: rad."""\n', None),
        (
            'def f(a: int, b: int) -> int:\n    """Sum.\n\n    Args:\n        a: one.\n    """\n',
            "b und",
        ),
        (
            'def f(a: int, b: int) -> int:\n    """Sum.\n\n    Args:\n        a, b: 2.\n    """\n',
            None,
        ),
        (
            'def f() -> None:\n    """Refuse."""\n    raise TiltcalError("x")\n',
            "Raises TiltcalError",
        ),
        ('def _f(x: Array) -> float:\n    """Its size."""\n', None),
        ('class C:\n    def f(self, x: Array) -> float:\n        """Its size."""\n', "shape of an"),
    ],
)
def test_what_is_missing_is_named(source, expected, tmp_path, monkeypatch):
    monkeypatch.setattr("tests.checks.docstrings.ROOT", tmp_path)
    (tmp_path / "module.py").write_text(HEAD + source)
    found = list(missing_in(tmp_path / "module.py"))
    assert len(found) == (expected is not None)
    assert expected is None or expected in found[0]


def test_a_helper_that_makes_the_error_counts_as_raising_it(tmp_path, monkeypatch):
    monkeypatch.setattr("tests.checks.docstrings.ROOT", tmp_path)
    made = 'def _no() -> TiltcalError:\n    return TiltcalError("x")\n\n\n'
    (tmp_path / "module.py").write_text(
        made + 'def f() -> None:\n    """Refuse."""\n    raise _no()\n'
    )
    assert [line.split(": ")[-1] for line in missing_in(tmp_path / "module.py")] == [
        "Raises TiltcalError"
    ]


def test_the_project_passes(capsys):
    assert len(modules()) > 300
    assert main() == 0, capsys.readouterr().out
