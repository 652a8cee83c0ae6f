"""Runs every judge once and writes docs/judges.md's table: ``make judges``.

Judges live in an environment of their own (``.bench/judges``), made on demand from the extra ``judges`` of
pyproject.toml; this program runs in the project's environment and serves the simulated laboratory.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import tomllib
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from our_run import write_documents, write_example

from sim_fixtures.laboratory import start_simulated

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
ENVIRONMENT = ROOT / ".bench" / "judges"
RESULTS = HERE / "results.json"
PAGE = ROOT / "docs" / "judges.md"
BEGIN, END = "<!-- table: make judges -->", "<!-- end of the table -->"
#: Script, and its further argument.
ON_OUR_SIMULATORS = [
    ("pymeasure_esp300.py", ""),
    ("instrumentkit_esp301.py", ""),
    ("qmi_smc100.py", ""),
    ("pylablib_nkt.py", ""),
    ("qmi_interbus.py", ""),
    ("qcodes_34465a.py", ""),
    ("modbus_clients.py", "pymodbus"),
    ("modbus_clients.py", "minimalmodbus"),
]
OUR_DRIVERS = [("our_drivers.py", name) for name in ("pyvisa-sim", "pymodbus-socket", "pymodbus-rtu", "pyModbusTCP")]
ON_OUR_FILES = [("obsarray_run.py", "run.nc"), ("punpy_run.py", "run.nc"), ("bluesky_documents.py", "run.jsonl")]
SPEED, TIMEOUT = 20.0, 400.0


def python() -> Path:
    """Interpreter of the judges, after making their environment where there is none."""
    interpreter = ENVIRONMENT / "bin" / "python"
    wanted = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]["judges"]
    stamp = ENVIRONMENT / "installed.txt"
    if not stamp.exists() or stamp.read_text() != "\n".join(wanted):
        subprocess.run([sys.executable, "-m", "venv", str(ENVIRONMENT)], check=True)
        subprocess.run([str(interpreter), "-m", "pip", "install", "--quiet", *wanted], check=True)
        stamp.write_text("\n".join(wanted))
    return interpreter


def judge(interpreter: Path, script: str, argument: str, endpoints: dict[str, Any]) -> dict[str, Any]:
    """Run one judge; what it does not say itself counts as a failure."""
    command = [str(interpreter), str(HERE / script), json.dumps(endpoints), argument]
    environment = os.environ | {"PYTHONPATH": str(ROOT)} if (script, argument) in OUR_DRIVERS else dict(os.environ)
    try:
        ended = subprocess.run(command, check=False, capture_output=True, text=True, timeout=TIMEOUT, env=environment)
        verdict: dict[str, Any] = json.loads(ended.stdout.strip().splitlines()[-1])
    except (subprocess.TimeoutExpired, json.JSONDecodeError, IndexError) as error:
        words = "" if isinstance(error, subprocess.TimeoutExpired) else ended.stderr.strip().splitlines()[-1:]
        check = {"what": "the judge ends", "ok": False, "found": f"{type(error).__name__} {words}"}
        verdict = {"package": script, "version": "", "what": argument, "checks": [check]}
    failed = [check for check in verdict["checks"] if not check["ok"]]
    print(f"{script} {argument}: {len(verdict['checks']) - len(failed)} of {len(verdict['checks'])}", flush=True)
    for check in failed:
        print(f"  FAILED {check['what']}: {check['found']}", flush=True)
    return verdict | {"script": script}


def on_our_files(interpreter: Path, folder: Path) -> list[dict[str, Any]]:
    """Judges of files, each with the one that it reads."""
    write_example(folder / "run.nc")
    write_documents(folder)
    return [judge(interpreter, script, str(folder / name), {}) for script, name in ON_OUR_FILES]


def table(title: str, verdicts: list[dict[str, Any]]) -> list[str]:
    """One row a judge."""
    rows = [f"### {title}", "", "| judge | version | what | checks passed | script |", "|---|---|---|---|---|"]
    for verdict in verdicts:
        passed = sum(check["ok"] for check in verdict["checks"])
        count = f"{passed} of {len(verdict['checks'])}"
        rows.append(
            f"| {verdict['package']} | {verdict['version']} | {verdict['what']} | {count} | `{verdict['script']}` |"
        )
    return [*rows, ""]


def write(content: dict[str, Any]) -> None:
    """The results as they are, and the table between its marks."""
    RESULTS.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    lines = [f"Run on {content['date']}.", ""]
    lines += table("Their programs on our simulators", content["on_our_simulators"])
    lines += table("Our drivers on their simulators", content["our_drivers"])
    lines += table("Their programs on our files", content["on_our_files"])
    text = PAGE.read_text(encoding="utf-8")
    head, tail = text.split(BEGIN)[0], text.split(END)[1]
    PAGE.write_text(f"{head}{BEGIN}\n" + "\n".join(lines) + f"{END}{tail}", encoding="utf-8")


def main() -> int:
    """Run all; 1 where any check failed."""
    interpreter = python()
    with (
        tempfile.TemporaryDirectory(prefix="judges-") as folder,
        start_simulated(Path(folder), speed=SPEED, flux="lambertian") as laboratory,
    ):
        endpoints = laboratory.endpoints["ports"] | {"meter": laboratory.endpoints["meter"]}
        ours = [judge(interpreter, script, argument, endpoints) for script, argument in ON_OUR_SIMULATORS]
        files = on_our_files(interpreter, Path(folder))
    theirs = [judge(interpreter, script, argument, {}) for script, argument in OUR_DRIVERS]
    found = {"on_our_simulators": ours, "our_drivers": theirs, "on_our_files": files}
    write({"date": datetime.now(UTC).date().isoformat()} | found)
    return int(any(not check["ok"] for verdict in ours + theirs + files for check in verdict["checks"]))


if __name__ == "__main__":
    sys.exit(main())
