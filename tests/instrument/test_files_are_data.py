"""Plans, configurations and run files are data: nothing in them is executed, no name in them leads elsewhere."""

from __future__ import annotations

import ast
import io
import pickle
import shutil
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from drivers.configuration import parse_devices, planned, read_devices
from drivers.errors import ConfigurationError
from drivers.interfaces import ROLES
from drivers.lines import SerialLineForm
from instrument.artifact import read_artifact
from instrument.beam_image import read_beam_image
from instrument.errors import InputError
from instrument.facility import UNKNOWN_FACILITY, read_facility
from instrument.journal import JOURNAL_NAME, read_journal
from instrument.plan import read_plan
from instrument.run_folder import copy_artifact, copy_file
from sim_fixtures.examples import write_examples

ROOT = Path(__file__).parents[2]
PACKAGES = ("drivers", "instrument", "twin", "gui", "sim_fixtures")
#: Modules that turn data into code, or take code for data.
MODULES = {"pickle", "cPickle", "marshal", "shelve", "dill", "cloudpickle", "joblib", "yaml", "runpy", "code", "imp"}
BUILTINS = {"eval", "exec", "compile", "__import__"}
SHELLS = {"os.system", "os.popen", "os.execv", "os.execvp", "os.spawnv", "subprocess.getoutput", "pty.spawn"}
_OPTIONS = ("shell", "allow_pickle")
#: Where a module is imported by name, and why that name never comes from a file of a person.
BY_NAME = {
    "gui/application.py": "a list in the same module",
    "gui/pages/__init__.py": "the modules of the package",
    "gui/panels/__init__.py": "the modules of the package",
    "instrument/procedures/commands.py": "the procedures of the package",
    "sim_fixtures/cases/effects.py": "a list in the same module",
    "twin/diagnosis/effects/__init__.py": "the modules of the package",
    "twin/worker_process.py": "the parent process, on standard input",
}


@cache
def sources() -> list[tuple[str, ast.Module]]:
    paths = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
    return [(str(path.relative_to(ROOT)), ast.parse(path.read_text(encoding="utf-8"))) for path in paths]


def complaints(name: str, tree: ast.Module) -> list[str]:
    found = []
    for node in ast.walk(tree):
        modules: list[str] = []
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            modules = [node.module or ""]
        found += [f"imports {module}" for module in modules if module.split(".")[0] in MODULES]
        if isinstance(node, ast.Call):
            found += _call(name, node)
    return [f"{name}: {complaint}" for complaint in found]


def dotted(node: ast.expr) -> str:
    """``a.b.c`` of a name; ``?`` stands for what is no name."""
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else "?"


def _call(name: str, node: ast.Call) -> list[str]:
    called = dotted(node.func)
    options = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords if keyword.arg in _OPTIONS}
    found = []
    if called in BUILTINS or called in SHELLS or called.endswith("read_pickle"):
        found.append(f"calls {called}")
    if options.get("shell", "False") != "False":
        found.append(f"{called} with a shell")
    if called in ("np.load", "numpy.load") and options.get("allow_pickle") != "False":
        found.append(f"{called} without allow_pickle=False")
    if called.endswith("import_module") and name not in BY_NAME:
        found.append(f"imports by name: {ast.unparse(node)}")
    if called.endswith(("create_server", "Server", "bind")):
        hosts = [ast.unparse(argument) for argument in node.args]
        if any("0.0.0.0" in host or "''" in host for host in hosts):
            found.append(f"{called} listens to everyone: {hosts}")
    return found


def test_no_part_of_the_program_executes_what_it_reads() -> None:
    assert [complaint for name, tree in sources() for complaint in complaints(name, tree)] == []


def test_the_list_of_imports_by_name_is_no_longer_than_it_has_to_be() -> None:
    calls = ((name, node) for name, tree in sources() for node in ast.walk(tree) if isinstance(node, ast.Call))
    assert {name for name, node in calls if dotted(node.func).endswith("import_module")} == set(BY_NAME)


@pytest.mark.parametrize(
    "code",
    [
        "import pickle",
        "from yaml import load",
        "eval(text)",
        "os.system(text)",
        "subprocess.run(text, shell=True)",
        "np.load(path)",
        "np.load(path, allow_pickle=True)",
        "importlib.import_module(name)",
        "socket.create_server(('0.0.0.0', 1))",
        "socketserver.ThreadingTCPServer(('', 0), Talk)",
    ],
)
def test_the_scan_would_notice(code: str) -> None:
    assert complaints("module.py", ast.parse(code))


