"""Completion scripts of the shells."""

import json
import shutil
import subprocess

import pytest

from tiltcal.cli import main
from tiltcal.cli.commands import COMMANDS

SHELLS = {
    "bash": "complete -F _tiltcal tiltcal",
    "zsh": "#compdef tiltcal",
    "fish": "complete -c tiltcal",
}


def script_of(shell, capsys):
    """The completion script of a shell."""
    assert main(["completion", shell]) == 0
    return capsys.readouterr().out


def completed(script, folder, *words):
    """What bash offers for the last of the words of a command line."""
    (folder / "tiltcal.bash").write_text(script)
    line = " ".join(words)
    program = f"""
source tiltcal.bash
COMP_WORDS=({line}); COMP_CWORD={len(words) - 1}
_tiltcal
printf '%s\\n' "${{COMPREPLY[@]}}"
"""
    done = subprocess.run(
        ["bash", "-c", program], cwd=folder, capture_output=True, text=True, check=True
    )
    return done.stdout.split()


@pytest.mark.parametrize("shell", SHELLS)
def test_every_shell_gets_a_script_with_all_commands_and_options(shell, capsys):
    script = script_of(shell, capsys)
    assert SHELLS[shell] in script
    assert all(name in script for name in COMMANDS)
    for option in ("scenario", "budget-s", "json"):
        assert option in script


@pytest.mark.parametrize("shell", SHELLS)
@pytest.mark.usefixtures("here")
def test_every_shell_that_is_installed_accepts_its_script(shell, here, capsys):
    program = shutil.which(shell)
    if program is None:
        pytest.skip(f"{shell} is not installed")
    (here / "script").write_text(script_of(shell, capsys))
    assert subprocess.run([program, "-n", "script"], check=False).returncode == 0


def test_bash_completes_commands_options_and_choices(here, capsys):
    script = script_of("bash", capsys)
    assert completed(script, here, "tiltcal", "dia") == ["diagnose"]
    assert completed(script, here, "tiltcal", "diagnose", "--sta") == ["--static"]
    assert completed(script, here, "tiltcal", "design", "--grade", "pre") == ["precision"]
    assert completed(script, here, "tiltcal", "completion", "fi") == ["fish"]


@pytest.mark.parametrize("shell", SHELLS)
def test_install_writes_the_script_to_the_folder_of_the_shell(shell, here, monkeypatch, capsys):
    monkeypatch.setenv("HOME", str(here))
    for name in ("XDG_DATA_HOME", "XDG_CONFIG_HOME", "ZSH_CUSTOM", "ZSH", "ZDOTDIR"):
        monkeypatch.delenv(name, raising=False)
    assert main(["completion", shell, "--install", "--json"]) == 0
    file = here / json.loads(capsys.readouterr().out)["file"]
    assert here in file.parents
    assert "diagnose" in file.read_text()


def test_an_unknown_shell_is_refused_with_the_choices(capsys):
    assert main(["completion", "tcsh"]) == 2
    assert '"bash", "zsh", "fish"' in capsys.readouterr().err
