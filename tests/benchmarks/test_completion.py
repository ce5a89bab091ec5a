"""`fbl-gym completion`: what a shell offers behind TAB."""

import shutil
import subprocess

import pytest

from benchmarks import cli

BASH = shutil.which("bash")

ASK = """
source {script}
COMP_WORDS=({words}) COMP_CWORD={last} COMP_LINE="{words}" COMP_POINT={length}
$(complete -p fbl-gym | {read})
printf '%s\\n' "${{COMPREPLY[@]}}"
"""


@pytest.fixture(scope="module")
def scripts(tmp_path_factory):
    """Each shell's script, by the shell."""
    folder = tmp_path_factory.mktemp("completion")
    for shell in ("bash", "zsh", "fish"):
        with pytest.MonkeyPatch.context() as patch, (folder / shell).open("w") as file:
            patch.setattr("sys.stdout", file)
            assert cli.main(["completion", shell]) == 0
    return folder


@pytest.fixture
def offered(scripts, tmp_path):
    """Return the completions that bash offers for the last word of a line. Only bash is on the path, so no Python starts."""
    if BASH is None:
        pytest.skip("needs bash")

    def ask(line):
        words = line.split(" ")
        read = "{ read -r line; line=${line#*-F }; echo ${line%% *}; }"
        quoted = " ".join(word or "''" for word in words)
        text = ASK.format(script=scripts / "bash", words=quoted, last=len(words) - 1, length=len(line), read=read)
        options = {"capture_output": True, "text": True, "env": {"PATH": ""}, "cwd": tmp_path}
        done = subprocess.run([BASH, "--norc", "-c", text], **options)
        assert done.returncode == 0, done.stderr
        return done.stdout.split()

    return ask


def test_commands_and_options_complete(offered):
    assert set(offered("fbl-gym ")) == set(cli.COMMANDS)
    assert offered("fbl-gym ev") == ["evaluate"]
    assert offered("fbl-gym evaluate pid-flm --sc") == ["--scenario"]
    assert offered("fbl-gym transfer --world mujoco-be") == ["mujoco-bend"]


def test_names_complete_where_they_are_expected(offered):
    assert offered("fbl-gym evaluate cascade-f") == ["cascade-flm", "cascade-flm@tuned", "cascade-flm+predictor@tuned"]
    assert offered("fbl-gym evaluate cascade-flm@") == ["cascade-flm@tuned"]
    assert offered("fbl-gym compare pid-flm ppo-mem") == ["ppo-memory"]
    assert offered("fbl-gym leaderboard --policies zero oracle-f") == ["oracle-flm"]
    assert offered("fbl-gym evaluate pid-flm --scenario section-2-2/payload-") == [
        f"section-2-2/payload-{severity}" for severity in range(4)
    ]
    assert offered("fbl-gym leaderboard --scenarios pay")[0] == "payload"
    assert offered("fbl-gym leaderboard --suite i") == ["ideal"]
    assert offered("fbl-gym list su") == ["suites"]


def test_a_law_of_ones_own_completes_as_a_file(offered, tmp_path):
    (tmp_path / "my_law.py").touch()
    assert offered("fbl-gym check-policy my") == ["my_law.py"]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_shell_reads_its_script(shell, scripts):
    if shutil.which(shell) is None:
        pytest.skip(f"needs {shell}")
    done = subprocess.run([shell, "-n", str(scripts / shell)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
