"""Start script, in a copy of the project with stand-ins for uv, Python and system tools."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from runtime.commands.options import COMMANDS, version

ROOT = Path(__file__).parents[1]
BASH = "#!/usr/bin/env bash\n"
NOTE = 'echo "$(basename "$0") $*" >>"$CALLS"\n'
LIBRARIES = "libEGL.so.1 libGL.so.1 libX11.so.6 libusb-1.0.so.0 libudev.so.1 libidn2.so.0 libgomp.so.1"


class Project:
    """Fresh clone with stand-ins for all programs."""

    def __init__(self, folder: Path) -> None:
        self.root, self.bin, self.calls_file = folder / "project", folder / "bin", folder / "calls"
        self.root.mkdir()
        self.bin.mkdir()
        for name in ("headland", "requirements.txt", "requirements-uv.txt"):
            shutil.copy(ROOT / name, self.root)
        self.put("ldconfig", f'printf "%s => here\\n" {LIBRARIES}')
        self.put(
            "venv-python",
            NOTE + 'echo "$PWD|$PYTHONPATH"; [ "$2" = runtime.commands.warm_up ] || exit "${VERB_EXIT:-0}"',
        )
        self.put("uv", NOTE + UV)

    def put(self, name: str, body: str) -> None:
        """Places the stand-in of a program first on the path."""
        (self.bin / name).write_text(BASH + body)
        (self.bin / name).chmod(0o755)

    def start(self, *arguments: str, cwd: Path | None = None, **env: str) -> subprocess.Popen[str]:
        """Starts the script without waiting for it."""
        env = {"PATH": f"{self.bin}:/usr/bin:/bin", "CALLS": str(self.calls_file), "PYTHONPATH": "/opt/ros", **env}
        command = [str(self.root / "headland"), *arguments]
        pipe = subprocess.PIPE
        return subprocess.Popen(command, cwd=cwd or self.root, env=env, text=True, stdout=pipe, stderr=pipe)

    def run(self, *arguments: str, cwd: Path | None = None, **env: str) -> tuple[int, str, str]:
        """Exit code, stdout and stderr of the script."""
        process = self.start(*arguments, cwd=cwd, **env)
        out, err = process.communicate(timeout=60)
        return process.returncode, out, err

    def calls(self) -> list[str]:
        """Commands called since the last call, without the check that uv starts."""
        lines = self.calls_file.read_text().splitlines() if self.calls_file.exists() else []
        self.calls_file.unlink(missing_ok=True)
        return [" ".join(line.split()[:3]) for line in lines if line != "uv --version"]


UV = """
case $1 in
  venv) [ -z "${NO_PYTHON:-}" ] && mkdir -p "${@: -1}/bin" && ln -sf "${0%/*}/venv-python" "${@: -1}/bin/python" ;;
  pip) [ -z "${SYNC_FAILS:-}" ] && sleep "${SYNC_SECONDS:-0}" ;;