class Payload:
    """Unpickled, it makes a file."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple[object, ...]:
        return Path.touch, (self.marker,)


@pytest.fixture
def marker(tmp_path: Path) -> Iterator[Path]:
    """A file that nobody makes unless something is executed."""
    path = tmp_path / "executed"
    yield path
    assert not path.exists()


def test_the_payload_works_where_something_is_unpickled(tmp_path: Path) -> None:
    pickle.loads(pickle.dumps(Payload(tmp_path / "executed")))  # noqa: S301 (what the others must not do)
    assert (tmp_path / "executed").exists()


def test_a_picture_that_is_a_pickle_is_refused(tmp_path: Path, marker: Path) -> None:
    for name, content in (("object.npy", _object_array(marker)), ("plain.npy", pickle.dumps(Payload(marker)))):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=name):
            read_beam_image(tmp_path / name, 0.1, about_centroid=False)


def _object_array(marker: Path) -> bytes:
    stream = io.BytesIO()
    np.save(stream, np.array([[Payload(marker)]], dtype=object), allow_pickle=True)
    return stream.getvalue()


@pytest.mark.parametrize(
    "text",
    [
        "!!python/object/apply:os.system ['touch {marker}']",
        "version = 1\ntitle = \"t\"\n[[grid]]\nwavelength = \"__import__('os').system('touch {marker}')\"\n",
        'version = 1\ntitle = "t"\n[[grid]]\nwavelength = "$(touch {marker})"\n',
    ],
)
def test_a_plan_that_looks_like_code_is_a_wrong_plan(tmp_path: Path, marker: Path, text: str) -> None:
    (tmp_path / "plan.toml").write_text(text.replace("{marker}", str(marker)))
    with pytest.raises(InputError, match=r"plan\.toml"):
        read_plan(tmp_path / "plan.toml", UNKNOWN_FACILITY)


def test_a_journal_that_is_a_pickle_is_refused(tmp_path: Path, marker: Path) -> None:
    (tmp_path / JOURNAL_NAME).write_bytes(pickle.dumps(Payload(marker)) + b"\n")
    with pytest.raises(InputError, match="not the header of a journal"):
        read_journal(tmp_path)


def test_a_driver_is_one_that_is_installed_and_no_name_of_code() -> None:
    devices = {role: {"driver": "os:system", "line": "a"} for role in ROLES}
    form = parse_devices({"version": 1, "lines": {"a": {"kind": "tcp", "host": "x", "port": 1}}, "devices": devices})
    with pytest.raises(ConfigurationError, match=r"devices\.illumination_zenith\.driver: found 'os:system'"):
        planned(form)


@pytest.mark.parametrize("backend", ["/tmp/evil.so", "/tmp/evil.so@ivi", "./evil.so"])
def test_a_library_is_never_loaded_because_a_file_of_connections_names_it(tmp_path: Path, backend: str) -> None:
    file = tmp_path / "devices.toml"
    file.write_text(
        f'version = 1\n[lines.a]\nkind = "visa"\nresource = "TCPIP::1::INSTR"\nbackend = "{backend}"\n[devices]\n'
    )
    with pytest.raises(ConfigurationError, match=r"lines\.a\.visa\.backend|lines\.a\.backend"):
        read_devices(file)


@pytest.mark.parametrize("scheme", ["spy", "alt"])
def test_a_port_never_writes_a_file_or_names_a_class(tmp_path: Path, scheme: str) -> None:
    target = tmp_path / "written"
    form = SerialLineForm(kind="serial", port=f"{scheme}:///dev/null?file={target}")
    with pytest.raises(ValueError, match="expected the name of a port"):
        form.open("line")
    assert not target.exists()


@pytest.fixture
def run_folder(tmp_path: Path) -> Path:
    """Example files that lie in a run folder, and a secret beside it."""
    folder = tmp_path / "run"
    folder.mkdir()
    write_examples(folder)
    (folder / JOURNAL_NAME).write_text("{}\n")
    shutil.copy(next(folder.glob("*.csv")), tmp_path / "secret.csv")
    return folder


@pytest.mark.parametrize("name", ["../secret.csv", "{up}/secret.csv", "link.csv"])
def test_no_name_in_a_run_folder_leads_out_of_it(run_folder: Path, name: str) -> None:
    (run_folder / "link.csv").symlink_to(run_folder.parent / "secret.csv")
    artifact = run_folder / "artifact.toml"
    lines = [line for line in artifact.read_text().splitlines() if not line.startswith("holes")]
    told = name.format(up=run_folder.parent)
    artifact.write_text("\n".join([f'holes = "{told}"', *lines]))
    with pytest.raises(InputError, match=r"holes: found .* expected a file in this run folder"):
        read_artifact(artifact)
    facility = run_folder / "facility.toml"
    beam = '[beam]\nprofile = "image"\npixel_pitch = 0.1\nimage = '
    facility.write_text(facility.read_text().replace("[beam]", f'{beam}"{told}"').replace('profile = "gaussian"', ""))
    with pytest.raises(InputError, match=r"beam\.image: found .* expected a file in this run folder"):
        read_facility(facility)


def test_a_copy_stays_in_the_run_folder(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "a.csv").write_text("x")
    with pytest.raises(InputError, match="without folders"):
        copy_file(tmp_path / "a.csv", tmp_path / "run", "../b.csv")
    assert not (tmp_path / "b.csv").exists()
    examples = write_examples(tmp_path)
    text = examples.artifact.read_text().replace('holes = "', f'holes = "../{tmp_path.name}/')
    examples.artifact.write_text(text)
    copy_artifact(examples.artifact, tmp_path / "run")
    assert {path.parent for path in (tmp_path / "run").rglob("*")} == {tmp_path / "run"}


@pytest.mark.parametrize("name", ["../points.csv", "/etc/passwd"])
def test_a_table_of_a_plan_lies_beside_it(tmp_path: Path, name: str) -> None:
    (tmp_path / "plan").mkdir()
    (tmp_path / "points.csv").write_text("wavelength\n500\n")
    plan = tmp_path / "plan" / "plan.toml"
    plan.write_text(f'version = 1\ntitle = "t"\n[[part]]\ntable = "{name}"\n')
    with pytest.raises(InputError, match="expected a file in the folder of the plan, or below it"):
        read_plan(plan, UNKNOWN_FACILITY)