esac
"""
VENV, SYNC, CHECK, VERB = "uv venv --quiet", "uv pip sync", "python -m runtime.commands.warm_up", "python -m runtime"


@pytest.fixture
def project(tmp_path: Path) -> Project:
    return Project(tmp_path)


def test_script_parses() -> None:
    for script in ("headland", ".ci/run"):
        subprocess.run(["bash", "-n", str(ROOT / script)], check=True)


@pytest.mark.parametrize(("arguments", "code"), [(["--help"], 0), (["help"], 0), ([], 2)])
def test_help_without_install(project: Project, arguments: list[str], code: int) -> None:
    returned, out, err = project.run(*arguments)
    assert returned == code
    assert "usage: ./headland VERB" in (err if code else out)
    assert project.calls() == []
    assert not (project.root / ".venv").exists()


def test_version_and_wrong_option_without_install(project: Project) -> None:
    shutil.copy(ROOT / "pyproject.toml", project.root)
    code, out, _ = project.run("--version")
    assert (code, out) == (0, f"headland {version()}\n")
    code, _, err = project.run("--no-such")
    assert (code, err) == (2, "headland: --no-such: no such option; see ./headland --help\n")
    assert project.calls() == []


def test_help_lists_every_command(project: Project) -> None:
    _, out, _ = project.run("--help")
    for command in COMMANDS:
        assert f"  {command.verb:<13}{command.help}" in out


def test_set_up_at_first_start_only(project: Project) -> None:
    assert project.run("run")[0] == 0
    assert project.calls() == [VENV, SYNC, CHECK, VERB]
    assert project.run("run")[0] == 0
    assert project.calls() == [VERB]


def test_compiled_modules_are_kept_where_the_system_keeps_none(project: Project) -> None:
    project.put("venv-python", 'echo "$*: ${PYTHONDONTWRITEBYTECODE-kept}" >>"$CALLS"')
    assert project.run("run", PYTHONDONTWRITEBYTECODE="1")[0] == 0
    lines = [line for line in project.calls_file.read_text().splitlines() if line.startswith("-m")]
    assert lines == ["-m runtime.commands.warm_up: kept", "-m runtime run: kept"]


def test_changed_lock_in_place_update(project: Project) -> None:
    project.run("run")
    project.calls()
    (project.root / "requirements.txt").write_text("# nothing\n")
    assert project.run("run")[0] == 0
    assert project.calls() == [SYNC, CHECK, VERB]


def test_missing_python_recreates_environment(project: Project) -> None:
    project.run("run")
    project.calls()
    (project.root / ".venv/bin/python").unlink()
    assert project.run("run")[0] == 0
    assert project.calls() == [VENV, SYNC, CHECK, VERB]


def test_interrupted_set_up_is_repeated(project: Project) -> None:
    assert project.run("run", SYNC_FAILS="1")[0] != 0
    assert project.calls() == [VENV, SYNC]
    assert project.run("run")[0] == 0
    assert project.calls() == [VENV, SYNC, CHECK, VERB]


def test_concurrent_starts(project: Project) -> None:
    starts = [project.start("run", SYNC_SECONDS="0.5") for _ in range(3)]
    for start in starts:
        start.communicate(timeout=60)
    assert [start.returncode for start in starts] == [0, 0, 0]
    assert sorted(project.calls()) == sorted([VENV, SYNC, CHECK, VERB, VERB, VERB])


def test_working_directory_and_exit_code(project: Project, tmp_path: Path) -> None:
    code, out, _ = project.run("no-such-verb", cwd=tmp_path, VERB_EXIT="2")
    assert code == 2
    assert out.strip() == f"{tmp_path}|{project.root}"  # without the inherited PYTHONPATH


def test_install_command_without_permission(project: Project) -> None:
    project.put("ldconfig", "")
    project.put("id", "echo 1000")
    project.put("sudo", "exit 1")
    project.put("apt-get", "exit 1")
    code, _, err = project.run("run")
    assert code == 1
    assert "sudo apt-get -o DPkg::Lock::Timeout=600 install -y --no-install-recommends libegl1 libgl1 libx11-6" in err
    assert project.calls() == []


def test_install_of_missing_packages_as_root(project: Project) -> None:
    project.put("ldconfig", f"printf '%s => here\\n' {LIBRARIES.removeprefix('libEGL.so.1')}")
    project.put("id", "echo 0")
    project.put("apt-get", 'echo "$*" >>"$(dirname "$0")/installed"')
    assert project.run("run")[0] == 0
    assert (project.bin / "installed").read_text() == (
        "update\n-o DPkg::Lock::Timeout=600 install -y --no-install-recommends libegl1\n"
    )


def test_unsupported_python(project: Project) -> None:
    project.put("python3", "echo Python 3.9.2")
    code, _, err = project.run("run", NO_PYTHON="1")
    assert code == 1
    assert "Python 3.9.2" in err


def test_checks_in_full_test_run_only(project: Project) -> None:
    code, out, _ = project.run("test", "-k", "foo")
    assert (code, out.count("== ")) == (0, 1)
    code, out, _ = project.run("test", VERB_EXIT="1")
    assert code == 1
    headlines = [line for line in out.splitlines() if line.startswith("== ")]
    checks = [f"== {name}" for name in ("ruff check", "ruff format --check", "mypy")]
    failed = [line for name in checks for line in (name, f"{name}: FAILED")]
    assert headlines == ["== pytest, every branch of safety/ without a drive", "== pytest", *failed]
    assert out.count("FAILED") == 3


def test_benchmark_names(project: Project) -> None:
    shutil.copytree(ROOT / "benchmarks", project.root / "benchmarks")
    assert project.run("benchmark", "stack", "--seconds", "9")[0] == 0
    assert project.calls()[-1] == "python -m benchmarks.stack"
    for name, code in ([], 2), (["nonsense"], 2), (["perception_scoring"], 2), (["--help"], 0):
        found, _, err = project.run("benchmark", *name)
        assert found == code
        assert "camera_simulated command_lines docking" in err
        assert "perception_scoring " not in err.partition("one of")[2]


def test_no_registry_host_in_tracked_files() -> None:
    hosts = {"org": ["pypi", "pythonhosted", "npmjs", "golang", "maven", "deb.debian", "security.debian"]}
    hosts |= {"com": ["archive.ubuntu", "security.ubuntu"], "sh": ["astral"], "io": ["crates"]}
    forbidden = [f"{name}.{top}".encode() for top, names in hosts.items() for name in names]
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout
    files = [ROOT / os.fsdecode(name) for name in listed.split(b"\0") if name]
    named = [(file.name, host) for file in files if file.is_file() for host in forbidden if host in file.read_bytes()]
    assert named == []
